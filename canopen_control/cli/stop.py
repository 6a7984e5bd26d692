"""Ramp all joints down to a standstill and disable the drives; the robot keeps running.

This is not an emergency stop (ISO 13850). With `--latch` no client, not even this one, can move the robot until
`--release`. Without `--name` all running robots are stopped.

Exit codes: 0 stopped, or released; 1 no answer, no bus left, or nothing to release; 2 wrong usage, or no robot runs.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, TypedDict

from canopen_control.cli.support.output import print_result
from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError, ControlError
from canopen_control.host.sockets import find_robots
from canopen_control.rpc.messages.robot import GetStatus, Release, Stop

if TYPE_CHECKING:
    import argparse


EXAMPLE = "canopen-control stop"
NEXT = "to continue: canopen-control axis enable all"
LATCHED = "to continue: canopen-control stop --release"
WITHOUT_DRIVES = "no drive is disabled, so the next command moves it; to prevent this: canopen-control stop --latch"
SOURCE = "canopen-control stop"
TIMEOUT_S = 20.0


class StopResult(TypedDict):
    """Result for one robot; `disabled` is False for a robot without drives."""

    robot: str
    stopped: bool
    latched: bool
    disabled: bool


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--latch", action="store_true", help="latch the stop: no client can move the robot before --release"
    )
    group.add_argument("--release", action="store_true", help="release a latched stop; the drives stay disabled")
    parser.add_argument("--name", help="name of the robot (default: all running robots; with --release the only one)")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    names = find_robots() if args.name is None and not args.release else []
    if len(names) > 1:
        return _stop_all(args, names)
    done = _request(args, args.name)
    named = "" if args.name is None else f" --name {args.name}"
    print_result(args, done, f"{_done(args.latch, args.release, done['disabled'])}{named}")
    return 0


def _request(args: argparse.Namespace, name: str | None) -> StopResult:
    """Stop one robot, or release its stop; return the result."""
    with RobotClient.connect(name) as robot:
        if args.release and not robot.ask(GetStatus()).latched:
            raise ControlError(f"nothing was released, because no STOP of {robot.robot} is latched")
        robot.ask(Release(source=SOURCE) if args.release else Stop(latch=args.latch, source=SOURCE), TIMEOUT_S)
        has_drives = any(node.axes for node in robot.ask(GetStatus()).nodes.values())
        return {"robot": robot.robot, "stopped": not args.release, "latched": args.latch, "disabled": has_drives}


def _stop_all(args: argparse.Namespace, names: list[str]) -> int:
    """Stop all running robots at the same time, so that one that hangs delays no other; return the exit code."""
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(len(names)) as threads:
        requests = {name: threads.submit(_request, args, name) for name in names}
    errors = {name: error for name, request in requests.items() if (error := request.exception()) is not None}
    stopped = [request.result() for name, request in requests.items() if name not in errors]
    lines = [
        f"{done['robot']}: {_done(args.latch, False, done['disabled'])} --name {done['robot']}" for done in stopped
    ]
    print_result(args, {"robots": stopped}, "\n".join(lines))
    for name, error in errors.items():
        if not isinstance(error, CanopenError):
            raise error
        print(f"canopen-control: {error if name in str(error) else f'{name}: {error}'}", file=sys.stderr)
    return 1 if errors else 0


def _done(latch: bool, release: bool, has_drives: bool) -> str:
    """Return a sentence about the result and the next step."""
    if release:
        return f"released, the drives are disabled; {NEXT}" if has_drives else f"released; {WITHOUT_DRIVES}"
    disabled = " and disabled" if has_drives else ""
    if latch:
        return f"stopped{disabled}, and latched; {LATCHED}"
    return f"stopped and disabled; {NEXT}" if has_drives else f"stopped; {WITHOUT_DRIVES}"
