"""Listen on the bus of a running robot with the `canopen` package; the robot remains the SDO client."""

import canopen

from canopen_control import Robot

with Robot.from_config("robby", can="local:canopen_package"):
    network = canopen.Network()
    network.connect(interface="canopen_control", channel="canopen_package")
    drive = network.add_node(3)
    state = drive.nmt.wait_for_heartbeat(timeout=2.0)
    print("left_drive is", state)
    network.disconnect()
