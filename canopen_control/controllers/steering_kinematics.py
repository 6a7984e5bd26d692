"""Kinematics of bases with steered wheels: bicycle, tricycle and Ackermann steering, and their odometry.

Rules (ros2_controllers jazzy): of two wheels the right one is first. Commands are in the wheels' rad/s
and rad; in closed loop the wheels of a curve have the speeds of the measured curve, not of the desired one.
Two traction wheels never turn the base on the spot: at speed zero they stand still. Units: m, rad, s.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar, Final

from mypy_extensions import mypyc_attr

from canopen_control.controllers.planar_pose import MIN_DT, PlanarPose, RollingMean, quotient

if TYPE_CHECKING:
    from collections.abc import Sequence


_STRAIGHT: Final = 1e-6  # rad: below it a steering angle is none
_ON_TARGET: Final = math.pi / 6  # rad: as near as this to its angle a wheel may have its whole speed
_MOST_OFF: Final = 1.5608  # rad: what is further off is as slow as this


@mypyc_attr(allow_interpreted_subclasses=True)
class SteeringKinematics(PlanarPose):
    """Kinematics of a bicycle, with one traction and one steered wheel; derived classes override the differences.

    `linear` (m/s) and `angular` (rad/s) are means over the last `window` steps, `angle` is the measured steering angle.
    `traction` and `steering` are the wheels' commands after `command`. `fits` selects how the speed of a base with two
    wheels is computed: as the mean of both, as upstream, which has a pole where one of them is the centre of the curve,
    or as the fit to both, which is the same where the wheels agree.
    """

    traction_count: ClassVar[int] = 1
    steering_count: ClassVar[int] = 1

    def __init__(
        self,
        radius: float,
        wheelbase: float,
        traction_track: float = 0.0,
        steering_track: float = 0.0,
        window: int = 10,
    ) -> None:
        super().__init__()
        self.fits = False
        self.radius, self.wheelbase = radius, wheelbase
        self.traction_track, self.steering_track = traction_track, steering_track
        self.linear = self.angular = self.angle = 0.0
        self.traction = [0.0] * self.traction_count
        self.steering = [0.0] * self.steering_count
        self._speeds = [0.0] * self.traction_count
        self._positions = [0.0] * self.traction_count
        self._linears, self._angulars = RollingMean(window), RollingMean(window)

    def set_window(self, window: int) -> None:
        """Set the window of the means."""
        self._linears, self._angulars = RollingMean(window), RollingMean(window)

    def reset(self) -> None:
        """Reset pose and means."""
        self.set_pose(0.0, 0.0, 0.0)

    def set_pose(self, x: float, y: float, heading: float) -> None:
        """Set the pose and reset the means."""
        super().set_pose(x, y, heading)
        self._linears.clear()
        self._angulars.clear()

    # ------------------------------------------------------------------------------------------------- what differs

    def measured_angle(self, steering: Sequence[float]) -> float:
        """Return the angle of a virtual middle wheel from the angles of the steered wheels."""
        return steering[0]

    def measured_speed(self, traction: Sequence[float], angle: float) -> float:
        """Return the speed of the base in m/s from the wheels' speeds in rad/s."""
        del angle
        return self.radius * traction[0]

    def set_traction(self, speed: float, angle: float) -> None:
        """Distribute a speed in rad/s over the traction wheels in a curve."""
        del angle
        self.traction[0] = speed

    def set_steering(self, angle: float, curve: float) -> None:
        """Distribute an angle over the steered wheels; `curve` is the angle of the present curve."""
        del curve
        self.steering[0] = angle

    # ----------------------------------------------------------------------------------------------------- odometry

    def begin(self, positions: Sequence[float]) -> None:
        """Set the start positions of the wheels, in rad."""
        for index in range(self.traction_count):
            self._positions[index] = positions[index]

    def update_position(self, traction: Sequence[float], steering: Sequence[float], dt: float) -> bool:
        """Update from the positions of traction and steering, in rad; `dt` in s.

        Return whether velocities are valid.
        """
        for index in range(self.traction_count):
            self._speeds[index] = quotient(traction[index] - self._positions[index], dt)
            self._positions[index] = traction[index]
        return self.update_velocity(self._speeds, steering, dt)

    def update_velocity(self, traction: Sequence[float], steering: Sequence[float], dt: float) -> bool:
        """Update from the speeds of traction, in rad/s, and the positions of steering."""
        self.angle = self.measured_angle(steering)
        linear = self.measured_speed(traction, self.angle)
        angular = math.tan(self.angle) * linear / self.wheelbase
        self.drive(linear * dt, angular * dt)
        if dt < MIN_DT:
            return False
        self._linears.add(linear)
        self._angulars.add(angular)
        self.linear, self.angular = self._linears.mean, self._angulars.mean
        return True

    def update_open_loop(self, linear: float, angular: float, dt: float) -> None:
        """Integrate a command, in m/s and rad/s."""
        self.linear, self.angular = linear, angular
        self.drive(linear * dt, angular * dt)

    # ----------------------------------------------------------------------------------------------------- commands

    def command(self, linear: float, angular: float, open_loop: bool, reduce: bool = False) -> None:
        """Compute `traction` and `steering` commands from a twist in m/s and rad/s.

        `reduce` slows the wheels down, in closed loop, until the steering has reached its command.
        """
        angle = math.atan(quotient(angular * self.wheelbase, linear))
        if not math.isfinite(angle):  # neither speed nor turn
            angle = 0.0
        speed = linear / self.radius
        if not open_loop and reduce:
            off = abs(self.angle - angle)
            if off >= _ON_TARGET:
                speed *= math.cos(min(off, _MOST_OFF)) / math.cos(_ON_TARGET)
        curve = angle if open_loop else self.angle
        self.set_traction(speed, curve)
        self.set_steering(angle, curve)

    def bound(self, linear: float, angular: float) -> None:
        """Limit every traction wheel by the fastest one of the requested curve, in m/s and rad/s; after `command`.

        With the steering across, wheels of the curve that is measured would turn without bounds.
        """
        most = (abs(linear) + self.traction_track / 2.0 * abs(angular)) / self.radius
        fastest = 0.0
        for index in range(self.traction_count):
            fastest = max(fastest, abs(self.traction[index]))
        if fastest <= most:
            return
        for index in range(self.traction_count):
            self.traction[index] = self.traction[index] / fastest * most if math.isfinite(fastest) else 0.0

    def share(self, speed: float, angle: float) -> None:
        """Compute the speeds of the inner and the outer traction wheel."""
        if abs(angle) < _STRAIGHT:
            self.traction[0] = self.traction[1] = speed
            return
        curve, half = quotient(self.wheelbase, math.tan(angle)), self.traction_track / 2.0
        self.traction[0] = speed * quotient(curve + half, curve)
        self.traction[1] = speed * quotient(curve - half, curve)

    def mean_speed(self, traction: Sequence[float], angle: float) -> float:
        """Return the speed between two traction wheels in a curve, in m/s."""
        right, left = traction[0], traction[1]
        if self.fits:
            lean = self.traction_track / 2.0 * math.tan(angle) / self.wheelbase
            return self.radius * (right * (1.0 + lean) + left * (1.0 - lean)) / (2.0 + 2.0 * lean * lean)
        curve, half = quotient(self.wheelbase, math.tan(angle)), self.traction_track / 2.0
        if math.isinf(curve):
            return self.radius * (right + left) * 0.5
        middle = right * quotient(curve, curve + half) + left * quotient(curve, curve - half)
        return self.radius * middle * 0.5


