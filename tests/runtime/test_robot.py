import threading

import pytest

from canopen_control import Robot
from canopen_control.client import find_robots
from canopen_control.errors import BusClosed, CanopenError, ControlError

FORWARD = "robby_forward_controller"


def test_a_script_commands_a_robot_on_virtual_drives():
    with Robot.from_config("robby", can="memory:script") as robot:
        robot.command(FORWARD, [10.0, 10.0])
        reached = threading.Event()
        for _ in range(200):
            if robot.status()["joints"]["left_wheel_joint"]["velocity"] > 9.9:
                reached.set()
                break
            reached.wait(0.01)
        assert reached.is_set()
        robot.stop()
        assert abs(robot.status()["joints"]["left_wheel_joint"]["velocity"]) < 0.1
        robot.axis("enable", "left_drive")
    assert find_robots() == []


def test_errors_come_to_the_caller():
    with Robot.from_config("robby", mock=True) as robot:
        with pytest.raises(ControlError, match="nobody"):
            robot.command("nobody", [1.0])
        with pytest.raises(ControlError):
            robot.axis("enable", "nobody")
        assert robot.status()["state"] == "running"


def test_a_robot_that_cannot_start_raises_why_and_leaves_nothing():
    robot = Robot.from_config("robby", can="memory:nobody", drives=False)
    with pytest.raises(CanopenError, match=r"left_drive.*right_drive"):
        robot.start()
    assert find_robots() == []
    with pytest.raises(BusClosed):
        robot.status()


def test_starting_and_ending_twice_does_nothing():
    robot = Robot.from_config("robby", mock=True)
    robot.start()
    robot.start()
    robot.shutdown()
    robot.shutdown()
    with pytest.raises(BusClosed):
        robot.command(FORWARD, [1.0, 1.0])
