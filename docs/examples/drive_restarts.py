"""Reset a drive behind the master's back, as a loose plug would, and print the robot's reaction."""

import time

from canopen_control import CanFrame, Robot, open_port, pack_records

RESET_NODE_3 = CanFrame(0x000, bytes([0x81, 3]))  # an NMT command from another device

with (
    Robot.from_config("robby", can="memory:drive_restarts") as robot,
    robot.events(timeout=1.0) as events,
):
    for _ in range(5):
        robot.command("robby_forward_controller", [5.0, 5.0])
        time.sleep(0.1)

    port = open_port("memory:drive_restarts", label="stranger")
    port.send(pack_records([RESET_NODE_3]))
    port.close()

    for event in events:  # ends when nothing has happened for a second
        if event.level != "info":
            print(f"{event.kind}: {event.text}")
    print("ready again:", robot.nodes()["left_drive"].ready)
    robot.axis("enable")  # the drive was booted automatically; it moves after an enable and a new command
