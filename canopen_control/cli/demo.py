"""`demo`: a robot on virtual drives with a live table; a short motion plays until anyone else commands it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cli.run import add_arguments as add_run_arguments
from canopen_control.cli.run import run_robot

if TYPE_CHECKING:
    import argparse

__all__ = ["add_arguments", "run"]

EXAMPLE = "canopen-control demo --ros"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options: those of `run`, for robby unless another is named."""
    add_run_arguments(parser)
    parser.set_defaults(config="robby")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    return run_robot(args, motion=True, table=True)
