"""Run a robot on virtual drives with a live table; a short demo motion runs until another client sends a command.

This motion starts without a request, so `demo` refuses any bus to which real drives may be connected.

Exit codes: 0 success; 1 the boot or the run failed; 2 wrong usage or configuration, or a bus of real drives.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cli.run import add_arguments as add_run_arguments
from canopen_control.cli.run import names_robot, run_robot

if TYPE_CHECKING:
    import argparse


EXAMPLE = "canopen-control demo --ros"
ROBOT: Final = "robby"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `run`, which are also the options of `demo`."""
    add_run_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Run the robot that the options name, robby by default, with the demo motion and a live table."""
    if not names_robot(args):
        args.config = ROBOT
    return run_robot(args, motion=True, table=True)
