from canopen_control.cli.status import render

STATE = {
    "state": "running",
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
    assert any("mock" in line and "left_wheel_joint" in line for line in lines)
