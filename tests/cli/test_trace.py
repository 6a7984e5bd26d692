import json

import can
import pytest
from support.scripted_can import ScriptedBus

from canopen_control.bus.port import BusEventKind
from canopen_control.bus.pythoncan import message_of
from canopen_control.bus.recordings import RecordingWriter
from canopen_control.cli import trace
from canopen_control.cli.main import main
from canopen_control.frame import CanFrame

FRAMES = [
    CanFrame(0x000, b"\x01\x00"),
    CanFrame(0x080),
    CanFrame(0x183, b"\x37\x06\x03"),
    CanFrame(0x080),
    CanFrame(0x183, b"\x37\x06\x03"),
    CanFrame(0x603, bytes.fromhex("4018100500000000")),
    CanFrame(0x583, bytes.fromhex("8018100511000906")),
]


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "run.log"
    with RecordingWriter(path, "local:robby") as writer:
        for number, frame in enumerate(FRAMES):
            writer.write(1_763_700_000_000_000_000 + number * 10_000_000, frame)
    return str(path)


def test_a_recording_is_reported_by_name(log, capsys):
    assert main(["trace", "robby", "--file", log]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(FRAMES)
    assert lines[0].split() == ["0.000000", "000", "01", "00", "NMT", "START,", "all", "nodes"]
    assert lines[2].endswith("Statusword 0x0637 OPERATION ENABLED, target reached; Modes of operation display 3 PV")
    assert lines[6].endswith("0x06090011 subindex does not exist")
    assert "\x1b" not in "".join(lines)


def test_filters_and_count_choose_the_lines(log, capsys):
    def shown(*options):
        assert main(["trace", "robby", "--file", log, *options]) == 0
        return [line.split()[1] for line in capsys.readouterr().out.splitlines()]

    assert shown("--service", "sdo,nmt") == ["000", "603", "583"]
    assert shown("--node", "left_drive", "--count", "2") == ["183", "183"]
    assert shown("--changes") == ["000", "080", "183", "603", "583"]
    assert shown("--id", "183", "--id", "0x000") == ["000", "183", "183"]
    assert shown("--node", "right_drive") == []


def test_json_is_one_object_for_each_frame(log, capsys):
    assert main(["trace", "robby", "--file", log, "--json"]) == 0
    objects = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [item["id"] for item in objects] == ["000", "080", "183", "080", "183", "603", "583"]
    assert objects[2]["values"][0]["value"] == 0x637
    assert objects[2]["time"] == 1_763_700_000.02
    assert objects[6]["mark"] == "error"


def test_without_names_the_predefined_connection_set_is_shown(log, capsys):
    assert main(["trace", "--file", log, "--id", "183", "--count", "1"]) == 0
    out, err = capsys.readouterr()
    assert "node 3    TPDO1         mapping unknown" in out
    assert "object names are unknown: give ROBOT, --name or --eds" in err


def test_a_file_that_breaks_off_is_shown_and_reported(tmp_path, capsys):
    path = tmp_path / "x.log"
    path.write_text("(1.000000) can0 080#\nrubbish\n")
    assert main(["trace", "robby", "--file", str(path)]) == 0
    out, err = capsys.readouterr()
    assert "SYNC" in out
    assert "1 line is not a frame of classic CAN, left out" in err
    path.write_text("")
    assert main(["trace", "robby", "--file", str(path)]) == 2
    assert "contains no frames" in capsys.readouterr().err


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
