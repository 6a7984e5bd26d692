import can
import pytest
from support.scripted_can import ScriptedBus

from canopen_control.bus.port import BusEventKind
from canopen_control.bus.pythoncan import message_of
from canopen_control.cli import trace
from canopen_control.cli.main import main
from canopen_control.frame import CanFrame


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--service", "pod"], "unknown service 'pod'"),
        (["--id", "zz"], "hexadecimal"),
        (["--count", "0"], "not a whole number above 0"),
        (["--for", "-1"], "seconds above 0"),
    ],
)
def test_a_wrong_option_is_a_sentence(options, words, capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["trace", *options])
    assert exit_.value.code == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["robby", "--file", "/nowhere/x.log"], "recording /nowhere/x.log does not exist"),
        (["robby", "--file", "/nowhere/x.db"], ".log, .asc, .blf, .trc"),
        (["--can", "memory:x"], "inside one process"),
        ([], "no robot is running"),
        (["run.log"], "run.log is not a robot; give a recording with --file run.log"),
    ],
)
def test_what_cannot_be_listened_to_is_a_sentence(options, words, capsys):
    assert main(["trace", *options]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("channel", "gone"),
    [
        ("remote:ws://127.0.0.1:54701/", ConnectionResetError("socket is already closed")),
        ("slcan:/dev/ttyACM0@500000", OSError(5, "Input/output error")),
    ],
)
def test_a_carrier_that_dies_and_returns_is_reported_between_the_frames(channel, gone, monkeypatch, capsys):
    monkeypatch.setattr("canopen_control.bus.pythoncan._BROKEN_S", {"receive": 0.02, "send": 0.02})
    monkeypatch.setattr("canopen_control.bus.pythoncan._REOPEN_S", (0.01,))
    monkeypatch.setattr("canopen_control.bus.pythoncan.missing_package", lambda _interface: None)
    monkeypatch.setattr(can, "VALID_INTERFACES", frozenset({*can.VALID_INTERFACES, "remote", "slcan"}))
    opened, first, second = [], ScriptedBus(), ScriptedBus()
    answers = [first, ConnectionRefusedError(111, "Connection refused"), second]

    def adapter(**how):
        opened.append(how)
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(can, "Bus", adapter)
    first.incoming.put(message_of(CanFrame(0x080), 0.0))
    for _ in range(20):
        first.incoming.put(gone)

    def tell(event, **how):
        report(event, **how)
        if event.kind is BusEventKind.UP:
            second.incoming.put(message_of(CanFrame(0x702, b"\x05"), 0.0))

    report = trace._report
    monkeypatch.setattr(trace, "_report", tell)
    assert main(["trace", "--can", channel, "--eds", "TMCM-1270.eds", "--count", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:-1]] == ["DOWN:", "UP:"]
    assert lines[0].split()[1] == "080"
    assert f"bus {channel}: {gone}" in lines[1]
    assert lines[2] == f"UP: bus {channel}: works again"
    assert lines[3].split()[1] == "702"
    assert {how["interface"] for how in opened} == {channel.partition(":")[0]}
    assert second.stopped.is_set()
