"""Where a differential drive robot is, from what its wheels did.

The law of the file (ros2_controllers jazzy): a step is the exact arc of the two wheels' ways, for less than 1e-6 rad
the second order Runge-Kutta formula; the heading is never wrapped; `linear` and `angular` are means over the last
steps. Ours: the first sample after `stop` is the baseline, so that neither the wheels' angle at start nor the time
before it moves the robot (upstream jumps by both).
"""

from __future__ import annotations

import math
from typing import Final

__all__ = ["Odometry"]

MIN_DT: Final = 1e-4
"""Steps shorter than this, in s, are put off to the next one: a velocity over them would be noise."""
STRAIGHT: Final = 1e-6
"""Below this turn, in rad, the arc's radius is numerically infinite."""
NS: Final = 1_000_000_000


class _Window:
    """The last values, fewer until it is full; every step adds one, and their mean is made for who asks."""

    __slots__ = ("_at", "_count", "_size", "_values")

    def __init__(self, size: int) -> None:
        self._values, self._size = [0.0] * size, size
        self._at = self._count = 0

    def clear(self) -> None:
        """Forget everything."""
        self._at = self._count = 0

    def add(self, value: float) -> None:
        """Add a value, instead of the oldest where it is full."""
        at = self._at
        self._values[at] = value
        at += 1
        if at > self._count:
            self._count = at
        self._at = 0 if at == self._size else at

    @property
    def mean(self) -> float:
        """The mean of the values, 0 without any."""
        return sum(self._values[: self._count]) / self._count if self._count else 0.0


class Odometry:
    """The pose `x`, `y` (m), `heading` (rad), and `linear` (m/s), `angular` (rad/s).

    `separation` and the radii, in m, are those after their multipliers; `window` is how many steps are averaged.
    """

    def __init__(self, separation: float, left_radius: float, right_radius: float, window: int = 10) -> None:
        self._separation, self._left_radius, self._right_radius = separation, left_radius, right_radius
        self._linear, self._angular = _Window(window), _Window(window)
        self.x = self.y = self.heading = 0.0
        self.started = False
        self._time = 0
        self._left = self._right = 0.0

    @property
    def linear(self) -> float:
        """The velocity along the robot, in m/s."""
        return self._linear.mean

    @property
    def angular(self) -> float:
        """The velocity of its heading, in rad/s."""
        return self._angular.mean

    def begin(self, left: float, right: float, now: int) -> None:
        """Take the wheels' angles (rad) at `now` (ns) as the baseline; the pose stays."""
        self._left, self._right, self._time = left * self._left_radius, right * self._right_radius, now
        self.started = True

    def stop(self) -> None:
        """Count nothing that happens until the next sample, which becomes the baseline."""
        self.started = False

    def set_pose(self, x: float, y: float, heading: float) -> None:
        """Be somewhere else, in m and rad; the averages start anew."""
        self.x, self.y, self.heading = x, y, heading
        self._linear.clear()
        self._angular.clear()

    def update_position(self, left: float, right: float, now: int) -> bool:
        """Follow the wheels' angles in rad; return whether the step counted."""
        if not self.started:
            self.begin(left, right, now)
            return False
        dt = (now - self._time) / NS
        if dt < MIN_DT:
            return False
        way_left, way_right = left * self._left_radius, right * self._right_radius
        step_left, step_right = way_left - self._left, way_right - self._right
        self._left, self._right = way_left, way_right
        return self._step(step_left, step_right, dt, now)

    def update_velocity(self, left: float, right: float, now: int) -> bool:
        """Follow the wheels' velocities in rad/s; return whether the step counted."""
        if not self.started:
            self.begin(0.0, 0.0, now)
            return False
        dt = (now - self._time) / NS
        if dt < MIN_DT:
            return False
        return self._step(left * self._left_radius * dt, right * self._right_radius * dt, dt, now)

    def update_open_loop(self, linear: float, angular: float, now: int) -> bool:
        """Believe the command, in m/s and rad/s; return whether the step counted."""
        if not self.started:
            self.begin(0.0, 0.0, now)
            return False
        dt = (now - self._time) / NS
        self._time = now
        for window, value in ((self._linear, linear), (self._angular, angular)):
            window.clear()
            window.add(value)
        self._integrate(linear * dt, angular * dt)
        return True

    def _step(self, left: float, right: float, dt: float, now: int) -> bool:
        linear, angular = (left + right) * 0.5, (right - left) / self._separation
        self._integrate(linear, angular)
        self._time = now
        self._linear.add(linear / dt)
        self._angular.add(angular / dt)
        return True

    def _integrate(self, linear: float, angular: float) -> None:
        if abs(angular) < STRAIGHT:
            direction = self.heading + angular * 0.5
            self.x += linear * math.cos(direction)
            self.y += linear * math.sin(direction)
            self.heading += angular
            return
        before, radius = self.heading, linear / angular
        self.heading += angular
        self.x += radius * (math.sin(self.heading) - math.sin(before))
        self.y -= radius * (math.cos(self.heading) - math.cos(before))
