"""Kinematics of a base on three or more omni wheels around its middle, and its odometry.

The law of the file (ros2_controllers jazzy): wheel i of n stands at the angle 2 pi i / n + `offset` and rolls along the
circle. What the wheels say of three velocities is fitted by least squares, which for wheels at even angles are sums.
Units: m, rad, s.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.planar_pose import HolonomicPose

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["LEAST_WHEELS", "OmniKinematics"]

LEAST_WHEELS: Final = 3
_LEAST_DT: Final = 1e-6  # s between two positions


class OmniKinematics(HolonomicPose):
    """The pose, and `forward`, `left` (m/s) and `angular` (rad/s); `wheels` are its commands in rad/s."""

    def __init__(self, count: int, robot_radius: float, wheel_radius: float, offset: float = 0.0) -> None:
        super().__init__(count)
        if count < LEAST_WHEELS:
            raise ValueError(f"{count} wheels do not tell three velocities; there are {LEAST_WHEELS} or more")
        angles = [math.tau * index / count + offset for index in range(count)]
        self._sines, self._cosines = [math.sin(each) for each in angles], [math.cos(each) for each in angles]
        self._robot_radius, self._wheel_radius = robot_radius, wheel_radius
        self._positions = [0.0] * count
        self._speeds = [0.0] * count

    def begin(self, positions: Sequence[float]) -> None:
        """Take the wheels' positions, in rad, as where they start from."""
        for index in range(len(self.wheels)):
            self._positions[index] = positions[index]

    def update_position(self, positions: Sequence[float], dt: float) -> bool:
        """Follow the wheels' positions in rad; `dt` in s. Return False for a step too short to be one."""
        if abs(dt) < _LEAST_DT:
            return False
        for index in range(len(self.wheels)):
            self._speeds[index] = (positions[index] - self._positions[index]) / dt
            self._positions[index] = positions[index]
        return self.update_velocity(self._speeds, dt)

    def update_velocity(self, speeds: Sequence[float], dt: float) -> bool:
        """Follow the wheels' speeds in rad/s; it counts however short or backward the step is."""
        forward = left = turn = 0.0
        for index in range(len(self.wheels)):
            speed = speeds[index] * self._wheel_radius
            forward += self._sines[index] * speed
            left -= self._cosines[index] * speed
            turn -= speed
        count = len(self.wheels)
        return self.update_open_loop(2.0 / count * forward, 2.0 / count * left, turn / (count * self._robot_radius), dt)

    def update_open_loop(self, forward: float, left: float, angular: float, dt: float) -> bool:
        """Believe a command, in m/s and rad/s."""
        self.forward, self.left, self.angular = forward, left, angular
        self.shift(forward * dt, left * dt, angular * dt)
        return True

    def command(self, forward: float, left: float, angular: float) -> None:
        """Make `wheels` of a twist."""
        turn = self._robot_radius * angular
        for index in range(len(self.wheels)):
            along = self._sines[index] * forward - self._cosines[index] * left
            self.wheels[index] = (along - turn) / self._wheel_radius
