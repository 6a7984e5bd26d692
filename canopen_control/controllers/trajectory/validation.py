"""Checks of trajectories: the rules of joint_trajectory_controller in their order, then additional rules.

Rules (ros2_controllers jazzy): the first broken rule rejects a trajectory. Safer than upstream: a trajectory is also
rejected if a value is not finite or exceeds the limits of its joint, a joint is named twice, or the first point is far
from the position of a joint.
"""

from __future__ import annotations

import enum
import math
import operator
from array import array
from bisect import bisect_right
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.controllers.limiters import PointLimiter, slow_stop
from canopen_control.controllers.trajectory.goal import ResultCode
from canopen_control.controllers.trajectory.point import Point, Points, shortest_angular_distance, whole_turns
from canopen_control.errors import ControlError, nearest
from canopen_control.urdf.joint_element import POSITION

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.controllers.trajectory.joint_group import JointGroup
    from canopen_control.controllers.trajectory.params import TrajectoryParams
    from canopen_control.controllers.trajectory.point import JointTrajectory
    from canopen_control.urdf.joint_element import Joint


# Summary of the points of a trajectory, computed piece by piece, for the rules that accept or refuse the trajectory.
#
# The time for a piece is bounded by its size, and the check of the whole trajectory takes no further time: it uses the
# first points with times that do not increase, with other sizes or with values that are not finite, and the extremes of
# each joint.


NONE: Final = -1
"""Point index that means "no point"."""


class Values(Protocol):
    """Values of a point, as attributes of a `Point` or a message; a list has one value per joint, or is empty.

    Units are rad, rad/s, rad/s2 and Nm (m, m/s, m/s2 and N for prismatic joints).
    """

    @property
    def positions(self) -> list[float]: ...

    @property
    def velocities(self) -> list[float]: ...

    @property
    def accelerations(self) -> list[float]: ...

    @property
    def effort(self) -> list[float]: ...


class Range:
    """Extremes of each joint in the points `begin` to `end` - 1."""

    __slots__ = ("begin", "end", "highest", "lowest")

    def __init__(self, begin: int, end: int, columns: Sequence[Sequence[float]]) -> None:
        self.begin, self.end = begin, end
        self.lowest, self.highest = list(map(min, columns)), list(map(max, columns))


class Extremes:
    """Extremes of each joint over all points, and over each range of points in `ranges`."""

    __slots__ = ("highest", "lowest", "ranges")

    def __init__(self) -> None:
        self.ranges: list[Range] = []
        self.lowest: list[float] = []
        self.highest: list[float] = []

    def add(self, result: Range) -> None:
        self.ranges.append(result)
        if len(result.lowest) != len(self.lowest):
            self.lowest, self.highest = result.lowest, result.highest
        else:
            self.lowest = list(map(min, self.lowest, result.lowest))
            self.highest = list(map(max, self.highest, result.highest))


