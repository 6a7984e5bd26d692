"""Kinematics and odometry of bases with bicycle, tricycle and Ackermann steering.

Rules (ros2_controllers jazzy): of two wheels the right wheel is first. Commands are wheel speeds in rad/s and angles in
rad; in closed loop the traction wheels have the speeds of the measured curve, not of the desired curve. Two traction
wheels never turn the base on the spot: at speed zero they are at standstill. Units are m, rad and s.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar, Final

from mypy_extensions import mypyc_attr

from canopen_control.controllers.planar_pose import MIN_DT, PlanarPose, RollingMean, quotient

if TYPE_CHECKING:
    from collections.abc import Sequence


_STRAIGHT: Final = 1e-6  # steering angle in rad below which the wheels are straight
_ON_TARGET: Final = math.pi / 6  # deviation of the steering in rad up to which the speed is not reduced
_MAX_OFF: Final = 1.5608  # deviation of the steering in rad from which the speed is not reduced further


@mypyc_attr(allow_interpreted_subclasses=True)
class SteeringKinematics(PlanarPose):
    """Kinematics and odometry of a bicycle; base class of the other steering kinematics.

    `linear` (m/s) and `angular` (rad/s) are means over the last `window` steps, `angle` is the measured steering angle.
    `traction` and `steering` are the wheel commands that `command` computes. `fits` selects how the speed of a base
    with two traction wheels is computed: False is the mean of both, as upstream, which has a pole if one wheel is at
    the centre of the curve; True is the least-squares fit to both, which has the same result if the wheels agree.
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
        """Set the number of steps for the means, and discard earlier steps."""
        self._linears, self._angulars = RollingMean(window), RollingMean(window)

    def reset(self) -> None:
        """Set the pose to the origin, and discard the steps of the means."""
        self.set_pose(0.0, 0.0, 0.0)

    def set_pose(self, x: float, y: float, heading: float) -> None:
        super().set_pose(x, y, heading)
        self._linears.clear()
        self._angulars.clear()

    # ------------------------------------------------------------------------------------------------- wheel layout

    def measured_angle(self, steering: Sequence[float]) -> float:
        """Return the steering angle at the centre line from the angles of the steered wheels."""
        return steering[0]

    def measured_speed(self, traction: Sequence[float], angle: float) -> float:
        """Return the forward speed of the base in m/s from the speeds of the traction wheels in rad/s."""
        del angle
        return self.radius * traction[0]

    def set_traction(self, speed: float, angle: float) -> None:
        """Distribute a speed in rad/s over the traction wheels, for a curve with steering angle `angle`."""
        del angle
        self.traction[0] = speed

    def set_steering(self, angle: float, curve: float) -> None:
        """Distribute a steering angle over the steered wheels; `curve` is the angle of the current curve."""
        del curve
        self.steering[0] = angle

    # ----------------------------------------------------------------------------------------------------- odometry

    def begin(self, positions: Sequence[float]) -> None:
        """Set the initial positions of the traction wheels, in rad."""
        for index in range(self.traction_count):
            self._positions[index] = positions[index]

    def update_position(self, traction: Sequence[float], steering: Sequence[float], dt: float) -> bool:
        """Integrate the positions of traction and steered wheels in rad; `dt` is in s.

        Return whether the time step was long enough for new mean velocities.
        """
        for index in range(self.traction_count):
            self._speeds[index] = quotient(traction[index] - self._positions[index], dt)
            self._positions[index] = traction[index]
        return self.update_velocity(self._speeds, steering, dt)

    def update_velocity(self, traction: Sequence[float], steering: Sequence[float], dt: float) -> bool:
        """Integrate the speeds of the traction wheels in rad/s and the positions of the steered wheels in rad.

        Return whether the time step was long enough for new mean velocities; `dt` is in s.
        """
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
        """Integrate a commanded twist, in m/s and rad/s, over `dt` s."""
        self.linear, self.angular = linear, angular
        self.drive(linear * dt, angular * dt)

    # ----------------------------------------------------------------------------------------------------- commands

    def command(self, linear: float, angular: float, open_loop: bool, reduce: bool = False) -> None:
        """Compute `traction` and `steering` commands from a twist in m/s and rad/s.

        In closed loop, `reduce` slows down the wheels while the steering is far from the commanded angle.
        """
        angle = math.atan(quotient(angular * self.wheelbase, linear))
        if not math.isfinite(angle):  # undefined without speed and turn
            angle = 0.0
        speed = linear / self.radius
        if not open_loop and reduce:
            off = abs(self.angle - angle)
            if off >= _ON_TARGET:
                speed *= math.cos(min(off, _MAX_OFF)) / math.cos(_ON_TARGET)
        curve = angle if open_loop else self.angle
        self.set_traction(speed, curve)
        self.set_steering(angle, curve)

    def bound(self, linear: float, angular: float) -> None:
        """Scale the traction commands down to the fastest wheel speed that a twist in m/s and rad/s needs.

        Call it after `command`, whose speeds for the measured curve are unlimited if the steered wheels are across.
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
        """Distribute a speed in rad/s over the right and left traction wheels, for steering angle `angle`."""
        if abs(angle) < _STRAIGHT:
            self.traction[0] = self.traction[1] = speed
            return
        curve, half = quotient(self.wheelbase, math.tan(angle)), self.traction_track / 2.0
        self.traction[0] = speed * quotient(curve + half, curve)
        self.traction[1] = speed * quotient(curve - half, curve)

    def mean_speed(self, traction: Sequence[float], angle: float) -> float:
        """Return the speed midway between two traction wheels in m/s from their speeds in rad/s."""
        right, left = traction[0], traction[1]
        if self.fits:
            lean = self.traction_track / 2.0 * math.tan(angle) / self.wheelbase
            return self.radius * (right * (1.0 + lean) + left * (1.0 - lean)) / (2.0 + 2.0 * lean * lean)
        curve, half = quotient(self.wheelbase, math.tan(angle)), self.traction_track / 2.0
        if math.isinf(curve):
            return self.radius * (right + left) * 0.5
        middle = right * quotient(curve, curve + half) + left * quotient(curve, curve - half)
        return self.radius * middle * 0.5


class TricycleKinematics(SteeringKinematics):
    """Kinematics of a base with two traction wheels on one axle and one steered wheel."""

    traction_count: ClassVar[int] = 2

    def measured_speed(self, traction: Sequence[float], angle: float) -> float:
        return self.mean_speed(traction, angle)

    def set_traction(self, speed: float, angle: float) -> None:
        self.share(speed, angle)


class AckermannKinematics(TricycleKinematics):
    """Kinematics of a base with two traction wheels on one axle and two steered wheels."""

    steering_count: ClassVar[int] = 2

    def measured_angle(self, steering: Sequence[float]) -> float:
        """Return the mean of the centre line angles derived from the two steered wheels."""
        length, half = self.wheelbase, self.steering_track / 2.0
        right, left = math.tan(steering[0]), math.tan(steering[1])
        by_right = math.atan(quotient(length * right, length - half * right))
        return (by_right + math.atan(quotient(length * left, length + half * left))) * 0.5

    def set_steering(self, angle: float, curve: float) -> None:
        """Distribute a steering angle over both wheels; the inner wheel turns further than the outer wheel."""
        if abs(curve) < _STRAIGHT:
            self.steering[0] = self.steering[1] = angle
            return
        across, along = 2.0 * self.wheelbase * math.sin(angle), 2.0 * self.wheelbase * math.cos(angle)
        apart = self.steering_track * math.sin(angle)
        self.steering[0] = math.atan2(across, along + apart)
        self.steering[1] = math.atan2(across, along - apart)
