"""Latch STOP: no client can move the robot until it is released, enabled and commanded again."""

from canopen_control import Robot
from canopen_control.errors import ControlError

CONTROLLER = "robby_forward_controller"

with Robot.from_config("robby", can="memory:stop_and_release") as robot:
    robot.command(CONTROLLER, [5.0, 5.0])
    robot.stop(latch=True)  # returns when no drive is moving under power
    print("stopped:", [joint.velocity for joint in robot.joints().values()])
    try:
        robot.axis("enable")
    except ControlError as error:
        print("latched:", error)

    robot.release()
    try:
        robot.command(CONTROLLER, [5.0, 5.0])
    except ControlError as error:
        print("released:", error)

    robot.axis("enable")
    robot.command(CONTROLLER, [5.0, 5.0])
    print("enabled:", robot.state())
