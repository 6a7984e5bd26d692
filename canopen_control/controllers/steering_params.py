"""Parameters of the bicycle, tricycle and Ackermann steering controllers.

The names are those of Jazzy. Names of humble, for front and rear wheels, are translated according to `front_steering`,
with one warning each, as are keys without an effect.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Final

from canopen_control.controllers.base_params import (
    TWIST_TIMEOUT_HELP,
    BaseParams,
    Six,
    SwitchedLimits,
    TwistAxisLimits,
    dimension,
    read_checked,
)
from canopen_control.controllers.params import repeated
from canopen_control.controllers.steering_kinematics import (
    AckermannKinematics,
    SteeringKinematics,
    TricycleKinematics,
)
from canopen_control.yamlfile.convert import section, setting

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.controllers.base import WheelGeometrySource
    from canopen_control.controllers.params import Params


#: upstream's default: the indices of the diagonal, by mistake, instead of its values
_COVARIANCE: Final[Six] = (0.0, 7.0, 14.0, 21.0, 28.0, 35.0)


@dataclass(frozen=True)
class SteeringParams(BaseParams):
    """Common parameters of steering controllers, in units of m and s; joints are listed from right to left."""

    kinematics: ClassVar[type[SteeringKinematics]] = SteeringKinematics
    radius_key: ClassVar[str] = "traction_wheels_radius"

    pose_covariance_diagonal: Six = _COVARIANCE
    twist_covariance_diagonal: Six = _COVARIANCE
    reference_timeout: float = setting(1.0, low=0.0, high=1e9, help=TWIST_TIMEOUT_HELP)
    traction_joints_names: tuple[str, ...] = setting((), help="joints of the driven wheels, from right to left")
    steering_joints_names: tuple[str, ...] = setting((), help="joints of the steered wheels, from right to left")
    traction_joints_state_names: tuple[str, ...] = setting(
        (), help="joints with the feedback of the driven wheels; empty: `traction_joints_names`"
    )
    steering_joints_state_names: tuple[str, ...] = setting(
        (), help="joints with the feedback of the steered wheels; empty: `steering_joints_names`"
    )
    open_loop: bool = setting(
        False,
        help="whether to compute odometry and wheel speeds from the commanded curve instead of the measured curve",
    )
    reduce_wheel_speed_until_steering_reached: bool = setting(
        False, help="whether to drive slowly while a steering angle is off by 30 degrees or more"
    )
    position_feedback: bool = setting(
        False, help="true: compute the odometry from the positions of the driven wheels; false: from their velocities"
    )
    velocity_rolling_window_size: int = setting(
        10, low=1, high=100_000, help="number of updates over which the velocity of the odometry is averaged"
    )
    wheelbase: float = setting(0.0, low=0.0, help="distance between the axles in m")
    front_steering: bool = setting(
        True,
        help="whether the front wheels steer, for the old parameter names with front and rear (deprecated, as are "
        "those names)",
    )

    @property
    def radius(self) -> float:
        """Radius of the traction wheels in m."""
        radius: float = getattr(self, self.radius_key)
        return radius

    @property
    def tracks(self) -> tuple[float, float]:
        """Distances in m between the traction wheels and between the steered wheels; 0.0 for a single wheel."""
        return 0.0, 0.0

    @property
    def limits(self) -> tuple[TwistAxisLimits, ...]:
        """Limits of the twist axes; empty, since upstream's steering controllers have no limits."""
        return ()

    @property
    def traction_states(self) -> tuple[str, ...]:
        """Joints with traction feedback; by default the traction joints."""
        return self.traction_joints_state_names or self.traction_joints_names

    @property
    def steering_states(self) -> tuple[str, ...]:
        """Joints with steering feedback; by default the steering joints."""
        return self.steering_joints_state_names or self.steering_joints_names

    def fitted_kinematics(self) -> SteeringKinematics:
        """Return new kinematics with these dimensions, at the origin and with `fits` enabled."""
        kinematics = self.kinematics(self.radius, self.wheelbase, *self.tracks, self.velocity_rolling_window_size)
        kinematics.fits = True
        return kinematics

    def mistakes(self) -> Iterator[str]:
        counts = {"traction": self.kinematics.traction_count, "steering": self.kinematics.steering_count}
        for part, count in counts.items():
            for key in (f"{part}_joints_names", f"{part}_joints_state_names"):
                names: tuple[str, ...] = getattr(self, key)
                optional = key.endswith("state_names")
                advice = f"give {count}{' or none' if optional else ''}, from right to left"
                if len(names) != count and not (optional and not names):
                    yield f"{key} has {len(names)} joints; {advice}"
                yield from repeated(key, names)
        if self.wheelbase <= 0.0:
            yield "wheelbase is missing or 0; give the distance between front and rear axle in m"
        if self.radius <= 0.0:
            yield f"{self.radius_key} is missing or 0; give it in m"


