"""Parameters of the diff drive controller, with the names of all ROS distributions.

The names are those of Jazzy; names of noetic and humble are translated, with one warning each. Limits in the file are
applied unless `has_*_limits` is false, as in jazzy but not in noetic and humble. `min_acceleration`, which jazzy
declares and never reads, is `max_acceleration_reverse`, its exact equivalent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.base_params import NAN, PrefixedParams, TwistAxisLimits, refuse
from canopen_control.yamlfile.convert import setting

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.controllers.base import WheelGeometrySource
    from canopen_control.controllers.limiters import VelocityLimits
    from canopen_control.controllers.params import Params


@dataclass(frozen=True)
class SwitchedLimits(TwistAxisLimits):
    """Limits of `linear.x` or `angular.z`; a false `has_*_limits` disables its group, nan disables one limit."""

    has_velocity_limits: bool = setting(True, help="whether to apply the velocity limits")
    has_acceleration_limits: bool = setting(True, help="whether to apply the acceleration limits")
    has_jerk_limits: bool = setting(True, help="whether to apply the jerk limits")

    @property
    def freezes(self) -> bool:
        return self.has_jerk_limits and super().freezes

    def limits(self) -> VelocityLimits:
        limits = super().limits()
        if not self.has_velocity_limits:
            limits = replace(limits, min_velocity=NAN, max_velocity=NAN)
        if not self.has_acceleration_limits:
            limits = replace(
                limits,
                max_acceleration_reverse=NAN,
                max_acceleration=NAN,
                max_deceleration=NAN,
                max_deceleration_reverse=NAN,
            )
        return limits if self.has_jerk_limits else replace(limits, min_jerk=NAN, max_jerk=NAN)


@dataclass(frozen=True)
class DiffDriveParams(PrefixedParams):
    """Parameters of diff_drive_controller/DiffDriveController, in units of m, s, Hz and rad."""

    left_wheel_names: tuple[str, ...] | str = setting((), help="joints of the left wheels, a name or a list")
    right_wheel_names: tuple[str, ...] | str = setting((), help="joints of the right wheels, as many as on the left")
    wheel_separation: float = setting(
        0.0, low=0.0, help="distance in m between left and right wheels; absent: taken from the description"
    )
    wheel_radius: float = setting(0.0, low=0.0, help="radius of the wheels in m; absent: taken from the description")
    wheel_separation_multiplier: float = setting(1.0, help="calibration factor of `wheel_separation`")
    left_wheel_radius_multiplier: float = setting(1.0, help="calibration factor of the radius of the left wheels")
    right_wheel_radius_multiplier: float = setting(1.0, help="calibration factor of the radius of the right wheels")
    wheel_radius_multiplier: float = setting(NAN, help="calibration factor of the radius on both sides (noetic)")
    open_loop: bool = setting(
        False, help="whether to compute the odometry from the commands instead of the feedback of the wheels"
    )
    position_feedback: bool = setting(
        True, help="true: compute the odometry from wheel positions; false: from wheel velocities"
    )
    cmd_vel_timeout: float = setting(
        0.5, low=0.0, high=1e9, help="time in s after which a twist command expires; 0: never"
    )
    publish_limited_velocity: bool = setting(False, help="whether to publish the limited twist on `cmd_vel_out`")
    velocity_rolling_window_size: int = setting(
        10, low=1, high=100_000, help="number of samples over which the velocity of the odometry is averaged"
    )
    publish_rate: float = setting(50.0, low=0.001, help="rate in Hz of the odometry and the transform")
    linear: SwitchedLimits = setting(SwitchedLimits(), key="linear.x", section=True)
    angular: SwitchedLimits = setting(SwitchedLimits(), key="angular.z", section=True)

    @property
    def left(self) -> tuple[str, ...]:
        return (self.left_wheel_names,) if isinstance(self.left_wheel_names, str) else self.left_wheel_names

    @property
    def right(self) -> tuple[str, ...]:
        return (self.right_wheel_names,) if isinstance(self.right_wheel_names, str) else self.right_wheel_names

    @property
    def separation(self) -> float:
        """Wheel separation in m, including its multiplier."""
        return self.wheel_separation * self.wheel_separation_multiplier

    @property
    def left_radius(self) -> float:
        """Radius of the left wheels in m, including its multiplier."""
        return self.wheel_radius * self.left_wheel_radius_multiplier

    @property
    def right_radius(self) -> float:
        """Radius of the right wheels in m, including its multiplier."""
        return self.wheel_radius * self.right_wheel_radius_multiplier

    @property
    def frozen(self) -> tuple[str, ...]:
        """Twist axes whose speed is kept constant by a jerk limit of 0."""
        axes = {"linear.x": self.linear, "angular.z": self.angular}
        return tuple(name for name, axis in axes.items() if axis.freezes)


RENAMES: Final = {
    "left_wheel": "left_wheel_names",
    "right_wheel": "right_wheel_names",
    "publish_cmd": "publish_limited_velocity",
    "linear.x.min_acceleration": "linear.x.max_acceleration_reverse",
    "angular.z.min_acceleration": "angular.z.max_acceleration_reverse",
    "use_stamped_vel": "",  # Twist and TwistStamped are both accepted
    "wheels_per_side": "",  # upstream overwrites it with the length of the lists
    "estimate_velocity_from_position": "position_feedback",
    "allow_multiple_cmd_vel_publishers": "",
    "publish_wheel_joint_controller_state": "",
}
"""Names in noetic and humble, mapped to those of jazzy; "" marks parameters without effect."""


def read_params(
    params: Params, geometry: WheelGeometrySource | None = None, report: Callable[[str], object] = lambda _: None
) -> DiffDriveParams:
    """Return the checked parameters; raise RobotConfigError with all errors in them.

    Missing wheel dimensions are taken from the `geometry` of the description, as in noetic; `report` is called for
    each.
    """
    settings = _completed(params.read(DiffDriveParams, RENAMES), geometry, report)
    if not math.isnan(
        settings.wheel_radius_multiplier
    ):  # noetic: this multiplier overrides the multipliers of both sides
        both = settings.wheel_radius_multiplier
        settings = replace(settings, left_wheel_radius_multiplier=both, right_wheel_radius_multiplier=both)
    refuse(params.name, _checks(settings))
    params.source = settings
    return settings


def _completed(
    params: DiffDriveParams, geometry: WheelGeometrySource | None, report: Callable[[str], object]
) -> DiffDriveParams:
    if geometry is None:
        return params
    if params.wheel_separation <= 0.0 and (separation := geometry.separation(params.left, params.right)):
        report(f"wheel_separation is not given; the value of the description is used: {separation:g} m")
        params = replace(params, wheel_separation=separation)
    if params.wheel_radius <= 0.0 and (radius := geometry.radius((*params.left, *params.right))):
        report(f"wheel_radius is not given; the value of the description is used: {radius:g} m")
        params = replace(params, wheel_radius=radius)
    return params


def _checks(params: DiffDriveParams) -> list[tuple[bool, str]]:
    left, right = params.left, params.right
    both = sorted({*left} & {*right})
    positive = (params.separation > 0.0, params.left_radius > 0.0, params.right_radius > 0.0)
    return [
        (not left, "no left_wheel_names; give the joints of the left wheels"),
        (not right, "no right_wheel_names; give the joints of the right wheels"),
        (
            bool(left and right) and len(left) != len(right),
            f"{len(left)} left wheels and {len(right)} right wheels; give the same number of each",
        ),
        (bool(both), f"{', '.join(both)} is a wheel of both sides; list each wheel on one side"),
        (params.wheel_separation <= 0.0, "wheel_separation is missing or 0; give the distance between the wheels in m"),
        (params.wheel_radius <= 0.0, "wheel_radius is missing or 0; give it in m"),
        (
            params.wheel_separation > 0.0 and params.wheel_radius > 0.0 and not all(positive),
            "a multiplier of wheel_separation or wheel_radius is 0 or less; give a factor above 0",
        ),
    ]
