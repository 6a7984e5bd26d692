"""Drive the base of a running robot, started with `canopen-control run robby`, and print its events."""

import time

from canopen_control import Robot

with Robot.attach("robby") as robot, robot.events(timeout=0.5) as events:  # started with `canopen-control run robby`
    robot.switch(activate=["robby_base_controller"], deactivate=["robby_forward_controller"])
    robot.axis("enable")
    for _ in range(20):
        robot.twist("robby_base_controller", linear=0.3, angular=0.5)  # m/s, rad/s
        time.sleep(0.1)
    print(robot.joints()["left_wheel_joint"].velocity, robot.nodes()["left_drive"].nmt_state)
    print(robot.sdo_read("left_drive", "Statusword"), robot.sdo_read("left_drive", 0x1018, 1))
    robot.stop()
    for event in events:
        print(event.level, event.text)
