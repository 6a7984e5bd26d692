"""The points of a joint trajectory: positions, velocities, accelerations and efforts of its joints at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["JointTrajectory", "Point"]


class Point:
    """A point of trajectory_msgs/JointTrajectoryPoint: one value for each joint, or none; `time` from start in ns.

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
        """Become equal to another point, in the lists that are there."""
        self.positions[:] = other.positions
        self.velocities[:] = other.velocities
        self.accelerations[:] = other.accelerations
        self.effort[:] = other.effort
        self.time = other.time

    def copy(self) -> Point:
        """Return a point of its own with the same values."""
        return Point(self.positions, self.velocities, self.accelerations, self.effort, self.time)


class JointTrajectory:
    """What is sent to be followed (trajectory_msgs/JointTrajectory): joint names, points, and the stamp of its start.

    `stamp` in ns of the clock of the cycle; 0 begins when it is taken up.
    """

    __slots__ = ("joint_names", "points", "stamp")

    def __init__(self, joint_names: Iterable[str], points: Iterable[Point], stamp: int = 0) -> None:
        self.joint_names, self.points, self.stamp = list(joint_names), list(points), stamp
