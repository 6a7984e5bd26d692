"""Ramp every joint to zero and disable the drives; the robot keeps running. Not an emergency stop (ISO 13850).

With `--latch` no client, not even this one, can move the robot until `--release`.

Exit codes: 0 stopped, or released; 1 the robot does not answer, or has no bus left; 2 wrong usage, or no robot runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cli.support.output import print_result
from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import GetStatus, Release, Stop

if TYPE_CHECKING:
    import argparse


EXAMPLE = "canopen-control stop"
NEXT = "to continue: canopen-control axis enable all"
LATCHED = "to continue: canopen-control stop --release"
WITHOUT_DRIVES = "no drive is disabled, so the next command moves it; to prevent this: canopen-control stop --latch"
SOURCE = "canopen-control stop"
TIMEOUT_S = 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--latch", action="store_true", help="latch the stop: no client can move the robot before --release"
    )
    group.add_argument("--release", action="store_true", help="release a latched stop; the drives stay disabled")
    parser.add_argument("--name", help="the robot (default: the only one that runs)")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    with RobotClient.connect(args.name) as robot:
        robot.ask(Release(source=SOURCE) if args.release else Stop(latch=args.latch, source=SOURCE), TIMEOUT_S)
        has_drives = bool(robot.ask(GetStatus()).nodes)
        done = {
            "robot": robot.robot,
            "stopped": not args.release,
            "latched": args.latch,
            "disabled": has_drives,
        }
    print_result(args, done, _done(args.latch, args.release, has_drives))
    return 0


def _done(latch: bool, release: bool, has_drives: bool) -> str:
    """Return a sentence about the result and the next step."""
    if release:
        return f"released, the drives are disabled; {NEXT}" if has_drives else f"released; {WITHOUT_DRIVES}"
    disabled = " and disabled" if has_drives else ""
    if latch:
        return f"stopped{disabled}, and latched; {LATCHED}"
    return f"stopped and disabled; {NEXT}" if has_drives else f"stopped; {WITHOUT_DRIVES}"