@dataclass(frozen=True)
class BicycleParams(SteeringParams):
    """Parameters of bicycle_steering_controller/BicycleSteeringController."""

    radius_key: ClassVar[str] = "traction_wheel_radius"

    traction_wheel_radius: float = setting(0.0, low=0.0, help="radius of the driven wheel in m")


@dataclass(frozen=True)
class TricycleParams(SteeringParams):
    """Parameters of tricycle_steering_controller/TricycleSteeringController."""

    kinematics: ClassVar[type[SteeringKinematics]] = TricycleKinematics

    traction_wheels_radius: float = setting(0.0, low=0.0, help="radius of the driven wheels in m")
    traction_track_width: float = setting(0.0, low=0.0, help="distance between the driven wheels in m")

    @property
    def tracks(self) -> tuple[float, float]:
        return self.traction_track_width, 0.0

    def mistakes(self) -> Iterator[str]:
        yield from super().mistakes()
        if self.traction_track_width <= 0.0:
            yield "traction_track_width is missing or 0; give the distance between the traction wheels in m"


@dataclass(frozen=True)
class AckermannParams(TricycleParams):
    """Parameters of ackermann_steering_controller/AckermannSteeringController."""

    kinematics: ClassVar[type[SteeringKinematics]] = AckermannKinematics

    steering_track_width: float = setting(
        0.0, low=0.0, help="distance between the steered wheels in m; 0: `traction_track_width`"
    )

    @property
    def tracks(self) -> tuple[float, float]:
        """Traction and steering track in m; the steering track defaults to the traction track."""
        return self.traction_track_width, self.steering_track_width or self.traction_track_width


#: humble's names after "front_" or "rear_", and the names after "traction_" or "steering_"
_RENAMED: Final = {
    "wheels_names": "joints_names",
    "wheels_state_names": "joints_state_names",
    "wheel_radius": "wheel_radius",
    "wheels_radius": "wheels_radius",
    "wheel_track": "track_width",
}
_ALWAYS: Final = {
    "wheel_track": "traction_track_width",  # the name of the tricycle
    "use_stamped_vel": "",  # Twist and TwistStamped are both accepted
}


def read_params(params: Params, cls: type[SteeringParams]) -> SteeringParams:
    """Return the checked parameters of class `cls`; raise RobotConfigError with all errors in them."""
    return read_checked(params, cls, _renames(params, cls))


def _renames(params: Params, cls: type[SteeringParams]) -> dict[str, str]:
    """Map humble's parameter names for front and rear wheels to the new names; "" means without effect."""
    node = params.flat.get("front_steering")
    by_front = node is None or node.text.lower() != "false"
    fields = cls.__dataclass_fields__
    renames = {}
    for end, part in (
        ("front", "steering" if by_front else "traction"),
        ("rear", "traction" if by_front else "steering"),
    ):
        for old, new in _RENAMED.items():
            renames[f"{end}_{old}"] = f"{part}_{new}" if f"{part}_{new}" in fields else ""
    return renames | {key: name if name in fields else "" for key, name in _ALWAYS.items()}


# The parameters of ROS 1's Ackermann steering controller: those of a bicycle with one rear wheel and one front steer.
#
# Rules (ros_controllers, noetic): this controller moves two joints under the type name that ROS 2 uses for four joints,
# so its keys decide which controller is meant. Its names are translated to those of the bicycle, with one warning each;
# odometry uses the position of the wheel. Differences are reported: `angular.z` of a twist is in rad/s here, and was
# the steering angle in ROS 1, so its limits have no effect. Missing dimensions are taken from the description, as in
# noetic.


