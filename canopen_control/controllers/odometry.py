"""Where a differential drive robot is, from what its wheels did.

The law of the file (ros2_controllers jazzy): a step is the exact arc of the two wheels' ways (`planar_pose`), and one
shorter than `MIN_DT` is put off to the next; `linear` and `angular` are means over the last steps. Ours: the first
sample after `stop` is the baseline, so that neither the wheels' angle at start nor the time before it moves the robot
(upstream jumps by both).
"""

from __future__ import annotations

from typing import Final

from canopen_control.controllers.planar_pose import MIN_DT, PlanarPose, RollingMean

__all__ = ["Odometry"]

NS: Final = 1_000_000_000


class Odometry(PlanarPose):
    """The pose `x`, `y` (m), `heading` (rad), and `linear` (m/s), `angular` (rad/s).

    `separation` and the radii, in m, are those after their multipliers; `window` is how many steps are averaged.
    """

    def __init__(self, separation: float, left_radius: float, right_radius: float, window: int = 10) -> None:
        super().__init__()
        self._separation, self._left_radius, self._right_radius = separation, left_radius, right_radius
        self._linear, self._angular = RollingMean(window), RollingMean(window)
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

    def resize(self, separation: float, left_radius: float, right_radius: float) -> None:
        """Count with other wheels from now on, all in m; the pose stays."""
        self._left *= left_radius / self._left_radius
        self._right *= right_radius / self._right_radius
        self._separation, self._left_radius, self._right_radius = separation, left_radius, right_radius

    def begin(self, left: float, right: float, now: int) -> None:
        """Take the wheels' angles (rad) at `now` (ns) as the baseline; the pose stays."""
        self._left, self._right, self._time = left * self._left_radius, right * self._right_radius, now
        self.started = True

    def stop(self) -> None:
        """Count nothing that happens until the next sample, which becomes the baseline."""
        self.started = False

    def set_pose(self, x: float, y: float, heading: float) -> None:
        """Be somewhere else, in m and rad; the averages start anew."""
        super().set_pose(x, y, heading)
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
        self.drive(linear * dt, angular * dt)
        return True

    def _step(self, left: float, right: float, dt: float, now: int) -> bool:
        linear, angular = (left + right) * 0.5, (right - left) / self._separation
        self.drive(linear, angular)
        self._time = now
        self._linear.add(linear / dt)
        self._angular.add(angular / dt)
        return True
