"""Stop the robot as `stop` does, then end its runtime.

Exit codes: 0 the runtime has ended; 1 no answer; 2 wrong usage, or no robot runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cli.support.output import print_result
from canopen_control.cli.support.parsers import add_robot_name
from canopen_control.client import RobotClient
from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.robot import Shutdown, Subscribe

if TYPE_CHECKING:
    import argparse


EXAMPLE = "canopen-control shutdown"
TIMEOUT_S = 30.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_robot_name(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb; return when the runtime has ended."""
    with RobotClient.connect(args.name) as robot:
        robot.ask(Subscribe(events=True))
        robot.ask(Shutdown())
        try:
            for _ in robot.messages(TIMEOUT_S):
                pass
        except RemoteError as error:
            if error.kind != "BusClosed":
                raise
            print_result(args, {"robot": robot.robot, "ended": True})
            return 0
    raise RemoteError("Timeout", f"robot {robot.robot} did not end within {TIMEOUT_S:g} s; see its status")
