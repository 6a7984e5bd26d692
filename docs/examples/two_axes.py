"""Run a custom robot (docs/examples/two_axes) with two CiA 402 drives, and move both axes to positions."""

import time
from pathlib import Path

from canopen_control import Robot

FOLDER = Path(__file__).parent / "two_axes"

with Robot.from_config(str(FOLDER), can="memory:two_axes") as robot:
    robot.command("position_controller", [0.5, -0.5])  # rad
    time.sleep(2.0)
    for joint in robot.joints().values():
        print(f"{joint.name}: {joint.position:.3f} rad")
