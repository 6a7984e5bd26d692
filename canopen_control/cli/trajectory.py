"""`trajectory`: play a trajectory of a file on a joint trajectory controller, or end the one that is under way.

A file is YAML or JSON in the shape of trajectory_msgs/JointTrajectory: `joint_names`, and `points` with `positions`
and, where they are planned, `velocities` and `accelerations`, each with its `time_from_start` in seconds or as `sec`
and `nanosec`. When this ends before the trajectory does, by Ctrl-C or anything else, the joints brake and are held.

Exit codes: 0 the end was reached; 1 it was refused or ended before; 2 wrong usage, or no robot runs.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Final

from canopen_control.client import RobotClient
from canopen_control.client.trajectory_file import read_trajectory
from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.robot import CancelTrajectory, FollowTrajectory, ListControllers

if TYPE_CHECKING:
    import argparse

__all__ = ["EXAMPLE", "add_arguments", "run"]

EXAMPLE = """canopen-control trajectory play wave.yaml
         canopen-control trajectory cancel --controller arm_controller"""

_TYPE: Final = "joint_trajectory_controller/JointTrajectoryController"
_PATIENCE_S: Final = 3600.0  # beyond its own time: it may be scaled, and wait for its goal without a limit


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    play = actions.add_parser("play", help="follow the trajectory of a file to its end")
    play.add_argument("file", help="YAML or JSON, as trajectory_msgs/JointTrajectory has it")
    cancel = actions.add_parser("cancel", help="end the trajectory that is under way: the joints brake")
    for each in (play, cancel):
        each.add_argument("--controller", help="its name (default: the only one that is active)")
        each.add_argument("--name", help="the robot (default: the only one that runs)")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    if args.action == "cancel":
        with RobotClient.connect(args.name) as robot:
            robot.ask(CancelTrajectory(controller=_controller(robot, args.controller)))
        return 0
    joints, points = read_trajectory(args.file)
    with RobotClient.connect(args.name) as robot:
        controller = _controller(robot, args.controller)
        rest = robot.send_points(points)
        wanted = FollowTrajectory(controller=controller, joints=joints, points=rest, source="trajectory")
        patience = points[-1].time_from_start + _PATIENCE_S if points else _PATIENCE_S
        result = robot.ask(wanted, patience)
    reached = result.state == "succeeded"
    print(result.text, file=sys.stdout if reached else sys.stderr)
    return 0 if reached else 1


def _controller(robot: RobotClient, name: str | None) -> str:
    """Return the controller that is meant: `name`, or the only one of the type that is active; ConfigError else."""
    if name is not None:
        return name
    found = [each.name for each in robot.ask(ListControllers()) if each.type == _TYPE and each.state == "active"]
    if len(found) != 1:
        what = f"several are active: {', '.join(found)}" if found else "no joint trajectory controller is active"
        raise ConfigError(f"{what}; name one with --controller, see canopen-control controller list")
    return found[0]
