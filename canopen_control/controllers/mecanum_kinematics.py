"""Kinematics of a base on four mecanum wheels, and its odometry.

The law of the file (ros2_controllers jazzy): wheels go round the base from the front left one against the clock where
they are read (front left, rear left, rear right, front right) and with it where they are commanded (front left, front
right, rear right, rear left). The frame of the base may stand off the middle of the wheels. Units: m, rad, s.
"""

from __future__ import annotations

import math

from canopen_control.controllers.planar_pose import MIN_DT, HolonomicPose

__all__ = ["MecanumKinematics"]


class MecanumKinematics(HolonomicPose):
    """The pose, and `forward`, `left` (m/s) and `angular` (rad/s), of the base's frame; `wheels` are its commands.

    `reach` is the sum of the wheels' distances from the middle along x and y, `offset` where the frame is: x, y, angle.
    """

    def __init__(self, radius: float, reach: float, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        super().__init__(4)
        self._radius, self._reach, self._offset = radius, reach, offset
        self._cosine, self._sine = math.cos(offset[2]), math.sin(offset[2])

    def update(self, front_left: float, rear_left: float, rear_right: float, front_right: float, dt: float) -> bool:
        """Follow the wheels' speeds in rad/s for `dt` s; return whether the step was long enough to count."""
        if dt < MIN_DT:
            return False
        quarter = self._radius / 4.0
        forward = quarter * (front_left + rear_left + rear_right + front_right)
        left = quarter * (-front_left + rear_left - rear_right + front_right)
        angular = quarter / self._reach * (-front_left - rear_left + rear_right + front_right)
        x, y, _ = self._offset
        cosine, sine = self._cosine, self._sine
        self.forward = cosine * forward + sine * left + (sine * x - cosine * y) * angular
        self.left = cosine * left - sine * forward + (cosine * x + sine * y) * angular
        self.angular = angular
        self.heading += angular * dt
        along, across = math.cos(self.heading) * dt, math.sin(self.heading) * dt
        self.x += along * self.forward - across * self.left
        self.y += across * self.forward + along * self.left
        return True

    def command(self, forward: float, left: float, angular: float) -> None:
        """Make `wheels` (front left, front right, rear right, rear left; rad/s) of a twist of the base's frame."""
        x, y, _ = self._offset
        ahead = self._cosine * forward - self._sine * left + y * angular
        aside = self._sine * forward + self._cosine * left - x * angular
        turn, radius, wheels = self._reach * angular, self._radius, self.wheels
        wheels[0] = (ahead - aside - turn) / radius
        wheels[1] = (ahead + aside + turn) / radius
        wheels[2] = (ahead - aside + turn) / radius
        wheels[3] = (ahead + aside - turn) / radius