class TrajectorySummary:
    """Summary of a trajectory's points: the first points that break rules, and the extremes of each joint.

    - `count`: number of points.
    - `not_increasing`, `empty`, `infinite`: index of the first point whose time is not after the previous one, that has
      neither positions nor velocities nor accelerations, or that has a value which is not finite; else NONE.
    - `sizes`: for positions, velocities, accelerations and efforts, the first point with each number of values.
    - `positions`, `velocities`, `means`: extremes of positions, velocities, and mean velocities since the previous
      point.
    """

    def __init__(self) -> None:
        self.count = 0
        self.not_increasing = self.empty = self.infinite = NONE
        self.sizes: tuple[dict[int, int], ...] = ({}, {}, {}, {})
        self.positions = Extremes()
        self.velocities = Extremes()
        self.means = Extremes()
        self._last = 0
        self._place: Sequence[float] = ()  # positions of the last point

    def add(self, points: Sequence[Values], times: Sequence[int]) -> None:
        """Add the next points; `times` are from the start in ns."""
        if not points:
            return
        begin, before = self.count, self._last
        self._check_times(times)
        columns = (
            [point.positions for point in points],
            [point.velocities for point in points],
            [point.accelerations for point in points],
            [point.effort for point in points],
        )
        empty = True
        for quantity, vectors in enumerate(columns):
            result = self._count_sizes(quantity, vectors)
            empty = empty and (quantity > 2 or 0 in result)
            if self.infinite == NONE or self.infinite >= begin:
                self._check_finite(vectors)
            if quantity < 2 and len(result - {0}) == 1:
                extremes = self.velocities if quantity else self.positions
                extremes.add(Range(begin, begin + len(points), list(zip(*filter(None, vectors), strict=True))))
        if empty and self.empty == NONE:
            none = (index for index, three in enumerate(zip(*columns[:3], strict=True)) if not any(three))
            self.empty = begin + next(none, NONE - begin)
        self.count += len(points)
        if self.not_increasing == self.infinite == NONE and len(self.sizes[0]) == 1:
            self._add_mean_velocities(begin, columns[0], before, times)

    def _add_mean_velocities(self, begin: int, positions: list[list[float]], before: int, times: Sequence[int]) -> None:
        """Add the extremes of the mean velocities between consecutive points."""
        last, self._place = self._place, positions[-1]
        instants = [time * 1e-9 for time in ((before, *times) if last else times)]
        seconds = list(map(operator.sub, instants[1:], instants))
        if seconds and positions[0]:
            columns = zip(*([last, *positions] if last else positions), strict=True)
            distance_columns = (map(operator.sub, column[1:], column) for column in columns)
            first = begin if last else begin + 1
            self.means.add(
                Range(first, first + len(seconds), [list(map(operator.truediv, d, seconds)) for d in distance_columns])
            )

    def sized(self, quantity: int, allowed: tuple[int, ...]) -> int:
        """Return the index of the first point with a forbidden number of values for a quantity, else NONE."""
        return min((at for size, at in self.sizes[quantity].items() if size not in allowed), default=NONE)

    def _check_times(self, times: Sequence[int]) -> None:
        if self.not_increasing == NONE:
            if self.count and times[0] <= self._last:
                self.not_increasing = self.count
            elif not all(map(operator.lt, times, times[1:])):
                late = (index for index in range(1, len(times)) if times[index] <= times[index - 1])
                self.not_increasing = self.count + next(late)
        self._last = times[-1]

    def _count_sizes(self, quantity: int, vectors: list[list[float]]) -> set[int]:
        sizes = list(map(len, vectors))
        distinct = set(sizes)
        firsts = self.sizes[quantity]
        for size in distinct:
            if size not in firsts:
                firsts[size] = self.count + sizes.index(size)
        return distinct

    def _check_finite(self, vectors: list[list[float]]) -> None:
        if math.isfinite(sum(chain.from_iterable(vectors))):
            return
        for index, values in enumerate(vectors, self.count):
            if not all(map(math.isfinite, values)):
                self.infinite = index if self.infinite == NONE else min(index, self.infinite)
                return


# The points of a trajectory that is received on a socket in pieces: packed into arrays, with a summary.
#
# The time to process a request is bounded by the size of the request, also that of the last one, however many points
# there are to check, to start or to discard. A point becomes an object only when the motion reaches it.


_FARTHEST_S: Final = 1e9
"""Maximum time of a point in s; larger times do not fit the clock."""


class TimedValues(Values, Protocol):
    """Values of a point with its time in s from the start of the trajectory, as received on a socket."""

    @property
    def time_from_start(self) -> float: ...


class _Column:
    """Values of one quantity for a piece of points, packed into one array.

    If the points have different numbers of values, they are stored as separate lists.
    """

    __slots__ = ("_odd", "_values", "_width")

    def __init__(self, vectors: list[list[float]]) -> None:
        self._width = len(vectors[0])
        even = set(map(len, vectors)) == {self._width}
        self._values = array("d", list(chain.from_iterable(vectors)) if even else ())
        self._odd = None if even else vectors

    def at(self, index: int) -> Sequence[float]:
        if self._odd is not None:
            return self._odd[index]
        return self._values[index * self._width : (index + 1) * self._width]


class SurveyedPoints(Points):
    """Sequence of points with the summary `survey` of all points."""

    survey: TrajectorySummary


