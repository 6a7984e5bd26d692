"""Trajectories of ROS as the robot's socket has them, and back, as plain numbers: this file imports no ROS.

The law of the file (trajectory_msgs, control_msgs): an empty list says nothing of its quantity; a stamp of zero begins
at once; a tolerance of 0 is the controller's. What is no number is found here, since JSON has none such: the sentence
is the one that the robot has for it.
"""

from __future__ import annotations

import math
from itertools import islice
from typing import TYPE_CHECKING, Any, Final

from canopen_control.ros.conversions import seconds_of
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.rpc.messages.trajectory import MAX_POINTS, TrajectoryTolerance

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.ros.endpoint import RosMessage

__all__ = [
    "fill_point",
    "goal_refusal",
    "is_one_piece",
    "pieces_of",
    "point_of",
    "seconds",
    "stamp_of",
    "tolerances_of",
]

_PIECE: Final = 1000
"""The values in one request: some 24 kB, which the robot reads in a fraction of a millisecond between two cycles."""
_QUANTITIES: Final = {
    "positions": "position",
    "velocities": "velocity",
    "accelerations": "acceleration",
    "effort": "effort",
}


def seconds(duration: RosMessage) -> float:
    """Return a Duration in seconds."""
    return float(duration.sec + duration.nanosec / 1e9)


def stamp_of(trajectory: RosMessage) -> float | None:
    """Return when a JointTrajectory begins, in Unix seconds; None at once."""
    return seconds_of(trajectory.header.stamp.sec, trajectory.header.stamp.nanosec)


def point_of(point: RosMessage) -> TrajectoryPoint:
    """Return a JointTrajectoryPoint."""
    return TrajectoryPoint(
        positions=list(point.positions),
        velocities=list(point.velocities),
        accelerations=list(point.accelerations),
        effort=list(point.effort),
        time_from_start=seconds(point.time_from_start),
    )


def fill_point(message: Any, point: TrajectoryPoint) -> Any:  # noqa: ANN401 - somebody's generator's class
    """Put a point into a JointTrajectoryPoint, and return that."""
    message.positions, message.velocities = point.positions, point.velocities
    message.accelerations, message.effort = point.accelerations, point.effort
    whole = math.floor(point.time_from_start)
    message.time_from_start.sec = whole
    message.time_from_start.nanosec = min(round((point.time_from_start - whole) * 1e9), 999_999_999)
    return message


def tolerances_of(given: Sequence[RosMessage]) -> tuple[TrajectoryTolerance, ...]:
    """Return the tolerances of joints."""
    return tuple(
        TrajectoryTolerance(
            joint=each.name,
            position=_told(each.position),
            velocity=_told(each.velocity),
            acceleration=_told(each.acceleration),
        )
        for each in given
    )


def _told(tolerance: float) -> float:
    return tolerance if math.isfinite(tolerance) else 0.0  # that of the parameters, as upstream takes nan


def pieces_of(trajectory: RosMessage) -> Iterator[list[TrajectoryPoint]]:
    """Yield the points of a JointTrajectory in as many lists as there must be requests, one at least.

    ValueError with a sentence for too many points, and for one that has something in it that is no finite number.
    """
    points = trajectory.points
    if len(points) > MAX_POINTS:
        raise ValueError(f"it has {len(points)} points, and a trajectory has {MAX_POINTS} at most; send fewer")
    rest, at, count = iter(points), 0, _points_in_a_piece(trajectory)
    while chunk := list(islice(rest, count)):
        made = [point_of(each) for each in chunk]
        for index, point in enumerate(made):
            _demand_numbers(point, at + index, trajectory.joint_names)
        at += len(chunk)
        yield made
    if not at:
        yield []


def is_one_piece(trajectory: RosMessage) -> bool:
    """Whether a JointTrajectory goes into one request."""
    return len(trajectory.points) <= _points_in_a_piece(trajectory)


def _points_in_a_piece(trajectory: RosMessage) -> int:
    widest = max((sum(len(getattr(each, name)) for name in _QUANTITIES) + 1 for each in trajectory.points), default=1)
    return max(1, _PIECE // widest)


def _demand_numbers(point: TrajectoryPoint, at: int, joints: Sequence[str]) -> None:
    for name, word in _QUANTITIES.items():
        values = getattr(point, name)
        if not all(map(math.isfinite, values)):
            index = [math.isfinite(each) for each in values].index(False)
            joint = joints[index] if index < len(joints) else f"value {index}"
            raise ValueError(f"point {at}: the {word} of {joint} is {values[index]}; give finite numbers")


def goal_refusal(goal: RosMessage) -> str | None:
    """Say what in a goal of FollowJointTrajectory nobody here could follow, None if nothing is."""
    nobody: dict[str, Callable[[], int]] = {
        "multi_dof_trajectory": lambda: len(goal.multi_dof_trajectory.points),
        "component_path_tolerance": lambda: len(goal.component_path_tolerance),
        "component_goal_tolerance": lambda: len(goal.component_goal_tolerance),
    }
    found = next((name for name, count in nobody.items() if count()), None)
    return None if found is None else f"it has a {found}, which is for joints of several degrees; leave that empty"
