"""`demo`: a robot on virtual drives with a live table; a short motion plays until anyone else commands it.

Its motion is asked for by nobody, so it is for virtual drives only: a bus that real drives can be on is refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cli.run import add_arguments as add_run_arguments
from canopen_control.cli.run import run_robot

if TYPE_CHECKING:
    import argparse

__all__ = ["add_arguments", "run"]

EXAMPLE = "canopen-control demo --ros"
ROBOT: Final = "robby"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options: those of `run`."""
    add_run_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb: robby, unless a robot, a launch file or files of one are named."""
    if all(each is None for each in (args.config, args.launch, args.bus, args.controllers, args.description)):
        args.config = ROBOT
    return run_robot(args, motion=True, table=True)
