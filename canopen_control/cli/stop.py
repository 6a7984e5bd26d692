"""`stop`: ramp every joint to zero and disable the drives; the robot keeps running. No emergency stop (ISO 13850)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.client import RobotClient

if TYPE_CHECKING:
    import argparse

__all__ = ["add_arguments", "run"]

EXAMPLE = "canopen-control stop"
PATIENCE_S = 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--name", help="the robot (default: the only one that runs)")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    with RobotClient.connect(args.name) as robot:
        robot.request("stop", {}, PATIENCE_S)
    print("stopped and disabled; to go on: canopen-control axis enable all")
    return 0
