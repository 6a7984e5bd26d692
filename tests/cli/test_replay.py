import json
import threading

import pytest
from support.host import TIMEOUT_S
from support.localbus import open_local, receive, runtime_folders
from support.onbus import TMCM, OnBus

from canopen_control.bus.recordings import RecordingWriter
from canopen_control.cli import replay
from canopen_control.cli.main import main
from canopen_control.client import RobotClient
from canopen_control.frame import CanFrame, frames_of, pack_records
from canopen_control.rpc.messages.robot import GetDescription, GetStatus
from canopen_control.rpc.messages.state import RobotEvent
from canopen_control.trace.flight_file import FlightMeta, save

FRAMES = [
    CanFrame(0x000, b"\x01\x00"),
    CanFrame(0x080),
    CanFrame(0x183, b"\x37\x06\x03"),
    CanFrame(0x602, bytes(8)),
    CanFrame(0x7E5, bytes(8)),
]


@pytest.fixture
def folders(monkeypatch):
    monkeypatch.setattr(replay, "LISTEN_S", 0.15)
    with runtime_folders(monkeypatch.setenv) as folder:
        yield folder


def written(path, frames):
    with RecordingWriter(path) as writer:
        for number, frame in enumerate(frames):
            writer.write(1_763_700_000_000_000_000 + number * 1_000_000, frame)
    return str(path)


@pytest.fixture
def log(tmp_path):
    return written(tmp_path / "run.log", FRAMES)


def test_the_nodes_of_a_recording_are_senders_and_receivers_of_its_frames():
    assert replay.node_ids_in((0, frame) for frame in FRAMES) == {2, 3}


def test_without_a_bus_it_reports_what_is_in_it(log, capsys):
    assert main(["replay", log, "robby", "--service", "pdo"]) == 0
    assert "Statusword 0x0637 OPERATION ENABLED" in capsys.readouterr().out


def test_frames_of_two_buses_are_not_played_onto_one(folders, tmp_path, capsys):
    path = tmp_path / "two.log"
    path.write_text("(1700000000.000000) can0 183#3702\n(1700000000.000100) can1 183#1800\n")
    assert main(["replay", str(path)]) == 0
    sentence = f"{path} contains the frames of 2 buses (can0, can1); keep those of one: grep ' can0 ' {path} > can0.log"
    assert sentence in capsys.readouterr().err
    assert main(["replay", str(path), "--can", "local:bench"]) == 2
    assert f"{sentence} (--force plays all frames)" in capsys.readouterr().err


@pytest.mark.process
def test_it_plays_into_an_empty_bus(folders, log, capsys):
    ear = open_local("bench", "ear")
    assert main(["replay", log, "--can", "local:bench"]) == 0
    assert capsys.readouterr().out.startswith("5 frames into local:bench, none later than ")
    received = receive(ear, 9)  # first the two nodes are asked whether they are there, and the question is withdrawn
    assert sorted(frame.can_id for frame in received[:4]) == [0x602, 0x602, 0x603, 0x603]
    assert received[4:] == FRAMES
    ear.close()


def test_the_nodes_of_it_that_answer_are_those_that_are_asked_and_there(private_folders):
    with OnBus("memory:asked", {3: TMCM, 9: TMCM}):
        assert replay._answering("memory:asked", {2, 3}) == {3}


@pytest.mark.process
def test_where_a_node_of_it_is_alive_nothing_is_played(folders, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(replay, "ANSWER_S", TIMEOUT_S)  # the only node that is asked answers
    log = written(tmp_path / "run.log", [frame for frame in FRAMES if frame.can_id != 0x602])
    ear = open_local("bench", "ear")
    with OnBus("local:bench", {3: TMCM, 9: TMCM}):
        receive(ear, 2)  # their boot-up
        assert main(["replay", log, "--can", "local:bench"]) == 2
        assert "on local:bench node 3 of" in capsys.readouterr().err
        observed = receive(ear, 2)  # the question and the answer
        assert not any(frame.can_id in (0x000, 0x080) for frame in observed)
        assert main(["replay", log, "--can", "local:bench", "--force"]) == 0
    ear.close()


@pytest.mark.process
def test_where_a_master_is_alive_nothing_is_played(folders, log, capsys, monkeypatch):
    monkeypatch.setattr(replay, "LISTEN_S", TIMEOUT_S)  # it ends when the master is heard
    ear, master = open_local("bench", "ear"), open_local("bench", "master")
    stopped = threading.Event()

    def sync():
        while not stopped.wait(0.02):
            master.send(pack_records([CanFrame(0x080)]))

    thread = threading.Thread(target=sync)
    thread.start()
    try:
        assert main(["replay", log, "--can", "local:bench"]) == 2
    finally:
        stopped.set()
        thread.join()
        master.close()
    assert "on local:bench a master is active: its SYNC or NMT was received" in capsys.readouterr().err
    assert {frame.can_id for frame in frames_of(ear.receive())} == {0x080}
    ear.close()


@pytest.mark.process
def test_ctrl_c_ends_it_and_it_reports_how_far_it_came(folders, log, capsys, monkeypatch):
    def interrupted(frames, port, played, *, speed):
        next(iter(frames))
        played.frames = 1
        raise KeyboardInterrupt

    monkeypatch.setattr("canopen_control.bus.recordings.play", interrupted)
    assert main(["replay", log, "--can", "local:bench", "--force"]) == 130
    assert capsys.readouterr().out == "1 frames into local:bench, none later than 0.0 ms\n"


@pytest.mark.parametrize("bad", ["memory:x", "virtual:x"])
def test_a_bus_without_a_receiver_is_refused(bad, log, capsys):
    assert main(["replay", log, "--can", bad]) == 2
    assert "no other program receives the frames" in capsys.readouterr().err


@pytest.fixture
def flight(tmp_path):
    """A flight recording of two states."""
    reason = RobotEvent(time=0.0, kind="", node=None, level="info", text="")
    lines = [json.dumps({"time": 1.0 + tenth / 10, "state": "running"}).encode() for tenth in range(2)]
    return str(save(tmp_path, FlightMeta(robot="robby", reason=reason), iter(()), [], lines))


@pytest.mark.process
def test_a_flight_recording_is_watched_as_a_robot_until_one_runs(stage, flight):
    program = stage.start("replay", flight, "robby", "--page")
    assert "0 s of robby; see it: canopen-control view --name robby_replay" in program.until("robby_replay:")
    with RobotClient.connect("robby_replay") as client:
        assert client.ask(GetStatus()).state == "running"
        assert "left_wheel_joint" in client.ask(GetDescription()).urdf
    other = stage.start("run", "robby", "--mock", "--for", "20")
    assert program.wait() == 0
    assert "robot robby has started; the replay ends" in program.err
    again = stage.start("replay", flight, "--page")
    assert again.wait() == 2
    assert "robot robby runs, and STOP must always refer to one robot" in again.err
    other.end()


@pytest.mark.parametrize("words", [["run.log", "--page"], ["fault.zip", "--page", "--can", "local:x"]])
def test_only_a_flight_recording_is_watched_and_played_into_no_bus(words, capsys):
    assert main(["replay", *words]) == 2
    assert "--page requires a flight recording (.zip) and no --can" in capsys.readouterr().err
