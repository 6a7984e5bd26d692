"""Which trajectories are taken: the rules of upstream in their order, then ours of what a joint can bear.

The law of the file (ros2_controllers jazzy): the first rule that is broken rejects. Ours, and safer: what is no number,
is beyond the limits of its joint, names a joint twice or begins far from where the joint is, is rejected as well.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.trajectory.goal import ResultCode
from canopen_control.controllers.trajectory.wraparound import shortest_angular_distance
from canopen_control.errors import nearest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.trajectory.point import JointTrajectory, Point

__all__ = ["JointLimits", "Refused", "Rule", "Rules", "beyond", "broken_rule", "column", "far_start"]

_FLOAT_EPSILON: Final = 2.0**-23
_ROUNDING: Final = 1e-6
"""By how much a planner's numbers may exceed a limit, in rad or rad/s: it computes with its own rounding."""


class Rule(enum.Enum):
    """The rules of upstream, in their order."""

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

    @property
    def code(self) -> ResultCode:
        """The code that a goal which breaks it is refused with."""
        return _CODES.get(self, ResultCode.INVALID_GOAL)


_CODES: Final = {
    Rule.JOINT_COUNT: ResultCode.INVALID_JOINTS,
    Rule.NO_JOINT_NAMES: ResultCode.INVALID_JOINTS,
    Rule.UNKNOWN_JOINT: ResultCode.INVALID_JOINTS,
    Rule.ENDS_IN_PAST: ResultCode.OLD_HEADER_TIMESTAMP,
}


@dataclass(frozen=True)
class Refused:
    """Why a trajectory is refused: the rule, and the sentence."""

    rule: Rule
    text: str


@dataclass(frozen=True)
class Rules:
    """What a controller takes, by the names of its parameters."""

    joints: tuple[str, ...]
    partial: bool = False
    nonzero_end_velocity: bool = False
    integration: bool = False
    effort: bool = False


@dataclass(frozen=True)
class JointLimits:
    """What the description allows a joint, in rad and rad/s (m): infinite where it says nothing.

    `continuous` turns without end.
    """

    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    continuous: bool = False


def broken_rule(message: JointTrajectory, rules: Rules, now: int) -> Refused | None:
    """Return the first rule of upstream that a trajectory breaks, None if none; `now` in ns."""
    refused = _wrong_joints(message, rules) or _wrong_end(message, rules, now)
    if refused is not None:
        return refused
    points = message.points
    for index, point in enumerate(points):
        if index and point.time <= points[index - 1].time:
            times = f"{point.time / 1e9:g} s comes after {points[index - 1].time / 1e9:g} s"
            return Refused(Rule.TIME_NOT_INCREASING, f"point {index}: {times}; let time_from_start increase")
        if (refused := _wrong_sizes(index, point, len(message.joint_names), rules)) is not None:
            return refused
    return None


def _wrong_joints(message: JointTrajectory, rules: Rules) -> Refused | None:
    names, known = message.joint_names, ", ".join(rules.joints)
    if not rules.partial and len(names) != len(rules.joints):
        count = f"it names {len(names)} of {len(rules.joints)} joints"
        return Refused(Rule.JOINT_COUNT, f"{count}; name {known}, or set allow_partial_joints_goal")
    if not names:
        return Refused(Rule.NO_JOINT_NAMES, f"it names no joints; name some of {known}")
    if not message.points:
        return Refused(Rule.NO_POINTS, "it has no points; give at least one")
    strange = next((name for name in names if name not in rules.joints), None)
    if strange is not None:
        hint = nearest(strange, rules.joints)
        return Refused(Rule.UNKNOWN_JOINT, f"it names {strange!r}, no joint of this controller{hint}")
    return None


def _wrong_end(message: JointTrajectory, rules: Rules, now: int) -> Refused | None:
    last = message.points[-1]
    for index, velocity in enumerate(() if rules.nonzero_end_velocity else last.velocities):
        if abs(velocity) > _FLOAT_EPSILON:
            speed = f"it ends with {_named(message.joint_names, index)} at {velocity:g} rad/s"
            return Refused(
                Rule.END_VELOCITY, f"{speed}; end it with 0, or set allow_nonzero_velocity_at_trajectory_end"
            )
    end = message.stamp + last.time
    if message.stamp and end < now:
        return Refused(Rule.ENDS_IN_PAST, f"it ended {(now - end) / 1e9:g} s ago; stamp it with the time of its start")
    return None


