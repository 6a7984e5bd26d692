"""Commands from a shell: repeated until Ctrl-C or for a while, then zeros, so that nothing keeps moving unattended."""

from __future__ import annotations

import argparse
import math
import signal
import threading
import time

from canopen_control.client import RobotClient
from canopen_control.host.signals import on_signals

__all__ = ["add_repeat_arguments", "finite", "send"]

PERIOD_S = 0.1


def add_repeat_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare how long a command lasts."""
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--for", type=seconds, metavar="S", dest="seconds", help="repeat for S seconds, then send zeros")
    how.add_argument(
        "--once", action="store_true", help="send it once; the controller's timeout decides how long it holds"
    )
    parser.add_argument("--name", help="the robot (default: the only one that runs)")


def finite(text: str) -> float:
    """Read a number that can be commanded: neither nan nor infinite."""
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no number") from None
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is no value that a drive could reach")
    return value


def send(args: argparse.Namespace, method: str, params: dict[str, object], zeros: dict[str, object]) -> int:
    """Send `params` once or at 10 Hz, and `zeros` at the end of it."""
    stopped = threading.Event()
    with on_signals((signal.SIGTERM,), stopped.set), RobotClient.connect(args.name) as robot:
        robot.request(method, params)
        if args.once:
            return 0
        end = None if args.seconds is None else time.monotonic() + args.seconds
        try:
            _repeat(robot, method, params, end, stopped)
        except KeyboardInterrupt:
            pass  # the usual way to end it
        finally:
            robot.request(method, zeros)
    return 0


def _repeat(
    robot: RobotClient, method: str, params: dict[str, object], end: float | None, stopped: threading.Event
) -> None:
    while not stopped.is_set():
        left = PERIOD_S if end is None else min(PERIOD_S, end - time.monotonic())
        if left <= 0 or stopped.wait(left):
            return
        robot.request(method, params)


def seconds(text: str) -> float:
    """Read a time in seconds above 0."""
    value = finite(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text!r} is no time in seconds above 0")
    return value
