"""Parameters of wheeled bases: odometry, limits of the twist axes, and the parameters of diff drive, omni and mecanum.

The names of a diff drive's parameters are those of Jazzy; names of noetic and humble are translated, with one warning
each. Limits in the file are applied unless `has_*_limits` is false, as in jazzy but not in noetic and humble.
`min_acceleration`, which jazzy declares but never reads, is read as `max_acceleration_reverse`, its exact equivalent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, TypeVar

from canopen_control.controllers.limiters import VelocityLimits
from canopen_control.controllers.params import CommonParams, refuse, repeated
from canopen_control.yamlfile.convert import section, setting

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from canopen_control.controllers.base import WheelGeometrySource
    from canopen_control.controllers.params import Params


NAN: Final = math.nan
Six = tuple[float, float, float, float, float, float]
TWIST_TIMEOUT_HELP: Final = "time in s after which a twist command expires; 0: a command is used for one update"


@dataclass(frozen=True)
class TwistAxisLimits:
    """Limits of one twist axis, such as `linear.x`; nan means unlimited."""

    max_velocity: float = setting(
        NAN, low=0.0, nan=True, help="largest velocity in m/s or rad/s, forward or to the left"
    )
    min_velocity: float = setting(
        NAN,
        high=0.0,
        nan=True,
        help="largest velocity backward or to the right, as a negative number; absent: minus `max_velocity`",
    )
    max_acceleration: float = setting(
        NAN, low=0.0, nan=True, help="acceleration limit in m/s^2 or rad/s^2, forward or to the left"
    )
    max_deceleration: float = setting(
        NAN,
        high=0.0,
        nan=True,
        help="deceleration limit of a motion forward or to the left, as a negative number; absent: minus "
        "`max_acceleration`",
    )
    max_acceleration_reverse: float = setting(
        NAN, high=0.0, nan=True, help="acceleration limit backward or to the right, as a negative number"
    )
    max_deceleration_reverse: float = setting(
        NAN, low=0.0, nan=True, help="deceleration limit of a motion backward or to the right"
    )
    max_jerk: float = setting(NAN, low=0.0, nan=True, help="upper jerk limit in m/s^3 or rad/s^3")
    min_jerk: float = setting(
        NAN, high=0.0, nan=True, help="lower jerk limit, a negative number; absent: minus `max_jerk`"
    )

    @property
    def freezes(self) -> bool:
        """Whether the jerk limit is 0, which keeps the axis at constant speed."""
        return self.max_jerk == 0.0

    def limits(self) -> VelocityLimits:
        return VelocityLimits(
            self.min_velocity,
            self.max_velocity,
            self.max_acceleration_reverse,
            self.max_acceleration,
            self.max_deceleration,
            self.max_deceleration_reverse,
            self.min_jerk,
            self.max_jerk,
        )


@dataclass(frozen=True)
class BaseParams(CommonParams):
    """Parameters of every wheeled base: odometry frames, their transform, and covariances."""

    odom_frame_id: str = setting("odom", help="parent frame of the odometry")
    base_frame_id: str = setting("base_link", help="child frame of the odometry")
    pose_covariance_diagonal: Six = setting(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), help="diagonal of the covariance of the odometry's pose"
    )
    twist_covariance_diagonal: Six = setting(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), help="diagonal of the covariance of the odometry's twist"
    )
    enable_odom_tf: bool = setting(
        True, help="whether to publish the transform from the odometry frame to the base frame"
    )

    def mistakes(self) -> Iterator[str]:
        """Yield the error text of each failed check; the base class checks nothing."""
        return iter(())

    def frame_ids(self, namespace: str = "") -> tuple[str, str]:
        """Return the names of the odometry frame and the base frame, with their prefix."""
        prefix = self.frame_prefix(namespace)
        return prefix + self.odom_frame_id, prefix + self.base_frame_id

    def frame_prefix(self, namespace: str) -> str:
        """Return the prefix of frame names for a namespace; empty by default."""
        del namespace
        return ""


P = TypeVar("P", bound=BaseParams)


@dataclass(frozen=True)
class PrefixedParams(BaseParams):
    """Parameters of a base whose frame names may have a prefix."""

    tf_frame_prefix_enable: bool = setting(True, help="whether frame names get a prefix")
    tf_frame_prefix: str = setting("", help="prefix of the frame names; empty: the namespace")

    def frame_prefix(self, namespace: str) -> str:
        return tf_prefix(self.tf_frame_prefix, namespace, enable=self.tf_frame_prefix_enable)


def read_checked(params: Params, cls: type[P], renames: Mapping[str, str] | None = None) -> P:
    """Return the checked parameters of a base; raise RobotConfigError with all errors in them.

    `renames` is passed to `Params.read`.
    """
    settings = params.read(cls, renames)
    refuse(params, settings.mistakes())
    return settings


def dimension(name: str, given: float, described: float | None, report: Callable[[str], object]) -> float:
    """Return a dimension in m, or if it is missing (0), that of the description; `report` is called for the latter."""
    if given > 0.0 or not described:
        return given
    report(f"{name} is not given; the value of the description is used: {described:g} m")
    return described


def tf_prefix(prefix: str, namespace: str, *, enable: bool = True) -> str:
    """Return the prefix of frame names, or "" unless `enable`.

    The first `~` of `prefix` is replaced by the namespace; an empty `prefix` is the namespace itself.
    """
    if not enable:
        return ""
    text = prefix.replace("~", namespace, 1) if prefix else namespace
    if not text.endswith("/"):
        text += "/"
    return text.removeprefix("/")


# Parameters of the controllers of omni and mecanum wheels, by the names of jazzy.


MIN_WHEELS: Final = 3
_NONE: Final[Six] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class OmniParams(PrefixedParams):
    """Parameters of omni_wheel_drive_controller/OmniWheelDriveController, in units of m, s and rad."""

    pose_covariance_diagonal: Six = setting(
        _NONE, key="diagonal_covariance.pose", help="diagonal of the covariance of the odometry's pose"
    )
    twist_covariance_diagonal: Six = setting(
        _NONE, key="diagonal_covariance.twist", help="diagonal of the covariance of the odometry's twist"
    )
    wheel_names: tuple[str, ...] = setting(
        (), help="joints of the wheels, at least three, counterclockwise around the base"
    )
    wheel_offset: float | None = setting(
        None, help="angle in rad from straight ahead to the first wheel, seen from the centre of the base"
    )
    robot_radius: float = setting(0.0, low=0.0, help="distance in m from the centre of the base to a wheel")
    wheel_radius: float = setting(0.0, low=0.0, help="radius of the wheels in m")
    open_loop: bool = setting(
        False, help="whether to compute the odometry from the commands instead of the feedback of the wheels"
    )
    position_feedback: bool = setting(
        True, help="true: compute the odometry from wheel positions; false: from wheel velocities"
    )
    cmd_vel_timeout: float = setting(0.5, low=0.0, high=1e9, help=TWIST_TIMEOUT_HELP)

    def mistakes(self) -> Iterator[str]:
        names = self.wheel_names
        if len(names) < MIN_WHEELS:
            yield f"wheel_names has {len(names)} joints; give {MIN_WHEELS} or more, counterclockwise around the base"
        yield from repeated("wheel_names", names)
        if self.wheel_offset is None:
            yield "wheel_offset is missing; give the angle in rad of the first wheel, seen from the centre"
        if self.robot_radius <= 0.0:
            yield "robot_radius is missing or 0; give the distance in m from the centre to a wheel"
        if self.wheel_radius <= 0.0:
            yield "wheel_radius is missing or 0; give it in m"


WHEELS: Final = ("front_left", "front_right", "rear_right", "rear_left")
"""Mecanum wheels, in the order of the interfaces."""
COMMANDED: Final = tuple(f"{wheel}_wheel_command_joint_name" for wheel in WHEELS)
_RADIUS: Final = "kinematics.wheels_radius"
_REACH: Final = "kinematics.sum_of_robot_center_projection_on_X_Y_axis"
_COVARIANCE: Final[Six] = (0.1, 0.1, 0.1, 0.1, 0.1, 0.1)


@dataclass(frozen=True)
class MecanumParams(PrefixedParams):
    """Parameters of mecanum_drive_controller/MecanumDriveController, in units of m, s and rad."""

    pose_covariance_diagonal: Six = _COVARIANCE
    twist_covariance_diagonal: Six = _COVARIANCE
    reference_timeout: float = setting(0.0, low=0.0, high=1e9, help=TWIST_TIMEOUT_HELP)
    front_left_wheel_command_joint_name: str = setting("", help="command joint of the front left wheel")
    front_right_wheel_command_joint_name: str = setting("", help="command joint of the front right wheel")
    rear_right_wheel_command_joint_name: str = setting("", help="command joint of the rear right wheel")
    rear_left_wheel_command_joint_name: str = setting("", help="command joint of the rear left wheel")
    front_left_wheel_state_joint_name: str = setting(
        "", help="joint with the feedback of the front left wheel; empty: the command joint"
    )
    front_right_wheel_state_joint_name: str = setting(
        "", help="joint with the feedback of the front right wheel; empty: the command joint"
    )
    rear_right_wheel_state_joint_name: str = setting(
        "", help="joint with the feedback of the rear right wheel; empty: the command joint"
    )
    rear_left_wheel_state_joint_name: str = setting(
        "", help="joint with the feedback of the rear left wheel; empty: the command joint"
    )
    offset_x: float = setting(
        0.0,
        key="kinematics.base_frame_offset.x",
        help="distance in m forward from the centre of the wheels to the base frame",
    )
    offset_y: float = setting(
        0.0,
        key="kinematics.base_frame_offset.y",
        help="distance in m to the left from the centre of the wheels to the base frame",
    )
    offset_angle: float = setting(
        0.0, key="kinematics.base_frame_offset.theta", help="rotation of the base frame in rad, relative to the wheels"
    )
    radius: float = setting(0.0, key=_RADIUS, low=0.0, help="radius of the wheels in m")
    reach: float = setting(
        0.0, key=_REACH, low=0.0, help="distance in m from the centre to a wheel along x, plus the distance along y"
    )
    linear_x: TwistAxisLimits = section("linear.x", TwistAxisLimits())
    linear_y: TwistAxisLimits = section("linear.y", TwistAxisLimits())
    angular_z: TwistAxisLimits = section("angular.z", TwistAxisLimits())

    @property
    def commanded(self) -> tuple[str, ...]:
        """Commanded joints, in the order of `WHEELS`."""
        return tuple(getattr(self, key) for key in COMMANDED)

    @property
    def measured(self) -> tuple[str, ...]:
        """Joints with velocity feedback, in the order of `WHEELS`; by default the commanded joints."""
        names = (getattr(self, f"{wheel}_wheel_state_joint_name") for wheel in WHEELS)
        return tuple(name or joint for name, joint in zip(names, self.commanded, strict=True))

    @property
    def limits(self) -> tuple[TwistAxisLimits, ...]:
        """Limits of the twist axes: forward, to the left, and yaw."""
        return self.linear_x, self.linear_y, self.angular_z

    @property
    def offset(self) -> tuple[float, float, float]:
        """Pose of the base frame relative to the centre of the wheels: x and y in m, angle in rad."""
        return self.offset_x, self.offset_y, self.offset_angle

    def mistakes(self) -> Iterator[str]:
        for wheel, joint in zip(WHEELS, self.commanded, strict=True):
            if not joint:
                yield f"no {wheel}_wheel_command_joint_name; give the joint of this wheel"
        joints = [joint for joint in self.commanded if joint]
        if both := sorted({joint for joint in joints if joints.count(joint) > 1}):
            yield f"{', '.join(both)} is the joint of several wheels; give each wheel its own joint"
        if self.radius <= 0.0:
            yield f"{_RADIUS} is missing or 0; give it in m"
        if self.reach <= 0.0:
            yield f"{_REACH} is missing or 0; give the sum of a wheel's distances along x and y in m"


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


_MULTIPLIERS: Final = (
    "wheel_separation_multiplier",
    "left_wheel_radius_multiplier",
    "right_wheel_radius_multiplier",
)


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
    linear: SwitchedLimits = section("linear.x", SwitchedLimits())
    angular: SwitchedLimits = section("angular.z", SwitchedLimits())

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

    def mistakes(self) -> Iterator[str]:
        left, right = self.left, self.right
        if not left:
            yield "no left_wheel_names; give the joints of the left wheels"
        if not right:
            yield "no right_wheel_names; give the joints of the right wheels"
        if left and right and len(left) != len(right):
            yield f"{len(left)} left wheels and {len(right)} right wheels; give the same number of each"
        if both := sorted({*left} & {*right}):
            yield f"{', '.join(both)} is a wheel of both sides; list each wheel on one side"
        if self.wheel_separation <= 0.0:
            yield "wheel_separation is missing or 0; give the distance between the wheels in m"
        if self.wheel_radius <= 0.0:
            yield "wheel_radius is missing or 0; give it in m"
        each = math.isnan(self.wheel_radius_multiplier)
        for key in _MULTIPLIERS if each else (_MULTIPLIERS[0], "wheel_radius_multiplier"):
            if getattr(self, key) <= 0.0:
                yield f"{key} is {getattr(self, key):g}; give a factor above 0"


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

    Missing wheel dimensions are taken from `geometry`, as in noetic; `report` is called with a text for each.
    """
    settings = _completed(params.read(DiffDriveParams, RENAMES), geometry, report)
    if not math.isnan(
        settings.wheel_radius_multiplier
    ):  # noetic: this multiplier overrides the multipliers of both sides
        both = settings.wheel_radius_multiplier
        settings = replace(settings, left_wheel_radius_multiplier=both, right_wheel_radius_multiplier=both)
    refuse(params, settings.mistakes())
    params.source = settings
    return settings


def _completed(
    params: DiffDriveParams, geometry: WheelGeometrySource | None, report: Callable[[str], object]
) -> DiffDriveParams:
    if geometry is None:
        return params
    separation, radius = geometry.separation(params.left, params.right), geometry.radius((*params.left, *params.right))
    return replace(
        params,
        wheel_separation=dimension("wheel_separation", params.wheel_separation, separation, report),
        wheel_radius=dimension("wheel_radius", params.wheel_radius, radius, report),
    )
