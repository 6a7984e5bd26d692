"""Drive a base with the keyboard, with the keys of teleop_twist_keyboard.

It commands the active base controller of a running robot; if none is active, a velocity controller of two wheels, in
rad/s of the wheels. Keys with shift drive sideways if the base can. With --topic it publishes to a ROS topic instead.
The base stops when no key arrives: --release seconds after a held key was released, --tap seconds after a key that was
only tapped (a terminal cannot report it earlier), and at once with space, k or any other key, when the terminal loses
the focus, and at the end of the program. This is not an emergency stop (ISO 13850).

Exit codes: 0 quit by the user; 1 the robot or the terminal is gone, or teleop was suspended; 2 wrong usage, no robot,
or no suitable controller.
"""

from __future__ import annotations

import contextlib
import sys
import time
from typing import TYPE_CHECKING, Final, TypeAlias

from canopen_control.cli.support.arguments import number, one_name, seconds
from canopen_control.cli.support.jog_run import Keyboard
from canopen_control.cli.support.parsers import add_robot_name
from canopen_control.client import RobotClient
from canopen_control.client.teleop_keys import HELP, SIDEWAYS_HELP, KeyDecoder, Teleop, Velocities
from canopen_control.errors import ConfigError, RemoteError
from canopen_control.host.signals import SuspensionWatch
from canopen_control.rpc.messages.robot import CommandController, GetStatus, ListControllers, Subscribe, TwistController
from canopen_control.rpc.messages.state import RobotEvent

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.robot import CommandDone
    from canopen_control.rpc.messages.state import ControllerReading

    TeleopTarget: TypeAlias = "TeleopRobot | RosTarget"


EXAMPLE = """canopen-control teleop
         canopen-control teleop --speed 0.2 --turn 0.5
         canopen-control teleop --topic /cmd_vel"""

PERIOD_S: Final = 0.1
ZEROS: Final = 3  # commands sent when a motion ends: one may be lost on a ROS topic
TIMEOUT_S: Final = 1.0  # for the answer to a command; a longer delay is reported
ZERO: Final = Velocities()
_BASE_SPEEDS: Final = (0.5, 1.0)  # m/s and rad/s
_WHEEL_SPEEDS: Final = (5.0, 5.0)  # rad/s of the wheels


