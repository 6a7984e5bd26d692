"""The flight recording of a robot with faults, replayed as a simulation: same motion, same faults."""

import pytest
from support.host import eventually
from support.localbus import hub_status

from canopen_control.cli.main import main
from canopen_control.host.files import state_dir
from canopen_control.trace.flight_file import newest, read_flight

NAME = "seeded"


def recorder_listens():
    members = hub_status(NAME).members
    return any(max(member.rx, member.tx) > 200 for member in members if member.label.startswith("flight recorder"))


def faults(file):
    return [(event.kind, event.node) for event in file.events if event.level == "error"]


def test_a_flight_recording_is_a_seed(stage, tmp_path, capsys):
    robot = stage.robby(NAME)
    assert eventually(recorder_listens)
    stage.call("command", "robby_forward_controller", 5, 4, "--name", NAME, "--for", 1)
    broken = stage.call("fault", "left_drive", "short_circuit", "on")
    assert broken.wait() == 0, f"{broken}; {robot}"
    assert eventually(lambda: newest(state_dir(NAME) / "flight") is not None)
    assert robot.end() == 0, robot
    path, again = newest(state_dir(NAME) / "flight"), tmp_path / "again.zip"
    was = read_flight(path)
    assert main(["simulate", "robby", "--recording", str(path), "--record", str(again)]) == 0
    capsys.readouterr()
    became = read_flight(again)
    assert faults(became) == faults(was)
    assert {request.method for request in was.requests} >= {"command"}
    for joint, reading in was.states[-1].joints.items():
        assert abs(reading.position) > 2.0
        assert became.states[-1].joints[joint].position == pytest.approx(reading.position, abs=0.6)
