"""`stop`: ramp every joint to zero and disable the drives; the robot keeps running. No emergency stop (ISO 13850).

`--latch` keeps everybody from moving it, this one's own next command included, until `--release`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import Release, Stop

if TYPE_CHECKING:
    import argparse

__all__ = ["add_arguments", "run"]

EXAMPLE = "canopen-control stop"
DONE = "stopped and disabled; to go on: canopen-control axis enable all"
SOURCE = "canopen-control stop"
TIMEOUT_S = 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--latch", action="store_true", help="nothing moves before --release, whoever commands it")
    how.add_argument("--release", action="store_true", help="let go of a latched stop; the drives stay disabled")
    parser.add_argument("--name", help="the robot (default: the only one that runs)")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    with RobotClient.connect(args.name) as robot:
        if args.release:
            robot.ask(Release(source=SOURCE))
            print("released, the drives are disabled; to go on: canopen-control axis enable all")
            return 0
        robot.ask(Stop(latch=args.latch, source=SOURCE), TIMEOUT_S)
    print("stopped, disabled and latched; to go on: canopen-control stop --release" if args.latch else DONE)
    return 0