class PointBuffer(SurveyedPoints):
    """Buffer for the points of a received trajectory, packed until they are accessed."""

    def __init__(self) -> None:
        self.times: array[int] = array("q")
        self.survey = TrajectorySummary()
        self._begins: list[int] = []
        self._pieces: list[tuple[_Column, _Column, _Column, _Column]] = []

    def add(self, points: Sequence[TimedValues]) -> None:
        """Add the next points; if a time is out of range, raise ControlError and add none."""
        seconds = [point.time_from_start for point in points]
        for index, time in enumerate(seconds, len(self)):
            if not -_FARTHEST_S <= time <= _FARTHEST_S:
                text = f"a time_from_start of {time:g} s"
                raise ControlError(f"point {index} has {text}; give at most {_FARTHEST_S:g}")
        times = array("q", [round(time * 1e9) for time in seconds])
        if not points:
            return
        self.survey.add(points, times)
        self._begins.append(len(self))
        self.times += times
        self._pieces.append(
            (
                _Column([point.positions for point in points]),
                _Column([point.velocities for point in points]),
                _Column([point.accelerations for point in points]),
                _Column([point.effort for point in points]),
            )
        )

    def positions(self, begin: int, end: int) -> list[Sequence[float]]:
        """Return the positions of the points `begin` to `end` - 1."""
        result: list[Sequence[float]] = []
        piece = bisect_right(self._begins, begin) - 1
        while begin < end:
            after = self._begins[piece + 1] if piece + 1 < len(self._begins) else len(self)
            until, first = min(end, after), self._begins[piece]
            result += map(self._pieces[piece][0].at, range(begin - first, until - first))
            begin, piece = until, piece + 1
        return result

    def __getitem__(self, index: int) -> Point:
        if index < 0:
            index += len(self)
        time = self.times[index]
        piece = bisect_right(self._begins, index) - 1
        at = index - self._begins[piece]
        positions, velocities, accelerations, effort = self._pieces[piece]
        return Point(positions.at(at), velocities.at(at), accelerations.at(at), effort.at(at), time)


_FLOAT_EPSILON: Final = 2.0**-23
_ROUNDING: Final = 1e-6
"""Tolerance of limits in rad or rad/s, since planners round differently."""

_WRITTEN: Final = 1.01
"""Factor by which a mean velocity may exceed a limit, since times are often written with few digits."""

_DAY: Final = 86_400_000_000_000


class Rule(enum.Enum):
    """Rules of joint_trajectory_controller, in the order of the checks."""

    JOINT_COUNT = enum.auto()
    NO_JOINT_NAMES = enum.auto()
    NO_POINTS = enum.auto()
    UNKNOWN_JOINT = enum.auto()
    END_VELOCITY = enum.auto()
    ENDS_IN_PAST = enum.auto()
    TIME_NOT_INCREASING = enum.auto()
    SIZE_POSITIONS = enum.auto()
    SIZE_VELOCITIES = enum.auto()
    SIZE_ACCELERATIONS = enum.auto()
    POINT_EMPTY = enum.auto()
    EFFORT_NOT_SUPPORTED = enum.auto()


_CODES: Final[dict[Rule | None, ResultCode]] = {
    Rule.JOINT_COUNT: ResultCode.INVALID_JOINTS,
    Rule.NO_JOINT_NAMES: ResultCode.INVALID_JOINTS,
    Rule.UNKNOWN_JOINT: ResultCode.INVALID_JOINTS,
    Rule.ENDS_IN_PAST: ResultCode.OLD_HEADER_TIMESTAMP,
}


@dataclass(frozen=True)
class Refused:
    """Refused trajectory, with the reason as text.

    `rule` is the broken rule of joint_trajectory_controller, None for an additional rule.
    """

    rule: Rule | None
    text: str

    @property
    def code(self) -> ResultCode:
        return _CODES.get(self.rule, ResultCode.INVALID_GOAL)


@dataclass(frozen=True)
class JointLimits:
    """Limits of a joint in the description, in rad and rad/s (or m and m/s); infinite if unlimited.

    `continuous` means that the joint turns endlessly.
    """

    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    continuous: bool = False


