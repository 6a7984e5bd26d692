import pytest
from support.mockrobot import running

from canopen_control.cli.main import main

BASE = "robby_base_controller"


def test_a_base_drives_forward_and_stops():
    with running(controllers=[BASE]) as robot:
        assert main(["twist", BASE, "0.2", "0.0", "--for", "0.5"]) == 0
        joints = robot.status().joints
        assert joints["left_wheel_joint"].position == pytest.approx(joints["right_wheel_joint"].position)
        assert joints["left_wheel_joint"].position > 0


def test_a_controller_without_twist_refuses(mock_robot, capsys):
    assert main(["twist", "robby_forward_controller", "0.2", "0.0", "--once"]) == 1
    assert "robby_forward_controller takes no twist" in capsys.readouterr().err
    assert main(["twist", BASE, "0.2", "0.0", "--once"]) == 1
    assert f"{BASE} is unloaded, so it takes no command; activate it: " in capsys.readouterr().err
    assert main(["twist", "robby_bas_controller", "0.2", "0.0", "--once"]) == 2
