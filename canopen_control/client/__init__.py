"""Client of a running robot, for scripts, threads and other processes.

with RobotClient.connect() as robot:
    robot.ask(CommandController(controller="robby_forward_controller", values=[10.0, 10.0]))
"""

from canopen_control.client.robot_client import RobotClient
from canopen_control.host.sockets import find_robots, select_robot

__all__ = ["RobotClient", "find_robots", "select_robot"]