_OWN: Final = ("rear_wheel", "front_steer", "wheel_separation_h")
_ANGLE: Final = "angular.z of a twist is the yaw rate in rad/s; ROS 1's controller used it as the angle of front_steer"


@dataclass(frozen=True)
class Ros1AckermannParams(BicycleParams):
    """Parameters of ROS 1's Ackermann steering controller: two joints, multipliers, and limits of `linear.x`."""

    reference_timeout: float = setting(0.5, low=0.0, high=1e9)
    position_feedback: bool = True
    rear_wheel: str = "rear_wheel_joint"
    front_steer: str = "front_steer_joint"
    wheel_separation_h_multiplier: float = 1.0
    wheel_radius_multiplier: float = 1.0
    steer_pos_multiplier: float = 1.0
    linear: SwitchedLimits = section("linear.x", SwitchedLimits())

    @property
    def limits(self) -> tuple[TwistAxisLimits, ...]:
        return self.linear, TwistAxisLimits()

    def as_bicycle(self) -> Ros1AckermannParams:
        """Return a copy with the joint names and dimensions of a bicycle, with multipliers applied."""
        return replace(
            self,
            traction_joints_names=(self.rear_wheel,),
            steering_joints_names=(self.front_steer,),
            wheelbase=self.wheelbase * self.wheel_separation_h_multiplier,
            traction_wheel_radius=self.traction_wheel_radius * self.wheel_radius_multiplier,
        )

    def mistakes(self) -> Iterator[str]:
        yield from super().mistakes()
        if self.steer_pos_multiplier != 1.0:
            scale = "it scales only the feedback; set scale_pos_from_dev and scale_pos_to_dev instead"
            yield f"steer_pos_multiplier is {self.steer_pos_multiplier:g}; {scale}"


_RENAMES: Final = {
    "wheel_separation_h": "wheelbase",
    "wheel_radius": "traction_wheel_radius",
    "cmd_vel_timeout": "reference_timeout",
    "linear.x.min_acceleration": "linear.x.max_acceleration_reverse",
    "publish_rate": "",  # odometry is published in every update
    "allow_multiple_cmd_vel_publishers": "",
    **{
        f"angular.z.{key}": ""
        for key in (
            *("has_velocity_limits", "has_acceleration_limits", "has_jerk_limits", "min_acceleration"),
            *(f"{bound}_{what}" for bound in ("min", "max") for what in ("velocity", "jerk")),
            "max_acceleration",
        )
    },
}


def is_ros1(params: Params) -> bool:
    """Whether the parameters are those of ROS 1's Ackermann steering controller."""
    return any(params.flat.get(key) is not None for key in _OWN)


def read_ros1(
    params: Params, geometry: WheelGeometrySource | None = None, report: Callable[[str], object] = lambda _: None
) -> Ros1AckermannParams:
    """Convert the parameters of ROS 1's controller to those of a bicycle, without checks for contradictions.

    Missing dimensions are taken from the `geometry` of the description; `report` is called for each.
    """
    key = params.flat.keys().get("front_steer") or params.flat.keys()[next(key for key in _OWN if params.flat.get(key))]
    key.warning(_ANGLE)
    settings = _completed(params.read(Ros1AckermannParams, _RENAMES), geometry, report).as_bicycle()
    params.source = settings
    return settings


def _completed(
    params: Ros1AckermannParams, geometry: WheelGeometrySource | None, report: Callable[[str], object]
) -> Ros1AckermannParams:
    if geometry is None:
        return params
    wheel = (params.rear_wheel,)
    base, radius = geometry.separation(wheel, (params.front_steer,)), geometry.radius(wheel)
    return replace(
        params,
        wheelbase=dimension("wheel_separation_h", params.wheelbase, base, report),
        traction_wheel_radius=dimension("wheel_radius", params.traction_wheel_radius, radius, report),
    )
