"""Client of a running robot for the calibration of its base: sends twists, reads odometry, sets wheel factors.

The commands are sent on one connection, and end with the connection and with the controller's timeout. A refused
command, a stop, a fault or a robot that sends nothing ends a square with an error text.
"""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.calibration.umbmark import relative
from canopen_control.data_files import read_utf8
from canopen_control.errors import ConfigError, ControlError, RemoteError
from canopen_control.rpc.messages.parameters import GetParameters, ParameterValue, SetParameters
from canopen_control.rpc.messages.robot import ListControllers, Subscribe, TwistController
from canopen_control.rpc.messages.samples import OdometrySample
from canopen_control.rpc.messages.state import WHEEL_CALIBRATION, StateSample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from canopen_control.calibration.umbmark import SquarePath
    from canopen_control.client import RobotClient
    from canopen_control.rpc.messages.state import ControllerReading, Planar, TruePose


# -- measured end positions of a base, typed by the user or read from a file; X and Y in m, one position per line


def parse_end(text: str) -> tuple[float, float]:
    """Return X and Y of a text such as ``0.012 -0.034``, with or without a comma; raise ConfigError if invalid."""
    words = text.replace(",", " ").split()
    try:
        x, y = (float(word) for word in words)
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ConfigError(
            f"{text.strip()!r} is not an end position: write X Y, metres ahead and to the left, as in 0.012 -0.034"
        )
    return x, y


class TypedEnds:
    """Source of end positions that a user types; `ask` shows a prompt and returns a line, or raises EOFError."""

    def __init__(self, ask: Callable[[str], str], report: Callable[[str], object]) -> None:
        self._ask, self._report = ask, report

    def before(self, text: str) -> None:
        self._report(text)
        self._line("  put the base at its start, keep clear, and press Enter to drive ")

    def end(self, text: str, driven: Driven) -> tuple[float, float]:  # noqa: ARG002 - used by `TrueEnds`
        """Ask for the end position of a square until the reply is valid."""
        while True:
            try:
                return parse_end(self._line("  end position X Y, in m ahead and to the left of the start: "))
            except ConfigError as error:
                self._report(f"  {error}")

    def _line(self, prompt: str) -> str:
        try:
            return self._ask(prompt)
        except EOFError:
            raise ControlError("standard input was closed; the calibration has ended") from None


class FiledEnds:
    """Source of end positions from a file, in the order of the lines."""

    def __init__(self, ends: Sequence[tuple[float, float]], report: Callable[[str], object]) -> None:
        self._ends, self._report = list(ends), report

    def before(self, text: str) -> None:
        self._report(text)

    def end(self, text: str, driven: Driven) -> tuple[float, float]:  # noqa: ARG002 - used by `TrueEnds`
        """Return the end position from the next line."""
        return self._ends.pop(0)


def read_ends(path: Path, count: int, report: Callable[[str], object]) -> FiledEnds:
    """Read end positions from a file, ignoring empty lines and ``# comments``.

    Raise ConfigError with all errors and their lines, or if there are fewer than `count` positions.
    """
    try:
        lines = read_utf8(path).splitlines()
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from error
    ends, problems = [], []
    for number, line in enumerate(lines, 1):
        if text := line.partition("#")[0].strip():
            try:
                ends.append(parse_end(text))
            except ConfigError as error:
                problems.append(f"{path}:{number}: {error}")
    if not problems and len(ends) < count:
        problems.append(f"{path} has {len(ends)} end positions for {count} squares; give one for each square")
    if problems:
        raise ConfigError("\n".join(problems))
    return FiledEnds(ends, report)


#: parameters that a calibration changes: the multipliers of the track, and of the left and right radius
FACTORS: Final = ("wheel_separation_multiplier", "left_wheel_radius_multiplier", "right_wheel_radius_multiplier")
_SOURCE: Final = "calibrate"
_RATE: Final = 50.0  # maximum rate of odometry in Hz
_SILENT_S: Final = 1.0  # time after which a silent robot counts as lost
_LONGEST_GAP_S: Final = 0.5  # between two commands: the default of cmd_vel_timeout
_BEGIN_S: Final = 3.0  # timeout of the first odometry, which follows the first twist
_REST_S: Final = 3.0  # time allowed for a base to stop before its values are set
_ENDING: Final = ("stopping", "stopped")


