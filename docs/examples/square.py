"""Drive a base along a square, by time alone, and compare with what its wheels measured."""

import time

from canopen_control import Robot

BASE = "robby_base_controller"
SIDE_S, TURN_S = 1.0, 1.57  # at 0.2 m/s and 1 rad/s


def drive(robot: Robot, seconds: float, linear: float, angular: float) -> None:
    """Command one twist until its time is over: a base stops by itself when nobody renews it."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        robot.twist(BASE, linear, angular)
        time.sleep(0.05)


with Robot.from_config("robby", can="memory:square", controllers=[BASE]) as robot:
    for _ in range(2):  # two sides and two corners of it
        drive(robot, SIDE_S, 0.2, 0.0)
        drive(robot, TURN_S, 0.0, 1.0)
    left, right = (robot.joints()[f"{side}_wheel_joint"].position or 0.0 for side in ("left", "right"))
    print(f"way of the middle {(left + right) / 2 * 0.035:.2f} m, turned {(right - left) * 0.035 / 0.24:.2f} rad")