def _wrong_sizes(index: int, point: Point, joints: int, rules: Rules) -> Refused | None:
    sizes = (
        (Rule.SIZE_POSITIONS, "positions", len(point.positions)),
        (Rule.SIZE_VELOCITIES, "velocities", len(point.velocities)),
        (Rule.SIZE_ACCELERATIONS, "accelerations", len(point.accelerations)),
    )
    if rules.integration and not any(size for _, _, size in sizes):
        return Refused(Rule.POINT_EMPTY, f"point {index} is empty; give positions, velocities or accelerations")
    for rule, what, size in sizes:
        needed = rule is Rule.SIZE_POSITIONS and not rules.integration
        if size != joints and (size or needed):
            return Refused(rule, f"point {index} has {size} {what} for {joints} joints; give one for each")
    if point.effort and not rules.effort:
        return Refused(
            Rule.EFFORT_NOT_SUPPORTED, f"point {index} has effort, which no command interface takes; leave it out"
        )
    return None


def beyond(message: JointTrajectory, limits: dict[str, JointLimits]) -> str | None:
    """Say what in a trajectory is no number or beyond the limits of its joint, None if nothing is."""
    names = message.joint_names
    for name in names:
        if names.count(name) > 1:
            return f"it names {name} twice; name each joint once"
    for at, point in enumerate(message.points):
        for what, values in (
            ("position", point.positions),
            ("velocity", point.velocities),
            ("acceleration", point.accelerations),
            ("effort", point.effort),
        ):
            if not all(map(math.isfinite, values)):
                index = [math.isfinite(each) for each in values].index(False)
                return f"point {at}: the {what} of {_named(names, index)} is {values[index]}; give finite numbers"
    return _beyond_limits(message, limits)


def column(points: Sequence[Sequence[float]], index: int) -> list[float]:
    """Return one joint's values of all points that have them."""
    return [each[index] for each in points if each]


def _beyond_limits(message: JointTrajectory, limits: dict[str, JointLimits]) -> str | None:
    """Compare the extremes of each joint, so that a thousand points are judged between two cycles."""
    positions = [each.positions for each in message.points]
    velocities = [each.velocities for each in message.points]
    for index, name in enumerate(message.joint_names):
        known = limits.get(name, JointLimits())
        found = [] if known.continuous else column(positions, index)
        if found and not known.lower - _ROUNDING <= min(found) <= max(found) <= known.upper + _ROUNDING:
            worst = min(found) if min(found) < known.lower - _ROUNDING else max(found)
            where = f"point {positions.index(_with(positions, index, worst))}: {name} at {worst:g}"
            return f"{where} is beyond its limits of {known.lower:g} to {known.upper:g}; plan within them"
        speeds = column(velocities, index)
        if speeds and max(max(speeds), -min(speeds)) > known.velocity + _ROUNDING:
            worst = max(speeds, key=abs)
            where = f"point {velocities.index(_with(velocities, index, worst))}: {name} with a velocity of {worst:g}"
            return f"{where} is beyond its limit of {known.velocity:g}; plan within it"
    return None


def _with(points: list[list[float]], index: int, value: float) -> list[float]:
    return next(each for each in points if each and each[index] == value)


def far_start(
    message: JointTrajectory, here: dict[str, float], limits: dict[str, JointLimits], allowed: float
) -> str | None:
    """Say which joint is too far from the first point, None if none; `here` are the positions, `allowed` in rad or m.

    A joint that has time until the first point may be as much farther off as its velocity limit lets it go until then.
    """
    if allowed <= 0.0 or not message.points:
        return None
    first = message.points[0]
    time = max(first.time, 0) / 1e9
    for index, name in enumerate(message.joint_names):
        if index >= len(first.positions) or name not in here:
            continue
        known, begin = limits.get(name, JointLimits()), first.positions[index]
        way = shortest_angular_distance(here[name], begin) if known.continuous else begin - here[name]
        if abs(way) > allowed + (known.velocity * time if time > 0.0 else 0.0):
            return (
                f"it begins with {name} at {begin:g} in {time:g} s, and it is at {here[name]:g}; "
                f"plan from where it is, or set allowed_start_tolerance"
            )
    return None


def _named(names: Sequence[str], index: int) -> str:
    return names[index] if index < len(names) else f"value {index}"
