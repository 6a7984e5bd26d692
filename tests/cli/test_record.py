import errno
import os
import signal
import threading

import pytest
from support.host import eventually
from support.localbus import hub_status, open_local, runtime_folders
from support.mockrobot import running
from support.robots import Bench
from support.tracing import robby_decoder

from canopen_control.bus.recordings import FORMATS, Recording, RecordingWriter
from canopen_control.cli.main import main
from canopen_control.cli.record import Recorded
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.files import space_advice
from canopen_control.rpc.wire import plain


@pytest.fixture
def folders(monkeypatch):
    with runtime_folders(monkeypatch.setenv) as folder:
        yield folder


@pytest.fixture(scope="module")
def session():
    """Every frame of a boot and a short motion of robby, with the times of a simulated clock."""
    bench = Bench("recorded")
    bench.start()
    bench.hold(1.0, -2.0, ms=300)
    frames = [frame for _, frame in bench.bus.history]
    bench.close()
    return [(1_763_700_000_000_000_000 + number * 250_000, frame) for number, frame in enumerate(frames)]


@pytest.mark.parametrize("suffix", list(FORMATS))
def test_a_recording_reports_what_the_live_bus_reported(tmp_path, session, suffix):
    path, live, replayed = tmp_path / f"run{suffix}", robby_decoder(), robby_decoder()
    with RecordingWriter(path, "local:robby") as writer:
        for item in session:
            writer.write(*item)
    reported = [live.decode(frame, time_ns) for time_ns, frame in session]
    again = [replayed.decode(frame, time_ns) for time_ns, frame in Recording(path)]
    assert len(reported) > 400
    assert [item.text for item in again] == [item.text for item in reported]
    assert [(item.service, item.node, item.values) for item in again] == [
        (item.service, item.node, item.values) for item in reported
    ]
    assert {item.service for item in reported} >= {"pdo", "sdo", "nmt", "hb", "sync"}


def recorded(path, frames, *options):
    """Record `frames` that somebody sends on a bus, ended by SIGTERM as soon as they are in the file."""

    def send():
        try:
            assert eventually(lambda: "record" in str(hub_status("taken")))
            port.send(pack_records(frames))
            assert eventually(lambda: path.exists() and len(list(Recording(path))) == len(frames))
        finally:
            os.kill(os.getpid(), signal.SIGTERM)

    port = open_local("taken", "sender")
    sender = threading.Thread(target=send)
    sender.start()
    try:
        return main(["record", "--can", "local:taken", "-o", str(path), *options])
    finally:
        sender.join(60)
        port.close()


@pytest.mark.process
def test_it_listens_until_it_is_ended_and_reports_how_many_frames_there_are(folders, tmp_path, capsys):
    path, before = tmp_path / "x.log", signal.getsignal(signal.SIGTERM)
    frames = [CanFrame(0x80), CanFrame(0x183, b"\x37\x06\x03")]
    assert recorded(path, frames) == 0
    out, err = capsys.readouterr()
    assert out.startswith(f"{path}: 2 frames of local:taken in ")
    assert out.endswith(" s, none lost\n")
    assert err == ""
    assert [item.frame for item in Recording(path)] == frames
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.process
def test_a_duration_ends_it_and_a_silent_bus_is_exit_code_1(folders, tmp_path, capsys):
    port = open_local("quiet", "other")
    assert main(["record", "--can", "local:quiet", "-o", str(tmp_path / "x.blf"), "--for", "0.1"]) == 1
    out, err = capsys.readouterr()
    assert "0 frames of local:quiet" in out
    advice = "see canopen-control bus status local:quiet"
    assert err == f"canopen-control: no frame was received on local:quiet; {advice}\n"
    assert main(["trace", "--can", "local:quiet", "--for", "0.1"]) == 1
    assert "canopen-control: local:quiet: no frame was received\n" in capsys.readouterr().err
    port.close()


@pytest.mark.process
def test_the_old_form_is_understood_and_reported(folders, tmp_path, capsys):
    port = open_local("old", "other")
    path = tmp_path / "x.log"
    assert main(["record", "local:old", "--can", str(path), "--for", "0.1"]) == 1  # no frame
    out, err = capsys.readouterr()
    assert out.startswith(f"{path}: 0 frames of local:old")
    new = f"write: record --can local:old -o {path}\n"
    assert err.startswith(f"canopen-control: these options are deprecated; {new}")
    port.close()


