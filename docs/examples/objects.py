"""Read and write objects of a drive by their names in the EDS, while the robot runs."""

from canopen_control import Robot
from canopen_control.errors import ConfigError, RemoteProtocolError

with Robot.from_config("robby", can="virtual:objects") as robot:
    print("device name:", robot.sdo_read("left_drive", 0x1008))
    print("vendor id:", robot.sdo_read("left_drive", 0x1018, 1))

    before = robot.sdo_read("left_drive", "Profile acceleration")
    robot.sdo_write("left_drive", "Profile acceleration", 8000)
    print("profile acceleration:", before, "->", robot.sdo_read("left_drive", "Profile acceleration"))

    try:
        robot.sdo_read("left_drive", 0x5EEE)
    except RemoteProtocolError as error:  # an SDO abort from the drive
        print("refused:", error)
    try:
        robot.sdo_read("left_drive", "Statuswort")
    except ConfigError as error:  # a name that the EDS does not contain
        print("not asked:", error)
