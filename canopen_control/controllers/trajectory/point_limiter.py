"""Trajectory point limiter: clamps points to the limits of their joints, and brakes all joints before an end position.

Rules (joint_limits of ros2_control, JointTrajectoryPointSaturationLimiter): positions, then velocities,
then accelerations are clamped, and what was clamped makes the others again; a joint that could not stop any more before
the end of its range brakes, and all others with it, so that they stay on their path's direction.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.trajectory.point import Point
    from canopen_control.urdf.joint_element import HardLimits


_ZERO: Final = 1e-10  # what is not larger is not given


class PointLimiter:
    """Limiter of points to the `limits` of their joints, in place; `joint` is the first limited one."""

    def __init__(self, limits: Sequence[HardLimits]) -> None:
        self.limits = list(limits)
        count = len(self.limits)
        self._positions, self._velocities, self._accelerations = [0.0] * count, [0.0] * count, [0.0] * count
        self._still = [0.0] * count
        self.joint = 0
        self._limited = self._brakes = False
        self._places = self._speeds = False  # whether the desired point has positions and velocities

    def enforce(self, actual: Point, desired: Point, period: float) -> bool:
        """Clamp the desired state and return whether it was clamped; `period` in s.

        Nothing is done without the positions where the joints are, or without positions or velocities to be.
        """
        count = len(self.limits)
        self._places, self._speeds = len(desired.positions) == count, len(desired.velocities) == count
        complete = len(actual.positions) == count and (self._places or self._speeds)
        if period <= 0.0 or not complete:
            return False
        speeds = actual.velocities if len(actual.velocities) == count else self._still
        grows = len(desired.accelerations) == count
        self._positions[:] = desired.positions if self._places else self._still
        self._velocities[:] = desired.velocities if self._speeds else self._still
        self._accelerations[:] = desired.accelerations if grows else self._still
        self._limited = self._brakes = False
        for joint in range(count):
            self._clamp(joint, actual.positions[joint], speeds[joint], period)
        if self._brakes:
            for joint in range(count):
                self._brake(joint, actual.positions[joint], speeds[joint], period)
        if self._places:
            desired.positions[:] = self._positions
        if self._speeds:
            desired.velocities[:] = self._velocities
        if grows:
            desired.accelerations[:] = self._accelerations
        return self._limited

    def _note(self, joint: int) -> None:
        if not self._limited:
            self.joint, self._limited = joint, True

    def _clamp(self, joint: int, here: float, speed: float, period: float) -> None:
        limits = self.limits[joint]
        if self._places:
            self._clamp_position(joint, here, period)
        if math.isfinite(limits.max_velocity):
            self._clamp_velocity(joint, here, speed, period)
        if math.isfinite(limits.max_acceleration) or math.isfinite(limits.max_deceleration):
            self._clamp_acceleration(joint, here, speed, period)
        if limits.has_ends:
            self._look_ahead(joint, here, period)

    def _clamp_position(self, joint: int, here: float, period: float) -> None:
        limits, desired = self.limits[joint], self._positions[joint]
        position = min(max(desired, limits.min_position), limits.max_position)
        if position != desired and limits.has_ends:
            self._positions[joint] = position
            self._note(joint)
        distance = position - here
        if abs(distance) > _ZERO and abs(self._velocities[joint]) <= _ZERO:
            self._velocities[joint] = distance / period

    def _clamp_velocity(self, joint: int, here: float, speed: float, period: float) -> None:
        most, velocity = self.limits[joint].max_velocity, self._velocities[joint]
        if abs(velocity) <= _ZERO or math.isnan(velocity):
            velocity = self._velocities[joint] = (self._positions[joint] - here) / period
        if abs(velocity) <= most or math.isnan(velocity):
            return
        velocity = self._velocities[joint] = math.copysign(most, velocity)
        self._note(joint)
        if self._places:
            self._positions[joint] = here + velocity * period
        self._accelerations[joint] = (velocity - speed) / period

    def _clamp_acceleration(self, joint: int, here: float, speed: float, period: float) -> None:
        limits, acceleration = self.limits[joint], self._accelerations[joint]
        if abs(acceleration) <= _ZERO or math.isnan(acceleration):
            acceleration = self._accelerations[joint] = (self._velocities[joint] - speed) / period
        slows_down = acceleration * speed < 0.0 and math.isfinite(limits.max_deceleration)
        most = limits.max_deceleration if slows_down else limits.max_acceleration
        if abs(acceleration) <= most or math.isnan(acceleration):
            return
        self._note(joint)
        self._accelerate(joint, math.copysign(most, acceleration), here, speed, period)

    def _accelerate(self, joint: int, acceleration: float, here: float, speed: float, period: float) -> None:
        """Integrate an acceleration into position and velocity."""
        self._accelerations[joint] = acceleration
        self._velocities[joint] = speed + acceleration * period
        if self._places:
            self._positions[joint] = here + speed * period + 0.5 * acceleration * period * period

    def _look_ahead(self, joint: int, here: float, period: float) -> None:
        """Return whether a joint has to brake for the end of its range."""
        limits = self.limits[joint]
        if self._speeds and not self._places:
            target = here + self._velocities[joint] * period
            bounded = min(max(target, limits.min_position), limits.max_position)
            if bounded != target:
                self._velocities[joint] = (bounded - here) / period
                self._note(joint)
        velocity = self._velocities[joint]
        rate = abs(velocity / period)
        if math.isfinite(limits.max_deceleration):
            rate = limits.max_deceleration
        elif math.isfinite(limits.max_acceleration):
            rate = limits.max_acceleration
        if rate == 0.0:
            return
        below, above = here - limits.min_position, limits.max_position - here
        needs, going_on = velocity * velocity / (2.0 * rate), velocity * abs(velocity) / rate
        left = below if velocity < 0.0 else above
        if velocity != 0.0 and (left < needs or left < going_on):
            self._brakes = True
            self._note(joint)

    def _brake(self, joint: int, here: float, speed: float, period: float) -> None:
        limits, acceleration = self.limits[joint], -speed / period
        most = limits.max_deceleration if math.isfinite(limits.max_deceleration) else limits.max_acceleration
        self._accelerate(joint, math.copysign(min(abs(acceleration), most), acceleration), here, speed, period)