@pytest.mark.process
def test_a_full_disk_is_exit_code_1_with_what_is_in_the_file(monkeypatch, folders, tmp_path, capsys):
    def write(self, _time_ns, _frame):
        self._fail(OSError(errno.ENOSPC, "No space left on device"))

    monkeypatch.setattr(RecordingWriter, "write", write)
    port, path = open_local("full", "other"), tmp_path / "x.log"
    done = threading.Event()

    def tick():
        while not done.wait(0.05):
            port.send(pack_records([CanFrame(0x80)]))

    ticking = threading.Thread(target=tick)
    ticking.start()
    assert main(["record", "--can", "local:full", "-o", str(path), "--for", "10"]) == 1
    done.set()
    ticking.join()
    out, err = capsys.readouterr()
    assert out.startswith(f"{path}: 0 frames of local:full in ")
    advice = space_advice(path, OSError(errno.ENOSPC, ""))
    assert advice
    assert err == f"canopen-control: {path}: No space left on device; it contains 0 frames{advice}\n"
    port.close()


@pytest.mark.process
def test_a_bus_that_is_not_open_cannot_be_recorded(folders, tmp_path, capsys):
    port = open_local("robby", "other")
    path = tmp_path / "x.log"
    assert main(["record", "--can", "local:typo", "-o", str(path), "--for", "0.1"]) == 2
    assert "bus local:typo: no program has it open; open now: local:robby;" in capsys.readouterr().err
    assert not path.exists()
    port.close()


@pytest.mark.process
@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--can", "local:x"], "give a destination, as in: canopen-control record -o run.log"),
        (["local:x"], "give a destination, as in: canopen-control record -o run.log"),
        (["local:x", "--can", "local:y", "-o", "run.log"], "two buses, local:x and local:y"),
        (["--can", "local:x", "-o", "run.db"], ".log, .asc, .blf, .trc"),
        (["--can", "memory:x", "-o", "run.log"], "inside one process"),
        (["-o", "run.log"], "no robot is running"),
        (["--can", "run.log"], "no robot is running"),  # the old form
        (["--can", "local:x", "--bag", "run"], "--bag records a robot, not a bus"),
    ],
)
def test_what_cannot_be_recorded_is_a_sentence(folders, options, words, capsys):
    assert main(["record", *options]) == 2
    assert words in capsys.readouterr().err


def test_a_robot_without_a_bus_has_nothing_to_record(folders, capsys):
    with running("record-mock"):
        assert main(["record", "--name", "record-mock", "-o", "run.log"]) == 2
    assert "has no bus, as on mock hardware" in capsys.readouterr().err


def test_a_bag_of_the_running_robot(tmp_path, capsys):
    pytest.importorskip("rosbags", reason="rosbags is not installed: pip install canopen-control[bag]")
    with running("bagverb"):
        assert main(["record", "--bag", str(tmp_path / "run"), "--for", "0.3"]) == 0
    assert "messages of bagverb" in capsys.readouterr().out
    assert (tmp_path / "run" / "metadata.yaml").exists()


@pytest.mark.parametrize("arguments", [["--bag", "x", "--can", "x.log"], ["can0", "--bag", "x"]])
def test_a_bag_is_of_a_robot_and_alone(arguments, capsys):
    assert main(["record", *arguments]) == 2
    assert "--bag" in capsys.readouterr().err


def test_what_is_not_in_the_file_is_reported():
    whole = Recorded("x.trc", "can0", 10, lost=2, left_out=3, seconds=1.5)
    assert whole.sentence() == (
        "x.trc: 10 frames of can0 in 1.5 s, 2 lost: they arrived faster than they were read, "
        "3 left out: the format cannot hold them"
    )
    assert plain(whole) == {
        "file": "x.trc", "channel": "can0", "frames": 10, "lost": 2, "left_out": 3, "seconds": 1.5,
    }  # fmt: skip


@pytest.mark.process
def test_an_existing_recording_is_kept_unless_an_option_permits_to_replace_it(folders, tmp_path, capsys):
    path = tmp_path / "x.log"
    path.write_text("(1.0) can0 080#\n")
    port = open_local("kept", "other")
    record = ["record", "--can", "local:kept", "-o", str(path), "--for", "0.1"]
    assert main(record) == 2
    advice = "choose another name, or replace it with --overwrite"
    assert capsys.readouterr().err == f"canopen-control: {path} already exists; {advice}\n"
    assert path.read_text() == "(1.0) can0 080#\n"
    assert main([*record, "--overwrite"]) == 1  # no frame
    assert path.read_text() == ""
    port.close()