def survey_of(message: JointTrajectory) -> TrajectorySummary:
    """Return the summary of a trajectory's points, computed now unless the points include one."""
    if isinstance(message.points, SurveyedPoints):
        return message.points.survey
    summary = TrajectorySummary()
    summary.add(list(message.points), [point.time for point in message.points])
    return summary


def broken_rule(
    message: JointTrajectory, survey: TrajectorySummary, params: TrajectoryParams, now: int, *, effort: bool
) -> Refused | None:
    """Return a `Refused` for the first broken rule of joint_trajectory_controller, else None.

    `now` is in ns; `effort` means that the controller has a command interface for efforts.
    """
    refused = _wrong_joints(message, params) or _wrong_end(message, params, now)
    if refused is not None:
        return refused
    index = _first_wrong(survey, len(message.joint_names), params, effort=effort)
    if index == NONE:
        return None
    point = message.points[index]
    before = message.points[index - 1].time if index else point.time - 1
    if point.time <= before:
        times = f"{point.time / 1e9:g} s comes after {before / 1e9:g} s"
        return Refused(Rule.TIME_NOT_INCREASING, f"point {index}: {times}; time_from_start must increase")
    return _wrong_sizes(index, point, len(message.joint_names), params)


def _first_wrong(survey: TrajectorySummary, joints: int, params: TrajectoryParams, *, effort: bool) -> int:
    """Return the index of the first point that breaks a rule about points, else NONE."""
    integration = params.allow_integration_in_goal_trajectories
    wrong = (
        survey.not_increasing,
        survey.empty if integration else NONE,
        survey.sized(0, (0, joints) if integration else (joints,)),
        survey.sized(1, (0, joints)),
        survey.sized(2, (0, joints)),
        NONE if effort else survey.sized(3, (0,)),
    )
    return min((index for index in wrong if index != NONE), default=NONE)


def _wrong_joints(message: JointTrajectory, params: TrajectoryParams) -> Refused | None:
    names, joints = message.joint_names, ", ".join(params.joints)
    if not params.allow_partial_joints_goal and len(names) != len(params.joints):
        count = f"it names {len(names)} of {len(params.joints)} joints"
        return Refused(Rule.JOINT_COUNT, f"{count}; name {joints}, or set allow_partial_joints_goal")
    if not names:
        return Refused(Rule.NO_JOINT_NAMES, f"it names no joints; name some of {joints}")
    if not len(message.points):
        return Refused(Rule.NO_POINTS, "it has no points; give at least one")
    unknown = next((name for name in names if name not in params.joints), None)
    if unknown is not None:
        hint = nearest(unknown, params.joints)
        return Refused(Rule.UNKNOWN_JOINT, f"it names {unknown!r}, which is not a joint of this controller{hint}")
    return None


def _wrong_end(message: JointTrajectory, params: TrajectoryParams, now: int) -> Refused | None:
    last = message.points[-1]
    for index, velocity in enumerate(() if params.allow_nonzero_velocity_at_trajectory_end else last.velocities):
        if abs(velocity) > _FLOAT_EPSILON:
            speed = f"it ends with {_named(message.joint_names, index)} at {velocity:g} rad/s"
            return Refused(
                Rule.END_VELOCITY, f"{speed}; end it with 0, or set allow_nonzero_velocity_at_trajectory_end"
            )
    end = message.stamp + last.time
    if message.stamp and end < now:
        return Refused(Rule.ENDS_IN_PAST, f"it ended {_long(now - end)} ago; stamp it with the time of its start")
    return None


def _long(time: int) -> str:
    """Format a time in ns; more than a day suggests a stamp of another clock."""
    return f"{time / 1e9:g} s" if time < _DAY else f"{time / _DAY:.0f} days (by another clock?)"


