"""What could not be read is not there, and what depends on it is not asked."""

import pytest

from canopen_control.controllers.params import read_controllers
from canopen_control.hardware.description import read_description
from canopen_control.runtime.checked_robot import CheckedRobot
from canopen_control.runtime.files import find_robot


def test_a_robot_whose_files_could_not_be_read_has_no_wheels():
    assert CheckedRobot(find_robot("robby")).geometry is None


def test_wheels_and_controllers_are_those_of_the_files():
    files = find_robot("robby")
    robot = CheckedRobot(files, None, read_controllers(files.controllers), read_description(files.description))
    left, right = ["left_wheel_joint"], ["right_wheel_joint"]
    assert robot.geometry.radius(left + right) == pytest.approx(0.035)
    assert robot.geometry.separation(left, right) == pytest.approx(0.24)
    assert robot.config("robby_forward_controller").type == "forward_command_controller/ForwardCommandController"
