"""Drive a base along a square, open loop, and print where its wheels say that it ended."""

import math
import time

from canopen_control import Robot

BASE = "robby_base_controller"
RADIUS, SEPARATION = 0.035, 0.24  # m: wheel radius and track width
SPEED, TURN = 0.2, 1.0  # m/s and rad/s; the base ramps up and down by 1 m/s² and 1 rad/s²


def drive(robot: Robot, seconds: float, linear: float, angular: float) -> None:
    """Command one twist for its duration, and wait until the base is at rest."""
    end, rested = time.monotonic() + seconds, time.monotonic() + seconds + 0.1 + linear + angular
    while (now := time.monotonic()) < rested:
        robot.twist(BASE, *((linear, angular) if now < end else (0.0, 0.0)))
        time.sleep(0.02)


def wheels(robot: Robot) -> tuple[float, float]:
    """Return the distance travelled by the base's centre in m, and its heading in rad."""
    left, right = (RADIUS * (robot.joints()[f"{side}_wheel_joint"].position or 0.0) for side in ("left", "right"))
    return (left + right) / 2, (right - left) / SEPARATION


with Robot.from_config("robby", can="memory:square", controllers=[BASE]) as robot:
    x = y = 0.0
    for _ in range(4):  # sides of 0.2 m and corners of 90 degrees
        begin, heading = wheels(robot)
        drive(robot, 1.0, SPEED, 0.0)
        length = wheels(robot)[0] - begin
        x, y = x + length * math.cos(heading), y + length * math.sin(heading)
        drive(robot, math.pi / 2 / TURN, 0.0, TURN)
    total, turned = wheels(robot)
    print(f"travelled {total:.2f} m, turned {turned:.2f} rad, ends {math.hypot(x, y):.2f} m from its start")