@dataclass(frozen=True, slots=True)
class WheelValues:
    """Wheel values and limits of a controller: track in m including its multiplier, and the multipliers `FACTORS`."""

    separation: float
    factors: tuple[float, float, float]
    max_linear: float = math.inf  # m/s
    max_angular: float = math.inf  # rad/s
    linear_ramp: float = math.inf  # m/s^2
    angular_ramp: float = math.inf  # rad/s^2


@dataclass(frozen=True, slots=True)
class Driven:
    """End of a square relative to its start: by odometry, and the true end if the robot is simulated."""

    odometry: Planar
    truth: Planar | None = None


def choose_base(controllers: tuple[ControllerReading, ...], name: str | None) -> ControllerReading:
    """Return the diff drive controller to calibrate, by name or the only active one; raise ConfigError if none fits."""
    names = ", ".join(controller.name for controller in controllers)
    bases = [controller for controller in controllers if WHEEL_CALIBRATION in controller.offers]
    matches = [controller for controller in bases if controller.name == name] if name is not None else bases
    if name is not None and not matches:
        raise ConfigError(f"{name!r} is not a diff drive controller of the robot; it has: {names}")
    if not matches:
        raise ConfigError(f"the robot has no diff drive controller, which is what UMBmark calibrates; it has: {names}")
    active = [controller for controller in matches if controller.active] or matches
    if len(active) > 1:
        raise ConfigError(
            f"several diff drive controllers are possible: {', '.join(controller.name for controller in active)}; "
            "give --controller NAME"
        )
    if not active[0].active:
        raise ConfigError(
            f"{active[0].name} is {active[0].state}; activate it: canopen-control controller switch --activate "
            f"{active[0].name}, with --deactivate for the controller that has claimed its wheels"
        )
    return active[0]


