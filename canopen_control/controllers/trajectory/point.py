"""Points of a joint trajectory, the order of their joints, and whole turns of continuous joints.

Rules (ros2_controllers jazzy): joints that a trajectory does not name stay, and the values of a trajectory are
rearranged to the controller's order of joints.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import TYPE_CHECKING, Final

from mypy_extensions import mypyc_attr

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence


_HALF_TURN: Final = 1e-9
"""Deviation from half a turn, in rad, up to which both directions are considered equally short.

The sign of the difference then decides.
"""


class Point:
    """Point of a trajectory (trajectory_msgs/JointTrajectoryPoint); quantities have one value per joint, or are empty.

    Positions are in rad (m), velocities in rad/s, accelerations in rad/s2, efforts in Nm (N); `time` is from the start
    in ns.
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

    def assign(self, other: Point) -> None:
        """Copy the values of another point into the existing lists."""
        self.positions[:] = other.positions
        self.velocities[:] = other.velocities
        self.accelerations[:] = other.accelerations
        self.effort[:] = other.effort
        self.time = other.time

    def copy(self) -> Point:
        """Return a deep copy."""
        return Point(self.positions, self.velocities, self.accelerations, self.effort, self.time)


@mypyc_attr(allow_interpreted_subclasses=True)  # the packed points of messages are in a file that is not compiled
class Points:
    """Sequence of points that are created on access; `times` are from the start in ns."""

    times: Sequence[int]

    def __len__(self) -> int:
        return len(self.times)

    @abstractmethod
    def __getitem__(self, index: int) -> Point:
        """Return point `index` as a new object."""

    def __iter__(self) -> Iterator[Point]:
        return (self[index] for index in range(len(self)))


class JointTrajectory:
    """Trajectory with joint names, points and start (trajectory_msgs/JointTrajectory).

    The start `stamp` is in ns of the cycle's clock; 0 starts the trajectory in the next cycle.
    """

    __slots__ = ("joint_names", "points", "stamp")

    def __init__(self, joint_names: Iterable[str], points: Iterable[Point] | Points, stamp: int = 0) -> None:
        self.joint_names, self.stamp = list(joint_names), stamp
        self.points: list[Point] | Points = points if isinstance(points, Points) else list(points)


class Arrangement:
    """Mapping from the joint order of a trajectory to the order of the controller; `apply` rearranges a point.

    Joints that the trajectory does not name are added: they stay at the commanded position, else at the actual
    position; a nan is unknown. `names` are the joints of the message, followed by the added ones.
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
        """Add the values of unnamed joints to a point, and rearrange the values."""
        if point.positions:
            point.positions += self._known
        for values in (point.velocities, point.accelerations, point.effort):
            if values:
                values += self._zeros
        for values in (point.positions, point.velocities, point.accelerations, point.effort):
            if len(values) == len(self.names):
                values[:] = [values[index] for index in self._order]


def shortest_angular_distance(begin: float, end: float) -> float:
    """Return the shortest angle from one direction to another, in (-pi, pi] rad; nan if either is not finite."""
    turned = end - begin + math.pi
    if not math.isfinite(turned):
        return math.nan
    rest = math.fmod(turned, 2.0 * math.pi)
    return rest + math.pi if rest <= 0.0 else rest - math.pi


def whole_turns(begin: float, end: float) -> float:
    """Return the whole turns in rad that shift `end` to within half a turn of `begin`; 0.0 for nan.

    At exactly half a turn the sign of the difference decides, as in ros2_controllers.
    """
    distance = shortest_angular_distance(begin, end)
    if distance != distance:
        return 0.0
    if abs(abs(distance) - math.pi) < _HALF_TURN:
        distance = math.copysign(distance, end - begin or -1.0)
    return math.tau * round((begin + distance - end) / math.tau)
