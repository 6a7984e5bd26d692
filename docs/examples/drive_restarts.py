"""Reset a drive behind the master's back, as a loose plug would, and read what the robot makes of it."""

import time

from canopen_control import CanFrame, Robot, open_port, pack_records

RESET_NODE_3 = CanFrame(0x000, bytes([0x81, 3]))  # an NMT command of somebody else

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
    robot.axis("enable")  # it was booted by itself, and moves after an enable and a new command
