"""Planar pose integrated from velocities (dead reckoning), and rolling mean of velocities.

Rules (ros2_controllers jazzy): the path of a step is an exact arc, or a straight line if the turn is below `STRAIGHT`.
Headings are never wrapped. Units are m, rad and s.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from mypy_extensions import mypyc_attr

if TYPE_CHECKING:
    from collections.abc import Sequence

MIN_DT: Final = 1e-4
"""Minimum time step in s for computing a velocity, which would be noise in shorter steps."""
STRAIGHT: Final = 1e-6
"""Minimum turn in rad for which a step is an arc; below, the radius is numerically infinite."""


def quotient(dividend: float, divisor: float) -> float:
    """Divide as in IEEE 754: division by zero gives an infinity with the correct sign, 0 / 0 gives nan."""
    if divisor != 0.0:
        return dividend / divisor
    if dividend == 0.0 or math.isnan(dividend):
        return math.nan
    return math.copysign(math.inf, dividend) * math.copysign(1.0, divisor)


class RollingMean:
    """Mean of the last `size` values, computed on access."""

    __slots__ = ("_at", "_count", "_size", "_values")

    def __init__(self, size: int) -> None:
        self._values, self._size = [0.0] * size, size
        self._at = self._count = 0

    def clear(self) -> None:
        self._at = self._count = 0

    def add(self, value: float) -> None:
        """Add a value; the oldest value is dropped once there are `size` values."""
        at = self._at
        self._values[at] = value
        at += 1
        if at > self._count:
            self._count = at
        self._at = 0 if at == self._size else at

    @property
    def mean(self) -> float:
        """Mean of the values; 0.0 if empty."""
        return sum(self._values[: self._count]) / self._count if self._count else 0.0


@mypyc_attr(allow_interpreted_subclasses=True)
class PlanarPose:
    """Pose in the plane: `x`, `y` in m and `heading` in rad."""

    def __init__(self) -> None:
        self.x = self.y = self.heading = 0.0

    def set_pose(self, x: float, y: float, heading: float) -> None:
        self.x, self.y, self.heading = x, y, heading

    def drive(self, distance: float, turn: float) -> None:
        """Move forward by `distance` on an arc with angle `turn`; a nearly straight step follows the mean heading."""
        if abs(turn) < STRAIGHT:
            direction = self.heading + turn * 0.5
            self.x += distance * math.cos(direction)
            self.y += distance * math.sin(direction)
            self.heading += turn
            return
        before, radius = self.heading, distance / turn
        self.heading += turn
        self.x += radius * (math.sin(self.heading) - math.sin(before))
        self.y -= radius * (math.cos(self.heading) - math.cos(before))

    def shift(self, forward: float, left: float, turn: float) -> None:
        """Move forward and to the left while turning; a nearly straight step follows the initial heading."""
        before = self.heading
        self.heading += turn
        if abs(turn) < STRAIGHT:
            self.x += forward * math.cos(before) - left * math.sin(before)
            self.y += forward * math.sin(before) + left * math.cos(before)
            return
        sines, cosines = math.sin(self.heading) - math.sin(before), math.cos(self.heading) - math.cos(before)
        self.x += forward / turn * sines + left / turn * cosines
        self.y += left / turn * sines - forward / turn * cosines


@mypyc_attr(allow_interpreted_subclasses=True)
class HolonomicKinematics(PlanarPose):
    """Kinematics of a holonomic base: the matrix J from twists to rim speeds, and its pseudo-inverse.

    A row of J is the rim speed of one wheel at 1 m/s forward, at 1 m/s to the left, and at 1 rad/s; the `radius` of the
    wheels is in m. `wheels` are the wheel commands in rad/s; `forward` and `left` (m/s) and `angular` (rad/s) are
    the least-squares fit to the measured wheel speeds.
    """

    def __init__(self, rows: Sequence[tuple[float, float, float]], radius: float) -> None:
        super().__init__()
        from numpy import array, linalg  # needed only by bases that can move sideways

        self.forward = self.left = self.angular = 0.0
        self.wheels = [0.0] * len(rows)
        self.radius = radius
        self._rows = list(rows)
        reach = max(abs(around) for _, _, around in rows)
        matrix = array([(along, across, around / reach) for along, across, around in rows])
        # solved by the normal equations, which are exact if columns are orthogonal, as those of upstream's bases
        inverse: list[list[float]] = linalg.solve(matrix.T @ matrix, matrix.T).tolist()
        self._fit_forward, self._fit_left, around_fit = inverse
        self._fit_angular = [weight / reach for weight in around_fit]

    def command(self, forward: float, left: float, angular: float) -> None:
        """Compute the wheel speeds `wheels` for a twist in m/s and rad/s."""
        for index, (along, across, around) in enumerate(self._rows):
            self.wheels[index] = (along * forward + across * left + around * angular) / self.radius

    def fit(self, speeds: Sequence[float]) -> None:
        """Compute `forward`, `left` and `angular` as the least-squares fit to wheel speeds in rad/s."""
        forward = left = angular = 0.0
        for index in range(len(self.wheels)):
            rim = speeds[index] * self.radius
            forward += self._fit_forward[index] * rim
            left += self._fit_left[index] * rim
            angular += self._fit_angular[index] * rim
        self.forward, self.left, self.angular = forward, left, angular