class BicycleKinematics(SteeringKinematics):
    """Kinematics of one traction wheel and one steered wheel on the centre line."""


class TricycleKinematics(SteeringKinematics):
    """Two traction wheels on an axle and one steered wheel."""

    traction_count: ClassVar[int] = 2

    def measured_speed(self, traction: Sequence[float], angle: float) -> float:
        """Return the mean speed of both wheels at the centre."""
        return self.mean_speed(traction, angle)

    def set_traction(self, speed: float, angle: float) -> None:
        """Distribute the speed over both wheels."""
        self.share(speed, angle)


class AckermannKinematics(TricycleKinematics):
    """Kinematics of two traction wheels on an axle and two steered wheels (Ackermann)."""

    steering_count: ClassVar[int] = 2

    def measured_angle(self, steering: Sequence[float]) -> float:
        """Return the mean steering angle by both wheels."""
        length, half = self.wheelbase, self.steering_track / 2.0
        right, left = math.tan(steering[0]), math.tan(steering[1])
        by_right = math.atan(quotient(length * right, length - half * right))
        return (by_right + math.atan(quotient(length * left, length + half * left))) * 0.5

    def set_steering(self, angle: float, curve: float) -> None:
        """Turn the inner wheel further than the outer one."""
        if abs(curve) < _STRAIGHT:
            self.steering[0] = self.steering[1] = angle
            return
        across, along = 2.0 * self.wheelbase * math.sin(angle), 2.0 * self.wheelbase * math.cos(angle)
        apart = self.steering_track * math.sin(angle)
        self.steering[0] = math.atan2(across, along + apart)
        self.steering[1] = math.atan2(across, along - apart)