def _wrong_sizes(index: int, point: Point, joints: int, params: TrajectoryParams) -> Refused:
    """Return the refusal of a point that `_first_wrong` found, and whose time is right."""
    sizes = (
        (Rule.SIZE_POSITIONS, "positions", len(point.positions)),
        (Rule.SIZE_VELOCITIES, "velocities", len(point.velocities)),
        (Rule.SIZE_ACCELERATIONS, "accelerations", len(point.accelerations)),
    )
    integration = params.allow_integration_in_goal_trajectories
    if integration and not any(size for _, _, size in sizes):
        return Refused(Rule.POINT_EMPTY, f"point {index} is empty; give positions, velocities or accelerations")
    for rule, quantity, size in sizes:
        needed = rule is Rule.SIZE_POSITIONS and not integration
        if size != joints and (size or needed):
            return Refused(rule, f"point {index} has {size} {quantity} for {joints} joints; give one for each")
    text = f"point {index} has effort, which no command interface accepts; remove it"
    return Refused(Rule.EFFORT_NOT_SUPPORTED, text)


def limit_error(message: JointTrajectory, survey: TrajectorySummary, limits: dict[str, JointLimits]) -> str | None:
    """Return an error if a joint is named twice, or if a value is not finite or exceeds a limit, else None."""
    names = message.joint_names
    for name in names:
        if names.count(name) > 1:
            return f"it names {name} twice; name each joint once"
    if survey.infinite != NONE:
        return _no_number(names, survey.infinite, message.points[survey.infinite])
    for index, name in enumerate(names):
        allowed = limits.get(name, JointLimits())
        lower, upper = (-math.inf, math.inf) if allowed.continuous else (allowed.lower, allowed.upper)
        if (exceeding := _outside(survey.positions, index, lower, upper)) is not None:
            at, worst = _place(message.points, exceeding, index, lower, upper, "positions")
            where = f"point {at}: {name} at {worst:g}"
            return f"{where} is beyond its limits of {allowed.lower:g} to {allowed.upper:g}; plan within them"
        if (exceeding := _outside(survey.velocities, index, -allowed.velocity, allowed.velocity)) is not None:
            at, worst = _place(message.points, exceeding, index, -allowed.velocity, allowed.velocity, "velocities")
            where = f"point {at}: {name} with a velocity of {worst:g}"
            return f"{where} is beyond its limit of {allowed.velocity:g}; plan within it"
    return None


def unreachable(message: JointTrajectory, survey: TrajectorySummary, limits: dict[str, JointLimits]) -> str | None:
    """Return a text about a point that a joint cannot reach in time within its velocity limit, else None."""
    for index, name in enumerate(message.joint_names if survey.means.ranges else ()):
        most = limits.get(name, JointLimits()).velocity
        if most == math.inf:
            continue
        exceeding = _outside(survey.means, index, -most * _WRITTEN, most * _WRITTEN)
        for at in range(exceeding.begin, exceeding.end) if exceeding is not None else ():
            before, point = message.points[at - 1], message.points[at]
            distance, seconds = point.positions[index] - before.positions[index], (point.time - before.time) / 1e9
            if abs(distance) > most * _WRITTEN * seconds:
                advice = f"give it {abs(distance) / most:.3g} s, or set" if most else "leave it where it is, or set"
                return (
                    f"point {at}: {name} would have to move {distance:g} in {seconds:g} s, "
                    f"faster than its limit of {most:g}; {advice} unreachable_points"
                )
    return None


def _no_number(names: Sequence[str], at: int, point: Point) -> str | None:
    for quantity, values in (
        ("position", point.positions),
        ("velocity", point.velocities),
        ("acceleration", point.accelerations),
        ("effort", point.effort),
    ):
        for index, value in enumerate(values):
            if not math.isfinite(value):
                return f"point {at}: the {quantity} of {_named(names, index)} is {value}; give finite numbers"
    return None


def _outside(extremes: Extremes, joint: int, lower: float, upper: float) -> Range | None:
    """Return the first range of points in which a joint exceeds its limits, else None."""
    lower, upper = lower - _ROUNDING, upper + _ROUNDING
    if not extremes.ranges or (lower <= extremes.lowest[joint] and extremes.highest[joint] <= upper):
        return None
    for value_range in extremes.ranges:
        if value_range.lowest[joint] < lower or value_range.highest[joint] > upper:
            return value_range
    return None


