import threading

import pytest
from support.mockrobot import running

from canopen_control.cli.main import main
from canopen_control.cli.status import render

STATE = {
    "state": "running",
    "latched": False,
    "latched_by": None,
    "cycle": {"period_s": 0.02, "count": 7, "missed": 0},
    "nodes": {
        "left_drive": {
            "node_id": 3,
            "nmt_state": "OPERATIONAL",
            "age_s": 0.0123,
            "error": None,
            "axes": [{"joint": "left_wheel_joint", "cia402_state": "OPERATION_ENABLED"}],
        },
        "gone": {"node_id": 4, "nmt_state": None, "age_s": None, "error": "node 4 (gone): no answer", "axes": []},
    },
    "joints": {"left_wheel_joint": {"command": 10.0, "velocity": 9.998, "position": 1.0, "effort": None}},
    "controllers": {"forward": "active", "base": "inactive"},
}


def test_a_line_for_the_robot_one_for_each_axis_and_the_errors_in_words():
    lines = render(STATE)
    assert lines[0] == "running, cycle 7 of 20 ms, 0 missed, active: forward"
    assert "left_drive (3)" in lines[2]
    assert "OPERATION ENABLED" in lines[2]
    assert lines[2].split()[-4:] == ["10.000", "9.998", "1.000", "12"]
    assert lines[3].split()[2:] == ["-"] * 7
    assert lines[4] == "  node 4 (gone): no answer"


def test_mock_hardware_has_joints_without_nodes():
    lines = render({**STATE, "nodes": {}})
    assert any(line.split()[:5] == ["no", "drive", "-", "-", "left_wheel_joint"] for line in lines)


@pytest.mark.parametrize(
    ("mode", "target"), [("PV", "10.000 rad/s"), ("CSP", "10.000 rad"), ("CST", "10.000 Nm"), (None, "10.000 ")]
)
def test_a_target_has_the_unit_of_its_mode(mode, target):
    axes = [{"joint": "left_wheel_joint", "cia402_state": "OPERATION_ENABLED", "mode": mode}]
    lines = render({**STATE, "nodes": {"left_drive": {**STATE["nodes"]["left_drive"], "axes": axes}}})
    assert f"  {target}  " in lines[2]


def test_a_latched_stop_is_said_with_the_way_out_of_it():
    lines = render({**STATE, "latched": True, "latched_by": "view"})
    assert lines[1] == "STOP is latched (by view): canopen-control stop --release"


def test_an_error_says_which_node_has_it():
    lines = render({**STATE, "nodes": {"left_drive": {**STATE["nodes"]["left_drive"], "error": "EMCY 0x4310"}}})
    assert lines[-1] == "  node 3 (left_drive): EMCY 0x4310"


def test_a_watch_that_ends_with_the_robot_says_so(private_folders, capsys):
    with running("ends") as robot:
        timer = threading.Timer(1.5, robot.shutdown)
        timer.start()
        assert main(["status", "--watch", "--name", "ends"]) == 0
        timer.join()
    said = capsys.readouterr()
    assert said.out.startswith("running, cycle")
    assert said.err == "canopen-control: robot ends has closed the connection; it was shut down or has died\n"
