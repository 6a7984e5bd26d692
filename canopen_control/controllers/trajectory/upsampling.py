"""Velocities for trajectories of positions alone, as policies send them: a cubic spline through all points.

The law of the file (ros2_controllers rolling, positions_upsampling): the spline has continuous accelerations and rests
at both ends.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.trajectory.point import JointTrajectory, Point

__all__ = ["fill_velocities", "positions_alone", "time_points"]


def positions_alone(message: JointTrajectory) -> bool:
    """Whether the points say nothing but positions."""
    return not any(each.velocities or each.accelerations or each.effort for each in message.points)


def time_points(points: Sequence[Point], frequency: float) -> None:
    """Give points without any time those of a policy that runs at `frequency`, in Hz; 0 leaves them."""
    if frequency > 0.0 and not any(each.time for each in points):
        for index, each in enumerate(points):
            each.time = int((index + 1) / frequency * 1e9)


def fill_velocities(points: Sequence[Point]) -> bool:
    """Write the velocities of the spline into the points; False, and nothing is changed, where there is none."""
    joints = len(points[0].positions) if points else 0
    steps = [(b.time - a.time) / 1e9 for a, b in itertools.pairwise(points)]
    even = all(len(each.positions) == joints for each in points)
    if not steps or not joints or min(steps) <= 0.0 or not even:
        return False
    columns = [_knots([each.positions[joint] for each in points], steps) for joint in range(joints)]
    for index, point in enumerate(points):
        point.velocities[:] = [column[index] for column in columns]
    return True


def _knots(values: Sequence[float], steps: Sequence[float]) -> list[float]:
    """Solve the tridiagonal equations of the inner velocities (Thomas); those of the ends are 0."""
    inner = len(values) - 2
    upper, right = [0.0] * inner, [0.0] * inner
    for i in range(inner):
        h, k = steps[i], steps[i + 1]
        diagonal = 2.0 * (1.0 / h + 1.0 / k)
        wanted = 3.0 * ((values[i + 2] - values[i + 1]) / k**2 + (values[i + 1] - values[i]) / h**2)
        if i:
            diagonal -= upper[i - 1] / h
            wanted -= right[i - 1] / h
        upper[i], right[i] = 1.0 / k / diagonal, wanted / diagonal
    found = [0.0] * len(values)
    for i in reversed(range(inner)):
        found[i + 1] = right[i] - upper[i] * found[i + 2]
    return found