def _place(
    points: Sequence[Point] | Points, exceeding: Range, joint: int, lower: float, upper: float, quantity: str
) -> tuple[int, float]:
    """Return the index and the value of the first point in a range that exceeds the limits of a joint."""
    for at in range(exceeding.begin, exceeding.end):
        values = getattr(points[at], quantity)
        if values and not lower - _ROUNDING <= values[joint] <= upper + _ROUNDING:
            return at, values[joint]
    return exceeding.begin, math.nan


def far_start(
    message: JointTrajectory, here: Mapping[str, float], limits: Mapping[str, JointLimits], allowed: float
) -> str | None:
    """Return an error about the first joint that is over `allowed` rad or m from the first point, else None.

    If the first point is later than the start, the joint may be farther off by the distance that its velocity limit
    allows until then.
    """
    if allowed <= 0.0 or not len(message.points):
        return None
    first = message.points[0]
    time = max(first.time, 0) / 1e9
    for index, name in enumerate(message.joint_names):
        if index >= len(first.positions) or name not in here:
            continue
        bounds, begin = limits.get(name, JointLimits()), first.positions[index]
        distance = shortest_angular_distance(here[name], begin) if bounds.continuous else begin - here[name]
        if abs(distance) > allowed + (bounds.velocity * time if time > 0.0 else 0.0):
            return (
                f"it begins with {name} at {begin:g} after {time:g} s, but {name} is at {here[name]:g}; "
                f"plan from the actual position, or set allowed_start_tolerance"
            )
    return None


def lost_start(message: JointTrajectory, begin: int) -> str | None:
    """Return an error if the first point has no positions and is not in the future, else None.

    `begin` is the expected start of the motion in ns. A first point in the future is reached from the actual state.
    """
    if not len(message.points) or message.points[0].positions:
        return None
    arrival = message.points[0].time + (message.stamp or begin)
    if arrival > begin:
        return None
    return "point 0 has no positions and is not in the future; give it positions or a later time"


def _named(names: Sequence[str], index: int) -> str:
    return names[index] if index < len(names) else f"value {index}"


# Acceptance of trajectories: upstream's rules, then the limits of the joints and of the CANopen objects behind them.
#
# Trajectories are checked outside the cycle, by the summary of their points that was computed on reception (`survey`),
# so that the length of a trajectory does not delay the answer.


_NEXT: Final = 20_000_000
"""Time in ns within which an accepted trajectory starts: two cycles at 100 Hz."""


