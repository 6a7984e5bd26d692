"""Points of a joint trajectory: values, order of joints, and turns.

Rules (ros2_controllers jazzy): joints that a trajectory does not name stay, and its values are put into
the order of the controller.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import TYPE_CHECKING, Final

from mypy_extensions import mypyc_attr

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence


_HALF_TURN: Final = 1e-9
"""So near to half a turn both ways are the shortest, and the sign of the difference decides; rad."""


class Point:
    """Point of trajectory_msgs/JointTrajectoryPoint: one value per joint, or none; `time` from the start in ns.

    Positions in rad (m), velocities in rad/s, accelerations in rad/s2, effort in Nm (N).
    """

    __slots__ = ("accelerations", "effort", "positions", "time", "velocities")

    def __init__(
        self,
        positions: Iterable[float] = (),
        velocities: Iterable[float] = (),
        accelerations: Iterable[float] = (),
        effort: Iterable[float] = (),
        time: int = 0,
    ) -> None:
        self.positions, self.velocities = list(positions), list(velocities)
        self.accelerations, self.effort, self.time = list(accelerations), list(effort), time

    def take(self, other: Point) -> None:
        """Copy another point into the existing lists."""
        self.positions[:] = other.positions
        self.velocities[:] = other.velocities
        self.accelerations[:] = other.accelerations
        self.effort[:] = other.effort
        self.time = other.time

    def copy(self) -> Point:
        """Return an independent copy."""
        return Point(self.positions, self.velocities, self.accelerations, self.effort, self.time)


@mypyc_attr(allow_interpreted_subclasses=True)  # those of a message are packed, in a file that is not compiled
class Points:
    """Points created on access; `times` are from the start in ns."""

    times: Sequence[int]

    def __len__(self) -> int:
        return len(self.times)

    @abstractmethod
    def __getitem__(self, index: int) -> Point:
        """Return a new point."""

    def __iter__(self) -> Iterator[Point]:
        return (self[index] for index in range(len(self)))


class JointTrajectory:
    """Trajectory to follow (trajectory_msgs/JointTrajectory): joint names, points, and the stamp of its start.

    `stamp` in ns of the clock of the cycle; 0 begins when it is taken up.
    """

    __slots__ = ("joint_names", "points", "stamp")

    def __init__(self, joint_names: Iterable[str], points: Iterable[Point] | Points, stamp: int = 0) -> None:
        self.joint_names, self.stamp = list(joint_names), stamp
        self.points: list[Point] | Points = points if isinstance(points, Points) else list(points)


class Arrangement:
    """Order of a trajectory's joints; `apply` rearranges the values of a point.

    Those it does not name stay at what is commanded to them, else where they are; nan is unknown. `names` are the
    joints in the order that the message then has.
    """

    def __init__(
        self, names: Sequence[str], joints: Sequence[str], commands: Sequence[float], positions: Sequence[float]
    ) -> None:
        self.names = list(names)
        self._stays: list[float] = []
        if len(names) != len(joints):
            for index, name in enumerate(joints):
                if name not in names:
                    self.names.append(name)
                    self._stays.append(positions[index] if math.isnan(commands[index]) else commands[index])
        self._known = [position for position in self._stays if not math.isnan(position)]
        self._zeros = [0.0] * len(self._stays)
        self._order = [self.names.index(name) for name in joints if name in self.names]
        self.changes = bool(self._stays) or self._order != list(range(len(self.names)))

    def apply(self, point: Point) -> None:
        """Complete and rearrange a point; vectors of another length are unchanged."""
        if point.positions:
            point.positions += self._known
        for values in (point.velocities, point.accelerations, point.effort):
            if values:
                values += self._zeros
        for values in (point.positions, point.velocities, point.accelerations, point.effort):
            if len(values) == len(self.names):
                values[:] = [values[index] for index in self._order]


def shortest_angular_distance(begin: float, end: float) -> float:
    """Return the angle from one direction to another, in (-pi, pi] rad; nan if either is not finite."""
    turned = end - begin + math.pi
    if not math.isfinite(turned):
        return math.nan
    rest = math.fmod(turned, 2.0 * math.pi)
    return rest + math.pi if rest <= 0.0 else rest - math.pi


def whole_turns(begin: float, end: float) -> float:
    """Return the whole turns, in rad, by which `end` must be shifted to lie within half a turn of `begin`; 0 for nan.

    At exactly half a turn the sign of the difference decides, as upstream.
    """
    distance = shortest_angular_distance(begin, end)
    if distance != distance:
        return 0.0
    if abs(abs(distance) - math.pi) < _HALF_TURN:
        distance = math.copysign(distance, end - begin or -1.0)
    return math.tau * round((begin + distance - end) / math.tau)
