"""Commands to a controller, repeated until Ctrl-C or for a given time, then set to zero.

Repeated commands end with this process; a command with `--once` ends after its timeout. Drives that are being enabled
are awaited; if nothing can move, the command ends with the robot's error and exit code 1. A joint that does not follow
while others move is named, and the exit code is 1 if the last command left a joint out. The end of a command causes no
new motion: a velocity or an effort becomes zero. A position is not set to zero, which would be a new target; when
the connection closes, the joint holds its actual position.
"""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
import time
from typing import TYPE_CHECKING

from canopen_control.cli.support.arguments import seconds
from canopen_control.cli.support.output import print_result
from canopen_control.cli.support.parsers import add_robot_name
from canopen_control.client import RobotClient
from canopen_control.errors import ConfigError, RemoteError
from canopen_control.host.signals import SuspensionWatch, on_signals
from canopen_control.rpc.messages.robot import CommandDone, ListControllers

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator, Sequence

    from canopen_control.rpc.messages.robot import CommandByName, CommandController, TwistController
    from canopen_control.rpc.messages.state import ControllerReading

    Command = CommandByName | CommandController | TwistController


PERIOD_S = 0.1
TARGET = "target"
ENABLING_S = 3.0  # timeout for drives that are being enabled
_RETRY_S = 0.05
_NOT_YET_ENABLED = "NotYetEnabled"
_NOT_ENABLED = "NotEnabled"


def add_repeat_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare `--for` and `--once`, and the option for the name of the robot."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--for", type=seconds, metavar="S", dest="seconds", help="repeat for S seconds, then send zeros")
    group.add_argument(
        "--once", action="store_true", help="send once; the command is valid until the controller's timeout"
    )
    add_robot_name(parser)


def send(args: argparse.Namespace, command: Command, zeros: Command | None) -> int:
    """Send `command` once or at 10 Hz, and `zeros` at the end; raise RemoteError if the robot refuses a command.

    Without `zeros` the command ends when the connection is closed. Return 1 if a joint did not follow the last command,
    else 0.
    """
    stopped = threading.Event()
    with (
        on_signals((signal.SIGTERM,), stopped.set),
        SuspensionWatch() as suspension,
        RobotClient.connect(args.name) as robot,
    ):
        idle = _Idle(_begin(robot, command, stopped, suspension))
        sent = 1
        end = None if args.seconds is None else time.monotonic() + args.seconds
        commands = () if args.once else _repeat(robot, command, end, stopped, suspension)
        try:
            for done in commands:
                sent += 1
                idle.take(done)
        except KeyboardInterrupt:
            pass  # the usual end of the verb
        finally:
            if zeros is not None and not args.once:
                # after a suspension the robot may have closed the connection, which has ended the command
                with contextlib.suppress(RemoteError) if suspension.seconds else _ignore_disabled_drives():
                    robot.ask(zeros)
    print_result(args, {"controller": args.controller, "sent": sent, "once": args.once, "idle": idle.last})
    return 1 if idle.last else 0


class _Idle:
    """Joints that do not follow the commands, each printed once; `last` maps those of the last command to reasons."""

    def __init__(self, first: CommandDone) -> None:
        self._named: set[str] = set()
        self.last: dict[str, str] = {}
        self.take(first)

    def take(self, done: CommandDone) -> None:
        self.last = done.idle
        for joint, reason in done.idle.items():
            if joint not in self._named:
                self._named.add(joint)
                print(f"canopen-control: {joint} does not follow: {reason}", file=sys.stderr, flush=True)


@contextlib.contextmanager
def _ignore_disabled_drives() -> Iterator[None]:
    """Context that ignores the refusal of a command while drives are disabled, since nothing moves then."""
    try:
        yield
    except RemoteError as error:
        if error.kind not in (_NOT_YET_ENABLED, _NOT_ENABLED):
            raise


def _begin(robot: RobotClient, command: Command, stopped: threading.Event, suspension: SuspensionWatch) -> CommandDone:
    """Send the first command, repeatedly while drives are being enabled, for at most `ENABLING_S`."""
    end = time.monotonic() + ENABLING_S
    while True:
        suspension.require_unsuspended()
        try:
            return robot.ask(command)
        except RemoteError as error:
            if error.kind != _NOT_YET_ENABLED or time.monotonic() > end or stopped.wait(_RETRY_S):
                raise


def _repeat(
    robot: RobotClient, command: Command, end: float | None, stopped: threading.Event, suspension: SuspensionWatch
) -> Iterator[CommandDone]:
    """Send the command every `PERIOD_S`; yield each answer, an empty one while drives are being enabled.

    Raise CanopenError after a suspension.
    """
    while not stopped.is_set():
        delay = PERIOD_S if end is None else min(PERIOD_S, end - time.monotonic())
        ended = delay <= 0 or stopped.wait(delay)
        suspension.require_unsuspended()
        if ended:
            return
        try:
            done = robot.ask(command)
        except RemoteError as error:
            if error.kind != _NOT_YET_ENABLED:
                raise
            done = CommandDone()
        yield done


def ask_for_controllers(robot: str | None) -> Sequence[ControllerReading]:
    """Return the loaded controllers of a robot."""
    with RobotClient.connect(robot) as client:
        return client.ask(ListControllers())


def values_at_the_end(controllers: Sequence[ControllerReading], name: str, values: list[float]) -> list[float] | None:
    """Return the last values of a command: the commanded value for a position or target, otherwise 0.

    All are 0 if the controller is unknown or takes another number of values. Return None for outputs, which have safe
    values.
    """
    if any(controller.name == name and controller.takes_outputs for controller in controllers):
        return None
    positions = positions_of(controllers, name)
    if len(positions) != len(values):
        return [0.0] * len(values)
    return [value if position else 0.0 for value, position in zip(values, positions, strict=True)]


def target_interface(controllers: Iterable[ControllerReading], name: str) -> str | None:
    """Return the interface that a `target` controller commands in the current mode of operation, or None."""
    interfaces = [
        controller.interface for controller in controllers if controller.name == name and controller.topic == TARGET
    ]
    return next((interface for interface in interfaces if interface != TARGET), None)


def positions_of(controllers: Iterable[ControllerReading], name: str) -> list[bool]:
    """Return, for each command value of a controller, whether it may be a position; [] if the controller is unknown.

    The meaning of a target depends on the mode of operation of the drive.
    """
    interfaces = [
        interface
        for controller in controllers
        if controller.name == name
        for interface in controller.required_command_interfaces
    ]
    return [interface.endswith(("/position", "/target")) for interface in interfaces]


def find_controller(robot: RobotClient, name: str | None, samples: str, title: str) -> ControllerReading:
    """Return the controller `name`, or if it is None the only active controller that publishes `samples`.

    Raise ConfigError if there is no such controller or more than one; `title` is the kind of controller in the message.
    """
    controllers = robot.ask(ListControllers())
    if name is not None:
        named = next((controller for controller in controllers if controller.name == name), None)
        if named is None:
            loaded = ", ".join(controller.name for controller in controllers)
            raise ConfigError(f"no controller {name!r} is loaded; available: {loaded}")
        return named
    matching = [controller for controller in controllers if controller.tells == samples and controller.active]
    if len(matching) != 1:
        names = ", ".join(controller.name for controller in matching)
        problem = f"several are active: {names}" if matching else f"no {title} is active"
        raise ConfigError(f"{problem}; name one with --controller, see canopen-control controller list")
    return matching[0]