_speed = number("speed above 0", lambda value: value > 0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--speed", type=_speed, metavar="V", help="linear velocity in m/s (default: 0.5)")
    parser.add_argument("--turn", type=_speed, metavar="W", help="angular velocity in rad/s (default: 1.0)")
    parser.add_argument(
        "--controller", type=one_name, metavar="NAME", help="controller name (default: the active base controller)"
    )
    parser.add_argument(
        "--tap",
        type=seconds,
        default=0.7,
        metavar="S",
        help="duration of the motion after a first press in s (default: 0.7)",
    )
    parser.add_argument(
        "--release",
        type=seconds,
        default=0.25,
        metavar="S",
        help="duration of the motion after a held key in s (default: 0.25)",
    )
    group = parser.add_mutually_exclusive_group()
    add_robot_name(group)
    group.add_argument("--topic", help="publish to this ROS topic instead, such as /cmd_vel")
    parser.add_argument("--stamped", action="store_true", help="with --topic: TwistStamped instead of Twist")
    parser.add_argument("--frame-id", metavar="F", default="", help="with --stamped: frame id of the header")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    if args.topic is None and (args.stamped or args.frame_id):
        raise ConfigError("--stamped and --frame-id require --topic")
    if args.topic is not None:
        from canopen_control.cli.ros import begin_ros

        begin_ros()  # may restart this process, so the terminal is changed afterwards
    with contextlib.ExitStack() as stack:
        keyboard = stack.enter_context(Keyboard())
        target: TeleopTarget = TeleopRobot(args) if args.topic is None else RosTarget(args, stack)
        stack.callback(target.close)
        speed, turn = target.speeds
        teleop = Teleop(
            args.speed or speed, args.turn or turn, first=args.tap, repeat=args.release, sideways=target.sideways
        )
        screen = Screen(target)
        suspension = stack.enter_context(SuspensionWatch())
        try:
            _drive(keyboard, teleop, target, screen, suspension)
        except KeyboardInterrupt:
            pass  # a signal from elsewhere: the terminal's own Ctrl-C is a key
        finally:
            _leave(target, screen)
    return 0


def _drive(
    keyboard: Keyboard, teleop: Teleop, target: TeleopTarget, screen: Screen, suspension: SuspensionWatch
) -> None:
    """Send the velocities that the user commands with keys, until the user quits.

    Raise CanopenError after a suspension.
    """
    decoder, sender = KeyDecoder(), Sender(target)
    while not (teleop.ended or keyboard.ended):
        screen.show(teleop, sender.refusal)
        data = keyboard.read(_wait(decoder, teleop))
        suspension.require_unsuspended()
        now = time.monotonic_ns()
        for key in decoder.feed(data, now) if data else decoder.tick(now):
            teleop.key(key, now)
        teleop.tick(now)
        if not sender.send(teleop.velocities, now):
            teleop.stop()
        screen.report(target.news())


def _wait(decoder: KeyDecoder, teleop: Teleop) -> float:
    """Return the time in s until the next timeout of a key, at most the period in which velocities are sent."""
    now = time.monotonic_ns()
    deadlines = [deadline for deadline in (decoder.next_deadline(), teleop.next_deadline()) if deadline is not None]
    return min(PERIOD_S, max((min(deadlines, default=now + 10**9) - now) / 1e9, 0.0))


def _leave(target: TeleopTarget, screen: Screen) -> None:
    """Command zero velocity several times and finish the status line, even if the robot or the terminal is gone."""
    with contextlib.suppress(RemoteError):  # after a refusal or a loss of the robot no command is active
        for _ in range(ZEROS):
            target.send(ZERO)
    with contextlib.suppress(OSError, ValueError):
        screen.end()


class Sender:
    """Sender of velocities; it sends them at each change and every 0.1 s during a motion, and a few zeros afterwards.

    `refusal` is the reason why the robot refused the last velocities, "" if it accepted them.
    """

    def __init__(self, target: TeleopTarget) -> None:
        self.refusal = ""
        self._target = target
        self._last, self._sent_ns, self._zeros = ZERO, 0, 0

    def send(self, velocities: Velocities, now: int) -> bool:
        """Send velocities if due; return False if the target refuses; raise RemoteError if the connection is lost."""
        changed = velocities != self._last
        if changed:
            self._zeros = 0 if velocities.moving else ZEROS
        is_due = now - self._sent_ns >= PERIOD_S * 1e9
        if not changed and not (is_due and (velocities.moving or self._zeros)):
            return True
        self._last, self._sent_ns, self._zeros = velocities, now, max(self._zeros - 1, 0)
        try:
            self._target.send(velocities)
        except RemoteError as error:
            if error.kind == "BusClosed":
                raise
            self.refusal = str(error)
            return False
        self.refusal = ""
        return True


class Screen:
    """Status line of teleop: rewritten in place on a terminal, otherwise printed at each change."""

    def __init__(self, target: TeleopTarget) -> None:
        self._before, self._after = ("\r", "\x1b[K") if sys.stdout.isatty() else ("", "\n")
        self._units, self._sideways = target.units, target.sideways
        self._shown = ""
        keys = f"{HELP}\n{SIDEWAYS_HELP}" if target.sideways else HELP
        print(f"teleop of {target.title}\n{keys}", flush=True)

    def show(self, teleop: Teleop, refusal: str) -> None:
        """Show the commanded velocities with a refusal or note."""
        velocities = teleop.velocities
        linear, angular = self._units
        values = [("linear", velocities.linear, linear), ("angular", velocities.angular, angular)]
        if self._sideways:
            values.insert(1, ("to the left", velocities.lateral, linear))
        words = ", ".join(f"{name} {value + 0.0:.2f} {unit}" for name, value, unit in values)
        note = refusal or teleop.note
        line = f"{words} (speeds {teleop.speed:.2f} and {teleop.turn:.2f}){f': {note}' if note else ''}"
        if line != self._shown:
            print(f"{self._before}{line}{self._after}", end="", flush=True)
            self._shown = line

    def report(self, news: Sequence[str]) -> None:
        for line in news:
            print(f"{self._before}{line}{self._after.rstrip(chr(10))}", flush=True)
            self._shown = ""

    def end(self) -> None:
        print(f"{self._before}stopped{self._after.rstrip(chr(10))}", flush=True)


class TeleopRobot:
    """Teleop target that commands a controller of a running robot.

    `units` and default `speeds` are pairs for linear and angular velocity.
    """

    def __init__(self, args: argparse.Namespace) -> None:
        self._robot = RobotClient.connect(args.name)
        try:
            controllers = self._robot.ask(ListControllers())
            chosen = choose(controllers, args.controller)
            self._name, self._is_base, self.sideways = chosen.name, chosen.is_base, chosen.drives_sideways
            self._signs = (1, 1) if self._is_base else sides(chosen.joints)
            self._robot.ask(Subscribe(events=True))
            hint = self._robot.ask(GetStatus()).hint
            self._news: list[str] = [] if hint is None else [hint]
        except BaseException:
            self._robot.close()
            raise
        wheels = "" if self._is_base else " (no base controller is active: the speeds apply to the wheels)"
        self.title = f"{self._robot.robot}, {self._name}{wheels}"
        self.units = ("m/s", "rad/s") if self._is_base else ("rad/s", "rad/s")
        self.speeds = _BASE_SPEEDS if self._is_base else _WHEEL_SPEEDS

    def send(self, velocities: Velocities) -> None:
        """Send a twist to a base controller, or wheel velocities to a controller of two wheels."""
        linear, angular = velocities.linear, velocities.angular
        request: Request[CommandDone]
        # dead_man: if this process is killed, the robot stops as soon as the connection is gone
        if self._is_base:
            request = TwistController(
                controller=self._name,
                linear=linear,
                lateral=velocities.lateral,
                angular=angular,
                source=_SOURCE,
                dead_man=True,
            )
        else:
            values = [linear + sign * angular for sign in self._signs]
            request = CommandController(controller=self._name, values=values, source=_SOURCE, dead_man=True)
        self._robot.ask(request, TIMEOUT_S)

    def news(self) -> list[str]:
        """Return sentences for the user about events since the last call."""
        events = [message for message in self._robot.messages(0) if isinstance(message, RobotEvent)]
        lines, self._news = [*self._news, *(event.text for event in events if event.level != "info")], []
        return lines

    def close(self) -> None:
        self._robot.close()


def choose(controllers: Sequence[ControllerReading], name: str | None) -> ControllerReading:
    """Return the controller `name`, or the only active controller that can drive.

    Raise ConfigError if no controller or more than one is suitable.
    """
    if name is not None:
        matching = [controller for controller in controllers if controller.name == name]
        if not matching:
            raise ConfigError(f"no controller {name!r}; available: {_names(controllers)}")
        return _usable(matching[0])
    active = [
        controller
        for controller in controllers
        if controller.active and controller.topic is not None and not controller.takes_outputs
    ]
    bases = [candidate for candidate in active if candidate.is_base]
    candidates = bases or active
    if len(candidates) > 1:
        raise ConfigError(f"several controllers are active: {_names(candidates)}; choose one with --controller")
    if not candidates:
        raise ConfigError(
            f"no active controller accepts commands; loaded: {_names(controllers)}. "
            "Activate one: canopen-control controller activate NAME"
        )
    return _usable(candidates[0])


def _usable(controller: ControllerReading) -> ControllerReading:
    name, joints = controller.name, controller.joints
    if not controller.active:
        raise ConfigError(f"{name} is {controller.state}; activate it: canopen-control controller activate {name}")
    if controller.is_base or (controller.interface == "velocity" and len(joints) == len(_LEFT_RIGHT)):
        return controller
    interface = controller.interface or "several interfaces"
    raise ConfigError(
        f"{name} commands {interface} of {len(joints)} joint{'' if len(joints) == 1 else 's'}; teleop drives a base or "
        f"two wheels by velocity. To command values: canopen-control command {name} VALUE..."
    )


_SOURCE: Final = "teleop"
_LEFT_RIGHT: Final = (-1, 1)  # signs of the angular speed: turning left, the left wheel goes backwards


def sides(joints: Sequence[str]) -> tuple[int, int]:
    """Return the signs of the angular speed for two wheels; the first is the left one unless the names differ."""
    swapped = "right" in joints[0].lower() or "left" in joints[1].lower()
    return (_LEFT_RIGHT[1], _LEFT_RIGHT[0]) if swapped else _LEFT_RIGHT


def _names(controllers: Sequence[ControllerReading]) -> str:
    return ", ".join(controller.name for controller in controllers) or "none"


class RosTarget:
    """Teleop target that publishes to a ROS topic with its own ROS node."""

    units = ("m/s", "rad/s")
    speeds = _BASE_SPEEDS
    sideways = True  # the subscriber is unknown; teleop_twist_keyboard also sends lateral velocities

    def __init__(self, args: argparse.Namespace, stack: contextlib.ExitStack) -> None:
        from canopen_control.ros.graph import open_graph

        self._stamped, self._frame_id = args.stamped, args.frame_id
        kind = f"geometry_msgs/msg/{'TwistStamped' if args.stamped else 'Twist'}"
        self._graph = stack.enter_context(open_graph())
        self._publication = self._graph.publisher(args.topic, kind, {})
        self._alone: bool | None = None
        self.title = f"{args.topic} ({kind})"
        self._topic = args.topic

    def send(self, velocities: Velocities) -> None:
        linear = {"x": velocities.linear, "y": velocities.lateral}
        twist: dict[str, object] = {"linear": linear, "angular": {"z": velocities.angular}}
        self._publication.fill(self._stamp(twist) if self._stamped else twist)
        self._publication.publish()
        self._graph.spin(0.0)

    def _stamp(self, twist: dict[str, object]) -> dict[str, object]:
        sec, nanosec = divmod(time.time_ns(), 10**9)
        return {"header": {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": self._frame_id}, "twist": twist}

    def news(self) -> list[str]:
        """Report the connection of the first subscriber and the disconnection of the last."""
        alone = self._publication.subscribers() == 0
        before, self._alone = self._alone, alone
        if alone == before or (before is None and not alone):
            return []
        return [f"{self._topic} has no subscriber" if alone else f"{self._topic} has a subscriber"]

    def close(self) -> None:
        """Do nothing, since the caller closes the ROS graph."""