class Acceptance:
    """Check of trajectories for a group of joints; `limits` are from the description and the command interfaces."""

    def __init__(self, params: TrajectoryParams, group: JointGroup, description: Mapping[str, Joint]) -> None:
        self.limits = {joint: _limits_of(_joint_of(joint, description)) for joint in params.joints}
        self._params, self._group = params, group

    @property
    def continuous(self) -> list[bool]:
        """Flags of the continuous joints, in the order of the joints."""
        return [self.limits[joint].continuous for joint in self._params.joints]

    def set_params(self, params: TrajectoryParams) -> None:
        self._params = params

    def cannot_brake(self) -> str | None:
        """Return why `decelerate_on_cancel` has no effect, or None."""
        params = self._params
        if not params.decelerate_on_cancel:
            return None
        reason = None
        if not self._group.knows_velocity:
            reason = "state_interfaces have no velocity; add it"
        for joint, constraints in zip(params.joints, params.constraints, strict=True):
            if not constraints.max_deceleration_on_cancel:
                reason = reason or f"{joint} has no constraints.{joint}.max_deceleration_on_cancel; give it"
            if self.limits[joint].velocity == math.inf:
                reason = reason or f"the description has no velocity limit of {joint}; give it"
        return None if reason is None else f"decelerate_on_cancel has no effect, joints are held at once: {reason}"

    def slow_brake(self) -> str | None:
        """Return a warning about the joint that stops slowest after a cancelled goal, or None if none is too slow."""
        stops = self._brakes_s()
        joint = max(stops, key=stops.__getitem__, default="")
        return slow_stop(joint, stops.get(joint, 0.0), f"constraints.{joint}.max_deceleration_on_cancel")

    @property
    def brake_s(self) -> float:
        """Time in s in which the slowest joint brakes after a cancelled goal; 0 if the joints are held at once."""
        return 0.0 if self.cannot_brake() is not None else max(self._brakes_s().values(), default=0.0)

    def _brakes_s(self) -> dict[str, float]:
        """Return the time in s in which each joint brakes from its velocity limit after a cancelled goal."""
        params = self._params
        if not params.decelerate_on_cancel:
            return {}
        return {
            joint: self.limits[joint].velocity / constraints.max_deceleration_on_cancel
            for joint, constraints in zip(params.joints, params.constraints, strict=True)
            if constraints.max_deceleration_on_cancel and math.isfinite(self.limits[joint].velocity)
        }

    def point_limiter(self) -> PointLimiter | None:
        """Return a new limiter of the commanded points, or None if no limiter is configured."""
        if not self._params.joint_limiter_type:
            return None
        pairs = zip(self.limits.values(), self._params.joint_limits, strict=True)
        return PointLimiter(
            [limits.hard(described.lower, described.upper, described.velocity) for described, limits in pairs]
        )

    def apply_interface_limits(self) -> None:
        """Combine the limits of the description with the limits of the command interfaces.

        A joint whose interface has position limits is not continuous, even if its type is.
        """
        for index, command in enumerate(self._group.commands.get(POSITION, ())):
            joint = self._params.joints[self._group.places[index]]
            limits = self.limits[joint]
            lower, upper = max(limits.lower, command.minimum), min(limits.upper, command.maximum)
            endless = limits.continuous and math.isinf(command.minimum) and math.isinf(command.maximum)
            self.limits[joint] = JointLimits(lower, upper, limits.velocity, endless)

    def mistake(self, message: JointTrajectory, now: int, begin: Sequence[float]) -> Refused | None:
        """Return a `Refused` for an invalid trajectory, or None.

        `now` is in ns; `begin` are the positions of the joints from which the trajectory would start.
        """
        params, survey = self._params, survey_of(message)
        refused = broken_rule(message, survey, params, now, effort=self._group.has_effort)
        if refused is not None:
            return refused
        here = dict(zip(params.joints, begin, strict=True))
        problem = (
            limit_error(message, survey, self.limits)
            or lost_start(message, now + _NEXT)
            or far_start(message, here, self.limits, params.allowed_start_tolerance)
            or (self._unreachable(message) if params.unreachable_points == "refuse" else None)
            or self._range_refusal(message, survey, here)
        )
        return None if problem is None else Refused(None, problem)

    def unreachable_part(self, message: JointTrajectory) -> str | None:
        """Return a warning about a point that a joint cannot reach in time, if enabled, or None."""
        return self._unreachable(message) if self._params.unreachable_points == "warn" else None

    def _unreachable(self, message: JointTrajectory) -> str | None:
        """Return a text about a point that a joint cannot reach in time; None if a point limiter is configured."""
        return None if self._params.joint_limiter_type else unreachable(message, survey_of(message), self.limits)

    def _range_refusal(
        self, message: JointTrajectory, survey: TrajectorySummary, here: Mapping[str, float]
    ) -> str | None:
        """Return an error if a position is outside the range of the object behind its interface, else None.

        A continuous joint moves within the whole turn of its actual position.
        """
        joints, group = self._params.joints, self._group
        for index, command in enumerate(group.commands.get(POSITION, ())):
            joint = joints[group.places[index]]
            if joint not in message.joint_names or not survey.positions.ranges:
                continue
            place = message.joint_names.index(joint)
            first = message.points[0].positions if self.limits[joint].continuous else ()
            turns = whole_turns(here[joint], first[place]) if place < len(first) else 0.0
            for value in (survey.positions.lowest[place], survey.positions.highest[place]):
                if (problem := command.range_error(value + turns)) is not None:
                    return f"it leads {joint} to {value:g}, and {problem}; plan within this range"
        return None


def _joint_of(name: str, description: Mapping[str, Joint]) -> Joint | None:
    """Return a joint of the description, by its name or an exported name such as "loops/joint_1"."""
    return description.get(name) or description.get(name.rpartition("/")[2])


def _limits_of(joint: Joint | None) -> JointLimits:
    if joint is None:
        return JointLimits()
    limits = joint.limits
    return JointLimits(limits.lower, limits.upper, limits.speed, joint.type == "continuous")
