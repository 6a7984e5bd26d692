import pytest
from support.lockstep import lockstep
from support.mockrobot import running

from canopen_control import Robot
from canopen_control.cli.main import main

BASE = "robby_base_controller"


def test_a_base_drives_forward_and_stops():
    with running(controllers=[BASE]) as robot:
        assert main(["twist", BASE, "0.2", "0.0", "--for", "0.5"]) == 0
        joints = robot.status().joints
        assert joints["left_wheel_joint"].position == pytest.approx(joints["right_wheel_joint"].position)
        assert joints["left_wheel_joint"].position > 0


@pytest.mark.rest
def test_a_base_that_can_drives_sideways_and_another_one_reports_that_it_cannot(capsys):
    with lockstep(), Robot.from_config("mecanum", mock=True, name="platform") as robot:
        robot.start()
        assert main(["twist", "mecanum_base_controller", "0", "0", "--lateral", "0.2", "--for", "0.3"]) == 0
        joints = robot.status().joints
        assert joints["front_left_wheel_joint"].position < 0 < joints["front_right_wheel_joint"].position
    with running(controllers=[BASE]):
        assert main(["twist", BASE, "0", "0", "--lateral", "0.2", "--once"]) == 1
    assert f"{BASE} cannot drive sideways; it accepts linear.x and angular.z" in capsys.readouterr().err
