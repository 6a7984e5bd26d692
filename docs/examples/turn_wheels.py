"""Run the robby robot on virtual drives in this program, and turn its wheels for two seconds."""

import time

from canopen_control import Robot

with Robot.from_config("robby", can="local:robby") as robot:  # the robot runs until the end of the block
    for _ in range(20):  # commands expire quickly: keep sending to keep moving
        robot.command("robby_forward_controller", [10.0, 10.0])  # rad/s
        time.sleep(0.1)
    for joint in robot.joints().values():
        print(f"{joint.name}: {joint.position} rad, {joint.velocity} rad/s")