class BaseLink:
    """Connection to the robot with the base to calibrate; `controller` is the name of the diff drive controller."""

    def __init__(self, robot: RobotClient, controller_name: str | None = None) -> None:
        self._robot = robot
        self._sent_s = 0.0
        self.controller = choose_base(robot.ask(ListControllers()), controller_name).name

    def wheel_values(self) -> WheelValues:
        """Return the wheel values; raise ConfigError for a controller with one multiplier for both radii."""
        params = {
            parameter.name: parameter.plain for parameter in self._robot.ask(GetParameters(controller=self.controller))
        }

        def value(name: str, otherwise: float = math.nan) -> float:
            current = params.get(name)
            number = float(current) if isinstance(current, int | float) else math.nan
            return otherwise if math.isnan(number) else number

        if not math.isnan(value("wheel_radius_multiplier")):
            raise ConfigError(
                f"{self.controller} has a wheel_radius_multiplier, which overrides those of both sides; multiply "
                "wheel_radius by it, and remove it"
            )
        separation, left, right = (value(name, 1.0) for name in FACTORS)
        return WheelValues(
            value("wheel_separation") * separation,
            (separation, left, right),
            abs(value("linear.x.max_velocity", math.inf)),
            abs(value("angular.z.max_velocity", math.inf)),
            abs(value("linear.x.max_deceleration", math.inf)),
            abs(value("angular.z.max_deceleration", math.inf)),
        )

    def set_factors(self, factors: tuple[float, float, float]) -> None:
        """Set the multipliers of the controller, with retries while the base moves; raise RemoteError if refused."""
        values = tuple(
            ParameterValue(name=name, kind="double", value=value) for name, value in zip(FACTORS, factors, strict=True)
        )
        until = time.monotonic() + _REST_S
        while True:
            try:
                self._robot.ask(SetParameters(controller=self.controller, values=values))
            except RemoteError as error:
                if "at standstill" not in str(error) or time.monotonic() > until:
                    raise
                time.sleep(0.1)
            else:
                return

    def true_pose(self) -> TruePose | None:
        """Return the true pose of a simulated base, or None for a real base."""
        with self._watching():
            for state in self._states():
                return state.true_pose
        return None

    def drive(self, path: SquarePath) -> Driven:
        """Drive a square to its end, and return the end position.

        Raise ControlError or RemoteError if the square cannot be completed. In any case the base is stopped.
        """
        starts: tuple[Planar, TruePose | None] | None = None
        begun = time.monotonic()
        with self._watching():
            self._twist(0.0, 0.0)
            try:
                for state in self._states():
                    odometry = self._odometry(state, begun)
                    if odometry is None:
                        continue
                    pose = odometry.x, odometry.y, odometry.heading
                    starts = starts or (pose, state.true_pose)
                    twist = path.twist(pose, state.time)
                    self._require_renewed()
                    self._twist(*twist)
                    if path.done:
                        return Driven(relative(pose, starts[0]), _true_motion(starts[1], state.true_pose))
            finally:
                with contextlib.suppress(RemoteError):  # a robot that has ended or refuses commands does not move
                    self._twist(0.0, 0.0)
        raise ControlError("the robot sends no more messages")

    def _odometry(self, state: StateSample, begun: float) -> OdometrySample | None:
        """Return the odometry in a state sample, or None before the first.

        Raise ControlError if the base may not move, or if no odometry arrives in time.
        """
        if state.latched:
            raise ControlError(f"STOP, by {state.latched_by or 'an unnamed client'}")
        if state.hint is not None:
            raise ControlError(state.hint)
        if state.state in _ENDING:
            raise ControlError(f"the robot is {state.state}")
        if state.state == "fault":
            wrong = [f"{name}: {node.reason(name) or 'not present'}" for name, node in state.nodes.items()
                     if node.error or not node.ready]  # fmt: skip
            raise ControlError(
                f"the robot is in fault: {'; '.join(wrong) or 'a drive is silent, see canopen-control status'}"
            )
        sample = state.samples.get(self.controller)
        if isinstance(sample, OdometrySample):
            return sample
        if time.monotonic() - begun > _BEGIN_S:
            raise ControlError(f"{self.controller} publishes no odometry; is it active, with a publish_rate?")
        self._twist(0.0, 0.0)
        return None

    def _require_renewed(self) -> None:
        """Raise ControlError if the last command has timed out, so that a resumed program does not move the base."""
        silent_s = time.monotonic() - self._sent_s
        if silent_s > _LONGEST_GAP_S:
            raise ControlError(f"no command was sent for {silent_s:.1f} s; this program was suspended, or is too slow")

    def _twist(self, linear: float, angular: float) -> None:
        request = TwistController(
            controller=self.controller, linear=linear, angular=angular, source=_SOURCE, dead_man=True
        )
        self._robot.ask(request, _SILENT_S)
        self._sent_s = time.monotonic()

    @contextlib.contextmanager
    def _watching(self) -> Iterator[None]:
        """Subscribe to state samples during the context, and discard remaining messages afterwards."""
        self._robot.ask(Subscribe(state_rate=_RATE))
        try:
            yield
        finally:
            with contextlib.suppress(RemoteError):
                self._robot.ask(Subscribe(state_rate=None))
                for _ in self._robot.messages(0):
                    pass

    def _states(self) -> Iterator[StateSample]:
        """Yield the latest state sample each time; raise ControlError if none arrives within `_SILENT_S`."""
        while True:
            newest: StateSample | None = None
            for message in self._robot.messages(_SILENT_S):
                if isinstance(message, StateSample):
                    newest = message
                    break
            if newest is None:
                raise ControlError(
                    f"the robot has sent nothing for {_SILENT_S:g} s; its process may be stopped or blocked"
                )
            for message in self._robot.messages(0):
                newest = message if isinstance(message, StateSample) else newest
            yield newest


def _true_motion(start: TruePose | None, end: TruePose | None) -> Planar | None:
    if start is None or end is None:
        return None
    return relative((end.x, end.y, end.heading), (start.x, start.y, start.heading))
