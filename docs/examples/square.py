"""Drive a base along a square, by time alone, and compare with what its wheels measured."""

import math
import time

from canopen_control import Robot

BASE = "robby_base_controller"
RADIUS, SEPARATION = 0.035, 0.24  # m, of the wheels
SPEED, TURN = 0.2, 1.0  # m/s and rad/s; the base ramps up and down by 1 m/s² and 1 rad/s²


def drive(robot: Robot, seconds: float, linear: float, angular: float) -> None:
    """Command one twist for its duration, and wait until the base is at rest before the next one."""
    end, rested = time.monotonic() + seconds, time.monotonic() + seconds + 0.1 + linear + angular
    while (now := time.monotonic()) < rested:
        robot.twist(BASE, *((linear, angular) if now < end else (0.0, 0.0)))
        time.sleep(0.02)


def wheels(robot: Robot) -> tuple[float, float]:
    """Return the way of the middle in m, and the angle by which the base has turned in rad."""
    left, right = (RADIUS * (robot.joints()[f"{side}_wheel_joint"].position or 0.0) for side in ("left", "right"))
    return (left + right) / 2, (right - left) / SEPARATION


with Robot.from_config("robby", can="memory:square", controllers=[BASE]) as robot:
    x = y = 0.0
    for _ in range(4):  # sides of 0.2 m and corners of 90 degrees
        begin, heading = wheels(robot)
        drive(robot, 1.0, SPEED, 0.0)
        way = wheels(robot)[0] - begin
        x, y = x + way * math.cos(heading), y + way * math.sin(heading)
        drive(robot, math.pi / 2 / TURN, 0.0, TURN)
    total, turned = wheels(robot)
    print(f"way of the middle {total:.2f} m, turned {turned:.2f} rad, ends {math.hypot(x, y):.2f} m from its start")
