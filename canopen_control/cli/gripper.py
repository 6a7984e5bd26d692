"""Move the joint of a gripper action controller to a position, and wait until it arrives or stalls.

If this program ends before the gripper does, by Ctrl-C or otherwise, or is suspended (Ctrl-Z), the joint holds its
current position. After a success the joint keeps its goal, or with `allow_stalling` its grip.

Exit codes: 0 the goal was reached or gripped; 1 refused, or ended early; 2 wrong usage, or no robot runs.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.arguments import finite, one_name
from canopen_control.cli.support.commands import find_controller
from canopen_control.cli.support.output import json_text
from canopen_control.cli.support.parsers import add_robot_name
from canopen_control.client import RobotClient
from canopen_control.client.robot_client import HEARTBEAT_S
from canopen_control.rpc.messages.gripper import MoveGripper

if TYPE_CHECKING:
    import argparse


EXAMPLE = "canopen-control gripper 0.04 --max-effort 20"

_TIMEOUT_S: Final = 3600.0  # for goals of any length


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("position", type=finite, metavar="POSITION", help="goal position in rad or m")
    parser.add_argument(
        "--max-effort", type=finite, metavar="N", help="effort limit in Nm or N (default: the controller's)"
    )
    parser.add_argument(
        "--max-velocity",
        type=finite,
        metavar="V",
        help="velocity limit in rad/s or m/s (default: the controller's)",
    )
    parser.add_argument("--controller", type=one_name, help="controller name (default: the only active one)")
    add_robot_name(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    with RobotClient.connect(args.name) as robot:
        controller = find_controller(robot, args.controller, "gripper", "gripper action controller")
        request = MoveGripper(
            controller=controller.name,
            position=args.position,
            max_effort=args.max_effort,
            max_velocity=args.max_velocity,
            source="gripper",
            heartbeat=HEARTBEAT_S,
        )
        with robot.heartbeats():
            result = robot.ask(request, _TIMEOUT_S)
    succeeded = result.state == "succeeded"
    position = "" if result.position is None else f" ({controller.joints[0]} is at {result.position:.4g})"
    if args.json:
        print(json_text(result))
    else:
        print(f"{result.text}{position}", file=sys.stdout if succeeded else sys.stderr)
    return 0 if succeeded else 1
