"""Tricycle controller: converts twists to the speed and angle of one wheel that is driven and steered.

Names, defaults and limits are those of ros2_controllers' tricycle_controller, whose timeout is in ms. While the wheel
is far from its commanded angle it turns slowly, and both joints have their own limits. Difference from upstream:
minimum speeds, accelerations and jerks (`min_...` except `steering.min_position`) have no effect, because they would
keep a robot moving that should stop; without a twist the wheel brakes along `traction.max_deceleration` and keeps its
angle, see `mobile_base`; with a timeout of 0 a twist applies for one update, where upstream never moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final

from canopen_control.controllers.base import DriveGeometry
from canopen_control.controllers.base_params import BaseParams, read_checked
from canopen_control.controllers.limiters import (
    IMMOBILE,
    NAN,
    RateLaw,
    RateLimiter,
    VelocityLimits,
    immobile_text,
)
from canopen_control.controllers.mobile_base import MobileBase
from canopen_control.controllers.planar_pose import PlanarPose, RollingMean
from canopen_control.hardware.interfaces import OK, ReturnType
from canopen_control.rpc.messages.samples import OdometrySample, grown
from canopen_control.rpc.messages.state import ODOMETRY_RESET
from canopen_control.urdf.joint_element import POSITION, VELOCITY
from canopen_control.yamlfile.convert import section, setting

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface


_ON_TARGET: Final = math.pi / 6  # deviation of the steering in rad up to which the speed is not reduced
_SLOWEST: Final = 0.01  # fraction of the speed at a deviation of a quarter turn or more
_PER_MS: Final = 1000.0
_OF_ANGLE: Final = {"max_velocity": "max_position", "max_acceleration": "max_velocity", "max_jerk": "max_acceleration"}
"""Limits of the steering angle, by the limits of a `RateLaw`, whose value is the angle instead of a velocity."""
_RENAMES: Final = {
    "use_stamped_vel": "",
    **{f"traction.min_{quantity}": "" for quantity in ("velocity", "acceleration", "deceleration", "jerk")},
    **{f"steering.min_{quantity}": "" for quantity in ("velocity", "acceleration")},
}


@dataclass(frozen=True)
class TractionLimits:
    """Limits of the wheel speed, for both directions; nan means unlimited."""

    max_velocity: float = setting(NAN, low=0.0, nan=True, help="limit of the wheel speed in rad/s")
    max_acceleration: float = setting(NAN, low=0.0, nan=True, help="limit in rad/s^2 while the wheel speeds up")
    max_deceleration: float = setting(
        NAN, low=0.0, nan=True, help="limit in rad/s^2 while the wheel slows down; absent: `max_acceleration`"
    )
    max_jerk: float = setting(NAN, low=0.0, nan=True, help="half of the jerk limit in rad/s^3, as upstream applies it")

    def law(self) -> RateLaw:
        """Return the limits for a `RateLimiter`; the jerk is doubled, as in ros2_controllers."""
        gain, loss = self.max_acceleration, self.max_deceleration
        if math.isnan(gain) and not math.isnan(loss):
            gain = math.inf
        jerk = 2.0 * self.max_jerk
        return RateLaw(VelocityLimits(NAN, self.max_velocity, NAN, gain, -loss, loss, NAN, jerk))


@dataclass(frozen=True)
class SteeringLimits:
    """Limits of the steering angle, its velocity and acceleration; nan means unlimited."""

    max_position: float = setting(
        NAN, nan=True, help="upper limit of the steering angle in rad; absent: minus `min_position`"
    )
    min_position: float = setting(
        NAN, nan=True, help="lower limit of the steering angle in rad; absent: minus `max_position`"
    )
    max_velocity: float = setting(NAN, low=0.0, nan=True, help="limit of the steering velocity in rad/s")
    max_acceleration: float = setting(
        NAN, low=0.0, nan=True, help="half of the limit of the steering acceleration in rad/s^2, as upstream applies it"
    )

    def bounds(self) -> tuple[float, float]:
        """Return the minimum and maximum steering angle in rad; nan if unlimited."""
        low = -self.max_position if math.isnan(self.min_position) else self.min_position
        return low, -low if math.isnan(self.max_position) else self.max_position

    def law(self) -> RateLaw:
        """Return the limits of the angle for a `RateLimiter`; the acceleration is doubled, as in ros2_controllers."""
        low, high = self.bounds()
        speed, gain = self.max_velocity, 2.0 * self.max_acceleration
        return RateLaw(VelocityLimits(low, high, -speed, speed, -speed, speed, -gain, gain))


@dataclass(frozen=True)
class DrivenWheelParams(BaseParams):
    """Parameters of tricycle_controller/TricycleController, in units of m, rad and ms."""

    traction_joint_name: str = setting("", help="joint that drives the wheel")
    steering_joint_name: str = setting("", help="joint that steers the wheel")
    wheelbase: float = setting(0.0, low=0.0, help="distance in m from the driven wheel to the axle of the other wheels")
    wheel_radius: float = setting(0.0, low=0.0, help="radius of the driven wheel in m")
    open_loop: bool = setting(
        False, help="whether to compute the odometry from the commands instead of the feedback of the wheel"
    )
    enable_odom_tf: bool = setting(
        False, help="whether to publish the transform from the odometry frame to the base frame"
    )
    odom_only_twist: bool = setting(
        False, help="whether to publish the odometry without the pose; the transform contains the pose"
    )
    publish_ackermann_command: bool = setting(
        False, help="whether to publish speed (rad/s) and angle on `cmd_ackermann`"
    )
    cmd_vel_timeout: int = setting(
        500,
        low=0,
        high=10**9,
        help="time in ms after which a twist command expires; 0: a command is used for one update",
    )
    velocity_rolling_window_size: int = setting(
        10, low=1, high=100_000, help="number of updates over which the velocity of the odometry is averaged"
    )
    traction: TractionLimits = section("traction", TractionLimits())
    steering: SteeringLimits = section("steering", SteeringLimits())

    def mistakes(self) -> Iterator[str]:
        for key in ("traction_joint_name", "steering_joint_name"):
            if not getattr(self, key):
                yield f"no {key}; give the joint"
        if self.traction_joint_name and self.traction_joint_name == self.steering_joint_name:
            yield f"{self.traction_joint_name} is both traction and steering joint; give a joint for each"
        if self.wheelbase <= 0.0:
            yield "wheelbase is missing or 0; give the distance of the wheel from the axle in m"
        if self.wheel_radius <= 0.0:
            yield "wheel_radius is missing or 0; give it in m"
        low, high = self.steering.bounds()
        if low > high:
            yield f"steering.min_position {low:g} is above steering.max_position {high:g}; exchange them"
        if not (law := self.traction.law()).brakes:  # a motion would continue after the end of its commands
            key = "max_acceleration" if math.isnan(self.traction.max_deceleration) else "max_deceleration"
            yield f"traction.{key} is 0, so the wheel would never brake; give a value above 0, or remove it"
        elif law.immobile == "max_jerk":
            yield "traction.max_jerk is 0, so the wheel can neither start nor brake; remove it"


class DrivenWheelPose(PlanarPose):
    """Odometry of a base with one driven and steered wheel; the mean velocities are in m/s and rad/s."""

    def __init__(self, radius: float, wheelbase: float, window: int = 1) -> None:
        super().__init__()
        self.linear = self.angular = 0.0
        self._radius, self._wheelbase = radius, wheelbase
        self._means = RollingMean(window), RollingMean(window)

    def follow(self, speed: float, angle: float, dt: float) -> None:
        """Integrate the wheel motion over `dt` s, at `speed` in rad/s and steering angle `angle` in rad."""
        rim = speed * self._radius
        linear, angular = rim * math.cos(angle), rim * math.sin(angle) / self._wheelbase
        self.drive(linear * dt, angular * dt)
        for mean, value in zip(self._means, (linear, angular), strict=True):
            mean.add(value)
        self.linear, self.angular = (mean.mean for mean in self._means)

    def integrate_command(self, linear: float, angular: float, dt: float) -> None:
        """Integrate a commanded twist, in m/s and rad/s, over `dt` s."""
        self.linear, self.angular = linear, angular
        self.drive(linear * dt, angular * dt)

    def command(self, linear: float, angular: float) -> tuple[float, float]:
        """Return the wheel speed in rad/s and the steering angle in rad for a twist; 90 degrees turn on the spot."""
        across = angular * self._wheelbase
        speed = math.hypot(linear, across) / self._radius
        if linear == 0.0:
            return speed, math.copysign(math.pi / 2, angular) if angular else 0.0
        return math.copysign(speed, linear), math.atan(across / linear)


class TricycleController(MobileBase):
    """Controller of a base with one wheel that is driven and steered; `kinematics` contains the pose."""

    title: ClassVar[str] = "Tricycle: one wheel drives and steers"
    reads: ClassVar[type[DrivenWheelParams]] = DrivenWheelParams
    sections: ClassVar[dict[str, type[object]]] = {
        "Limits: `traction.KEY`": TractionLimits,
        "Limits: `steering.KEY`": SteeringLimits,
    }
    references: ClassVar[tuple[str, ...]] = ()
    offers: ClassVar[tuple[str, ...]] = (ODOMETRY_RESET,)
    settable: ClassVar[tuple[str, ...]] = (
        "cmd_vel_timeout", "enable_odom_tf", "odom_only_twist", "publish_ackermann_command", "traction.*", "steering.*",
    )  # fmt: skip

    def __init__(self, name: str, type_name: str = "") -> None:
        self.kinematics = DrivenWheelPose(1.0, 1.0)
        super().__init__(name, type_name, self.kinematics)
        self.params = DrivenWheelParams()
        self._limiter = RateLimiter((0.0, NAN))  # the angle starts from the actual steering angle
        self._set_limits()
        self._commanded, self._actual = [0.0, NAN], [0.0, NAN]
        self._published: tuple[float, float] | None = None
        """Commanded speed in rad/s and angle in rad at the last publication of the odometry."""

    def wheel_base(self) -> DriveGeometry:
        params = self.params
        return DriveGeometry((), (), 0.0, params.wheel_radius, *params.frame_ids(), params.enable_odom_tf)

    def on_configure(self, params: Params) -> None:
        self.params = settings = read_checked(params, DrivenWheelParams, _RENAMES)
        self.kinematics = DrivenWheelPose(
            settings.wheel_radius, settings.wheelbase, settings.velocity_rolling_window_size
        )
        self.pose = self.kinematics
        self.joints = (settings.traction_joint_name, settings.steering_joint_name)
        self._set_limits()
        self.set_up(settings, settings.cmd_vel_timeout / _PER_MS, len(self.joints), open_loop=settings.open_loop)
        self._report_immobile()

    def on_set(self, params: Params) -> None:
        settings = read_checked(params, DrivenWheelParams, _RENAMES)
        self.apply_parameters(settings, settings.cmd_vel_timeout / _PER_MS)
        self.params = settings
        self._set_limits()
        self._report_immobile()

    def _set_limits(self) -> None:
        self._limiter.laws = [self.params.traction.law(), self.params.steering.law()]

    def _report_immobile(self) -> None:
        """Report limits of 0 with which a joint does not move, which upstream's limiters apply too."""
        traction, steering = self._limiter.laws
        if traction.immobile:
            self.report(IMMOBILE, immobile_text(f"traction.{traction.immobile}", "the wheel does not turn"))
        if steering.immobile:
            key = f"steering.{_OF_ANGLE[steering.immobile]}"
            self.report(IMMOBILE, immobile_text(key, "the wheel is not steered"))

    def command_interface_names(self) -> list[str]:
        return [f"{self.params.traction_joint_name}/{VELOCITY}", f"{self.params.steering_joint_name}/{POSITION}"]

    def state_interface_names(self) -> list[str]:
        return self.command_interface_names()

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        super().on_activate(commands, states, now)
        self._limiter.reset()

    def forget(self, now: int) -> None:
        super().forget(now)
        self._limiter.reset()

    def sample(self, wall_offset_ns: int) -> OdometrySample | None:
        odometry, params = self.odometry_sample(wall_offset_ns), self.params
        if odometry is None:
            return None
        ackermann = self._published if params.publish_ackermann_command else None
        return grown(OdometrySample, odometry, only_twist=params.odom_only_twist, ackermann=ackermann)

    def velocities(self) -> tuple[float, float, float]:
        return self.kinematics.linear, 0.0, self.kinematics.angular

    def advance(self, dt: float) -> None:
        self.kinematics.follow(self.states[0].value, self.states[1].value, dt)

    def integrate_command(self, dt: float) -> None:
        self.kinematics.integrate_command(self.limited[0], self.limited[1], dt)

    def compute_commands(self, twist: Sequence[float]) -> None:
        """Compute the wheel speed and the steering angle from a twist; `update` limits their rates of change.

        The speed is reduced while the steering is far from the commanded angle.
        """
        speed, angle = self.kinematics.command(twist[0], twist[1])
        off = abs(angle - self.states[1].value) if self.states else NAN
        if off >= _ON_TARGET:  # False while the steering angle is unknown
            speed *= max(math.cos(min(off, math.pi / 2)), _SLOWEST)
        traction, steering = self._limiter.laws
        self.targets[:] = traction.limit_velocity(speed), steering.limit_velocity(angle)

    def update(self, now: int, period: float) -> ReturnType:
        """Execute one control step, and limit the rates of change of both wheel commands."""
        result = super().update(now, period)
        if result is OK and all(command.enabled for command in self.commands):
            actual, commanded, limiter = self._actual, self._commanded, self._limiter
            actual[1] = self.states[1].value
            for index, command in enumerate(self.commands):
                commanded[index] = command.value
            if limiter.enforce(actual, commanded, period):
                for index, command in enumerate(self.commands):
                    command.value = commanded[index]
            limiter.step(actual, commanded)
        if self.stamp == now:
            speed, angle = self._limiter.last
            self._published = (speed, angle) if math.isfinite(angle) else None
        return result
