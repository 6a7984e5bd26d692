"""`axis`: enable, disable, halt, quick-stop or fault-reset the drives of a running robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.client import RobotClient

if TYPE_CHECKING:
    import argparse

__all__ = ["add_arguments", "run"]

EXAMPLE = "canopen-control axis enable all"
ACTIONS = ("enable", "disable", "halt", "quick-stop", "fault-reset")
PATIENCE_S = 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("action", choices=ACTIONS)
    parser.add_argument("node", help="name or node id in bus.yml, or all")
    parser.add_argument("--name", help="the robot (default: the only one that runs)")


def run(args: argparse.Namespace) -> int:
    """Run the verb; ends when the drives did it, or with what keeps them from it."""
    with RobotClient.connect(args.name) as robot:
        robot.request("axis", {"action": args.action, "node": args.node}, PATIENCE_S)
    print(f"{args.action} {args.node}: done")
    return 0
