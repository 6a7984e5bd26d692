"""How far a joint may be from its trajectory, on the way and at the end, and what a goal says of it.

The law of the file (ros2_controllers jazzy): of a goal's number above 0 is a tolerance, 0 is the parameters', -1 is
none at all. A number or a joint that cannot be makes the whole set that of the parameters; the goal is taken all the
same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.trajectory.point import Point

__all__ = ["GoalTolerances", "JointTolerance", "SegmentTolerances", "StateTolerance", "resolve", "within"]

_FLOAT_EPSILON: Final = 2.0**-23


@dataclass(frozen=True)
class StateTolerance:
    """The largest errors of a joint: rad, rad/s, rad/s2 (m); 0 and less are none."""

    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


@dataclass(frozen=True)
class JointTolerance(StateTolerance):
    """What a goal says of one joint (control_msgs/JointTolerance)."""

    name: str = ""


@dataclass(frozen=True)
class GoalTolerances:
    """What a goal says of its tolerances; `goal_time` in s."""

    path: tuple[JointTolerance, ...] = ()
    goal: tuple[JointTolerance, ...] = ()
    goal_time: float = 0.0


@dataclass(frozen=True)
class SegmentTolerances:
    """The tolerances of all joints on the way and at the end; at `goal_time` s after it the end is late, 0 never."""

    path: tuple[StateTolerance, ...]
    goal: tuple[StateTolerance, ...]
    goal_time: float = 0.0


def within(tolerance: StateTolerance, error: Point, joint: int) -> bool:
    """Whether the errors of a joint are within; an error of nan is, and so is one that nobody knows."""
    if tolerance.position > 0.0 and abs(error.positions[joint]) > tolerance.position:
        return False
    speeds = error.velocities
    if tolerance.velocity > 0.0 and joint < len(speeds) and abs(speeds[joint]) > tolerance.velocity:
        return False
    changes = error.accelerations
    return not (tolerance.acceleration > 0.0 and joint < len(changes) and abs(changes[joint]) > tolerance.acceleration)


def resolve(
    goal: GoalTolerances, joints: Sequence[str], default: SegmentTolerances
) -> tuple[SegmentTolerances, str | None]:
    """Return the tolerances of a goal, and why they are the parameters' where it is wrong."""
    try:
        time = _resolved(goal.goal_time, default.goal_time, "goal_time_tolerance")
        path = _of_joints(goal.path, joints, default.path, "path_tolerance")
        end = _of_joints(goal.goal, joints, default.goal, "goal_tolerance")
    except ValueError as error:
        return default, f"{error}; the tolerances of the parameters hold"
    return SegmentTolerances(path, end, time), None


def _of_joints(
    given: Sequence[JointTolerance], joints: Sequence[str], default: Sequence[StateTolerance], what: str
) -> tuple[StateTolerance, ...]:
    found = list(default)
    for each in given:
        if each.name not in joints:
            raise ValueError(f"{what} is for {each.name!r}, which is not among {', '.join(joints)}")
        index, who = joints.index(each.name), f"{what} of {each.name}"
        known = default[index]
        found[index] = StateTolerance(
            _resolved(each.position, known.position, f"{who}: position"),
            _resolved(each.velocity, known.velocity, f"{who}: velocity"),
            _resolved(each.acceleration, known.acceleration, f"{who}: acceleration"),
        )
    return tuple(found)


def _resolved(given: float, default: float, what: str) -> float:
    if given > 0.0:
        return given
    if abs(given + 1.0) < _FLOAT_EPSILON:
        return 0.0
    if given < 0.0:
        raise ValueError(f"{what} is {given:g}; it is above 0, 0 for that of the parameters, or -1 for none")
    return default
