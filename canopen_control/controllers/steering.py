"""The steering controllers: a twist becomes speeds of traction wheels and angles of steered ones.

The law of the file (ros2_controllers jazzy): odometry is followed and published in every update, commanded or not.
Without a twist traction is 0 and the steered wheels stay as they are; a twist of zeros that is commanded steers them
straight. In closed loop the wheels of a curve turn as the measured curve wants it. Ours: a `reference_timeout` of 0
lets a twist move it for one update, no wheel turns faster than the wanted curve needs, wherever the steering still is,
the speed of two wheels is the fit to both (`SteeringKinematics.fits`), and feedback is waited for, see `mobile_base`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Final

from mypy_extensions import mypyc_attr

from canopen_control.controllers.base import ControllerState, WheelBase, finite
from canopen_control.controllers.base_params import AxisLimits, BaseParams, Six, refuse
from canopen_control.controllers.diff_drive import SwitchedLimits
from canopen_control.controllers.mobile_base import MobileBase
from canopen_control.controllers.planar_pose import MIN_DT, PlanarPose, RollingMean, quotient
from canopen_control.rpc.messages.samples import SteeringSample, grown
from canopen_control.urdf.joint_element import POSITION, VELOCITY
from canopen_control.yamlfile.convert import setting

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.controllers.base import Geometry
    from canopen_control.controllers.params import Params
    from canopen_control.rpc.messages.samples import OdometrySample, Sample


# Kinematics of bases with steered wheels: bicycle, tricycle and Ackermann steering, and their odometry.
#
# The law of the file (ros2_controllers jazzy): of two wheels the right one is first. Commands are in the wheels' rad/s
# and rad; in closed loop the wheels of a curve have the speeds of the curve that is measured, not of the one that is
# wanted. Two traction wheels never turn the base on the spot: at no speed they stand. Units: m, rad, s.


_STRAIGHT: Final = 1e-6  # rad: below it a steering angle is none
_ON_TARGET: Final = math.pi / 6  # rad: as near as this to its angle a wheel may have its whole speed
_MOST_OFF: Final = 1.5608  # rad: what is further off is as slow as this


@mypyc_attr(allow_interpreted_subclasses=True)
class SteeringKinematics(PlanarPose):
    """One traction wheel and one steered one: a bicycle; the others override what differs.

    `linear` (m/s) and `angular` (rad/s) are means over the last `window` steps, `angle` is the measured steering angle.
    `traction` and `steering` are the wheels' commands after `command`. `fits` says how the speed between two wheels is
    taken: as the mean of what each says, as upstream, which has a pole where one of them is the middle of the curve, or
    as the fit to both, the same where the wheels agree.
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
        """Take means over another number of steps, from now on."""
        self._linears, self._angulars = RollingMean(window), RollingMean(window)

    def reset(self) -> None:
        """Be at the origin; the means begin anew."""
        self.set_pose(0.0, 0.0, 0.0)

    def set_pose(self, x: float, y: float, heading: float) -> None:
        """Be somewhere else; the means begin anew."""
        super().set_pose(x, y, heading)
        self._linears.clear()
        self._angulars.clear()

    # ------------------------------------------------------------------------------------------------- what differs

    def measured_angle(self, steering: Sequence[float]) -> float:
        """Return the angle of a single steered wheel in the middle, for the angles of those that there are."""
        return steering[0]

    def measured_speed(self, traction: Sequence[float], angle: float) -> float:
        """Return the speed of the base in m/s, for the wheels' in rad/s."""
        del angle
        return self.radius * traction[0]

    def set_traction(self, speed: float, angle: float) -> None:
        """Share out a speed in rad/s among the wheels of a curve."""
        del angle
        self.traction[0] = speed

    def set_steering(self, angle: float, curve: float) -> None:
        """Share out an angle among the steered wheels; `curve` is the angle of the curve that is driven."""
        del curve
        self.steering[0] = angle

    # ----------------------------------------------------------------------------------------------------- odometry

    def begin(self, positions: Sequence[float]) -> None:
        """Take the wheels' positions, in rad, as where they start from."""
        for index in range(self.traction_count):
            self._positions[index] = positions[index]

    def update_position(self, traction: Sequence[float], steering: Sequence[float], dt: float) -> bool:
        """Follow the positions of traction and steering, in rad; `dt` in s. Return whether the step told a velocity."""
        for index in range(self.traction_count):
            self._speeds[index] = quotient(traction[index] - self._positions[index], dt)
            self._positions[index] = traction[index]
        return self.update_velocity(self._speeds, steering, dt)

    def update_velocity(self, traction: Sequence[float], steering: Sequence[float], dt: float) -> bool:
        """Follow the speeds of traction, in rad/s, and the positions of steering."""
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
        """Believe a command, in m/s and rad/s."""
        self.linear, self.angular = linear, angular
        self.drive(linear * dt, angular * dt)

    # ----------------------------------------------------------------------------------------------------- commands

    def command(self, linear: float, angular: float, open_loop: bool, reduce: bool = False) -> None:
        """Make `traction` and `steering` of a twist in m/s and rad/s.

        `reduce` slows the wheels down, in closed loop, until the steering is where it is wanted.
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
        """Keep every traction wheel as slow as the wanted curve has its fastest one, in m/s and rad/s; after `command`.

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
        """Have the outer of two traction wheels turn faster than the inner one."""
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
    """One traction wheel and one steered wheel, one behind the other."""


class TricycleKinematics(SteeringKinematics):
    """Two traction wheels on an axle and one steered wheel."""

    traction_count: ClassVar[int] = 2

    def measured_speed(self, traction: Sequence[float], angle: float) -> float:
        """Return the mean of both wheels, each by its way in the curve."""
        return self.mean_speed(traction, angle)

    def set_traction(self, speed: float, angle: float) -> None:
        """Share out the speed between both wheels."""
        self.share(speed, angle)


class AckermannKinematics(TricycleKinematics):
    """Two traction wheels on an axle and two steered wheels, whose axes meet in the middle of the curve."""

    steering_count: ClassVar[int] = 2

    def measured_angle(self, steering: Sequence[float]) -> float:
        """Return the mean of what each of the two wheels says."""
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


# The parameters of the steering controllers: bicycle, tricycle, Ackermann.
#
# The law of the file: jazzy's names are ours; those of humble, by front and rear wheels, are translated by
# `front_steering` and each is named once, as is every key without an effect.


_MOST_JOINTS: Final = 4
#: what upstream has: the places of a diagonal, where its values were meant
_COVARIANCE: Six = (0.0, 7.0, 14.0, 21.0, 28.0, 35.0)


@dataclass(frozen=True)
class SteeringParams(BaseParams):
    """What all steering controllers have: m, s, joints from right to left."""

    kinematics: ClassVar[type[SteeringKinematics]] = SteeringKinematics
    radius_key: ClassVar[str] = "traction_wheels_radius"

    pose_covariance_diagonal: Six = _COVARIANCE
    twist_covariance_diagonal: Six = _COVARIANCE
    reference_timeout: float = setting(1.0, low=0.0, high=1e9)
    traction_joints_names: tuple[str, ...] = ()
    steering_joints_names: tuple[str, ...] = ()
    traction_joints_state_names: tuple[str, ...] = ()
    steering_joints_state_names: tuple[str, ...] = ()
    open_loop: bool = False
    reduce_wheel_speed_until_steering_reached: bool = False
    position_feedback: bool = False
    velocity_rolling_window_size: int = setting(10, low=1, high=100_000)
    wheelbase: float = setting(0.0, low=0.0)
    front_steering: bool = True

    @property
    def radius(self) -> float:
        """The radius of the traction wheels."""
        raise NotImplementedError

    @property
    def tracks(self) -> tuple[float, float]:
        """The distances of the traction wheels and of the steered wheels, 0 for one wheel."""
        return 0.0, 0.0

    @property
    def limits(self) -> tuple[AxisLimits, ...]:
        """The limits of each axis of the twist; upstream has none."""
        return ()

    @property
    def traction_states(self) -> tuple[str, ...]:
        """The joints where traction is measured."""
        return self.traction_joints_state_names or self.traction_joints_names

    @property
    def steering_states(self) -> tuple[str, ...]:
        """The joints where steering is measured."""
        return self.steering_joints_state_names or self.steering_joints_names

    def made(self) -> SteeringKinematics:
        """Return the kinematics of these sizes, at the origin; speeds are fitted."""
        made = self.kinematics(self.radius, self.wheelbase, *self.tracks, self.velocity_rolling_window_size)
        made.fits = True
        return made

    def mistakes(self) -> Iterator[tuple[bool, str]]:
        """Say what is wrong, each with whether it is."""
        counts = {"traction": self.kinematics.traction_count, "steering": self.kinematics.steering_count}
        for part, count in counts.items():
            for key in (f"{part}_joints_names", f"{part}_joints_state_names"):
                names: tuple[str, ...] = getattr(self, key)
                optional = key.endswith("state_names")
                wanted = f"give {count}{' or none' if optional else ''}, from right to left"
                yield len(names) != count and not (optional and not names), f"{key} has {len(names)} joints; {wanted}"
                yield len(set(names)) < len(names), f"{key} names one twice: {', '.join(names)}; name each once"
        yield self.wheelbase <= 0.0, "wheelbase is missing or 0; give the distance of front and rear axle in m"
        yield self.radius <= 0.0, f"{self.radius_key} is missing or 0; give it in m"


@dataclass(frozen=True)
class BicycleParams(SteeringParams):
    """Parameters of bicycle_steering_controller/BicycleSteeringController."""

    kinematics: ClassVar[type[SteeringKinematics]] = BicycleKinematics
    radius_key: ClassVar[str] = "traction_wheel_radius"

    traction_wheel_radius: float = setting(0.0, low=0.0)

    @property
    def radius(self) -> float:
        """The radius of the traction wheel."""
        return self.traction_wheel_radius


@dataclass(frozen=True)
class TricycleParams(SteeringParams):
    """Parameters of tricycle_steering_controller/TricycleSteeringController."""

    kinematics: ClassVar[type[SteeringKinematics]] = TricycleKinematics

    traction_wheels_radius: float = setting(0.0, low=0.0)
    traction_track_width: float = setting(0.0, low=0.0)

    @property
    def radius(self) -> float:
        """The radius of the traction wheels."""
        return self.traction_wheels_radius

    @property
    def tracks(self) -> tuple[float, float]:
        """The distance of the traction wheels; one wheel is steered."""
        return self.traction_track_width, 0.0

    def mistakes(self) -> Iterator[tuple[bool, str]]:
        """Say what is wrong, the distance of the wheels too."""
        yield from super().mistakes()
        missing = "traction_track_width is missing or 0; give the distance of the traction wheels in m"
        yield self.traction_track_width <= 0.0, missing


@dataclass(frozen=True)
class AckermannParams(TricycleParams):
    """Parameters of ackermann_steering_controller/AckermannSteeringController."""

    kinematics: ClassVar[type[SteeringKinematics]] = AckermannKinematics

    steering_track_width: float = setting(0.0, low=0.0)

    @property
    def tracks(self) -> tuple[float, float]:
        """The distances of the traction wheels and of the steered ones, which are those of traction unless given."""
        return self.traction_track_width, self.steering_track_width or self.traction_track_width


#: what a key of humble names of its wheels, and what that is called by what the wheels do
_RENAMED: Final = {
    "wheels_names": "joints_names",
    "wheels_state_names": "joints_state_names",
    "wheel_radius": "wheel_radius",
    "wheels_radius": "wheels_radius",
    "wheel_track": "track_width",
}
_ALWAYS: Final = {
    "wheel_track": "traction_track_width",  # of the tricycle
    "use_stamped_vel": "",  # Twist and TwistStamped are both taken
}


def read_params(params: Params, cls: type[SteeringParams]) -> SteeringParams:
    """Return checked parameters; RobotConfigError with every mistake."""
    given = params.read(cls, _renames(params, cls))
    refuse(params.name, given.mistakes())
    return given


def _renames(params: Params, cls: type[SteeringParams]) -> dict[str, str]:
    """Return the names of keys by front and rear wheels, as `front_steering` has it; "" for what has no effect."""
    node = params.flat.get("front_steering")
    by_front = node is None or node.text.lower() != "false"
    known = cls.__dataclass_fields__
    found = {}
    for end, part in (
        ("front", "steering" if by_front else "traction"),
        ("rear", "traction" if by_front else "steering"),
    ):
        for old, new in _RENAMED.items():
            found[f"{end}_{old}"] = f"{part}_{new}" if f"{part}_{new}" in known else ""
    return found | {key: name if name in known else "" for key, name in _ALWAYS.items()}


# The parameters of ROS 1's Ackermann steering controller: those of a bicycle, one rear wheel and one front steer.
#
# The law of the file (ros_controllers, noetic): that controller moves two joints under the type name that ROS 2 has for
# four, so its keys tell which one is meant. Its names become those of the bicycle and each is named once; odometry is
# by the wheel's position. What differs is told: a twist's `angular.z` is rad/s here and was the steering angle there,
# so limits of it have no effect. Sizes that are not given are the description's, as there.


_OWN: Final = ("rear_wheel", "front_steer", "wheel_separation_h")
_ANGLE: Final = (
    "angular.z of a twist is how fast it turns, in rad/s; the controller of ROS 1 took it as the angle of front_steer"
)


@dataclass(frozen=True)
class Ros1AckermannParams(BicycleParams):
    """What that controller has beside the bicycle's: two joints by their names, multipliers, limits of `linear.x`."""

    reference_timeout: float = setting(0.5, low=0.0, high=1e9)
    position_feedback: bool = True
    rear_wheel: str = "rear_wheel_joint"
    front_steer: str = "front_steer_joint"
    wheel_separation_h_multiplier: float = 1.0
    wheel_radius_multiplier: float = 1.0
    steer_pos_multiplier: float = 1.0
    linear: SwitchedLimits = setting(SwitchedLimits(), key="linear.x", section=True)  # noqa: RUF009 - it is a field

    @property
    def limits(self) -> tuple[AxisLimits, ...]:
        """The limits of `linear.x`, and none of `angular.z`."""
        return self.linear, AxisLimits()

    def as_bicycle(self) -> Ros1AckermannParams:
        """Return this with the joints and the sizes where the bicycle has them."""
        return replace(
            self,
            traction_joints_names=(self.rear_wheel,),
            steering_joints_names=(self.front_steer,),
            wheelbase=self.wheelbase * self.wheel_separation_h_multiplier,
            traction_wheel_radius=self.traction_wheel_radius * self.wheel_radius_multiplier,
        )

    def mistakes(self) -> Iterator[tuple[bool, str]]:
        """Say what is wrong, a multiplier of the measured angle too."""
        yield from super().mistakes()
        scale = "it scales what is measured alone; put the factor into scale_pos_from_dev and scale_pos_to_dev"
        yield self.steer_pos_multiplier != 1.0, f"steer_pos_multiplier is {self.steer_pos_multiplier:g}; {scale}"


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
    """Whether the parameters are those of ROS 1's controller."""
    return any(params.flat.get(key) is not None for key in _OWN)


def read_ros1(
    params: Params, geometry: Geometry | None = None, tell: Callable[[str], object] = lambda _: None
) -> Ros1AckermannParams:
    """Return the parameters as a bicycle has them, not yet checked for what cannot be together.

    Sizes that are not given are those of the description's `geometry`; `tell` is told of each.
    """
    key = (
        params.flat.keys().get("front_steer")
        or params.flat.keys()[next(each for each in _OWN if params.flat.get(each))]
    )
    key.warning(_ANGLE)
    given = _completed(params.read(Ros1AckermannParams, _RENAMES), geometry, tell).as_bicycle()
    params.taken = given
    return given


def _completed(
    given: Ros1AckermannParams, geometry: Geometry | None, tell: Callable[[str], object]
) -> Ros1AckermannParams:
    if geometry is None:
        return given
    wheel, steer = (given.rear_wheel,), (given.front_steer,)
    if given.wheelbase <= 0.0 and (base := geometry.separation(wheel, steer)):
        tell(f"wheel_separation_h is not given, the description's is taken: {base:g} m")
        given = replace(given, wheelbase=base)
    if given.traction_wheel_radius <= 0.0 and (radius := geometry.radius(wheel)):
        tell(f"wheel_radius is not given, the description's is taken: {radius:g} m")
        given = replace(given, traction_wheel_radius=radius)
    return given


@mypyc_attr(allow_interpreted_subclasses=True)
class SteeringController(MobileBase):
    """Drives a base by its traction and its steered wheels; `kinematics` is where it is."""

    topic: ClassVar[str | None] = "reference"
    tells: ClassVar[type[Sample] | None] = SteeringSample
    timeout_key: ClassVar[str] = "reference_timeout"
    settable: ClassVar[tuple[str, ...]] = ("reference_timeout", "enable_odom_tf")
    kind: ClassVar[type[SteeringParams]] = SteeringParams

    def __init__(self, name: str, type_name: str = "") -> None:
        self.kinematics = SteeringKinematics(1.0, 1.0)
        super().__init__(name, type_name, self.kinematics)
        self.params = SteeringParams()
        self._traction: list[float] = []
        self._steering: list[float] = []
        self._reading: list[float] = []
        self._driven: list[float] = []

    def wheel_base(self) -> WheelBase:
        """Return what its parameters say of the wheels; the right one stands first."""
        given, (odom, base) = self.params, self.frame_ids()
        right, left = given.traction_joints_names[:1], given.traction_joints_names[1:]
        keys = (given.radius_key, "traction_track_width")
        separation = given.tracks[0]
        return WheelBase(left, right, separation, given.radius, odom, base, given.enable_odom_tf, (), *keys)

    def on_configure(self, params: Params) -> None:
        """Read the parameters; the pose becomes 0."""
        self.params = given = self.read(params)
        self.kinematics = given.made()
        self.pose = self.kinematics
        self.joints = (*given.traction_joints_names, *given.steering_joints_names)
        count = len(self.joints)
        self._traction, self._steering = [0.0] * self.kinematics.traction_count, [0.0] * self.kinematics.steering_count
        self._reading, self._driven = [0.0] * count, [0.0] * count
        self.set_up(given, given.reference_timeout, count, given.limits, open_loop=given.open_loop)

    def read(self, params: Params) -> SteeringParams:
        """Return checked parameters; RobotConfigError with every mistake."""
        return read_params(params, self.kind)

    def on_set(self, params: Params) -> None:
        """Take another timeout, from the next update on."""
        given = self.read(params)
        self.take(given, given.reference_timeout, given.limits)
        self.params = given

    def command_interface_names(self) -> list[str]:
        """Return the velocities of traction, then the positions of steering."""
        given = self.params
        traction = [f"{joint}/{VELOCITY}" for joint in given.traction_joints_names]
        return traction + [f"{joint}/{POSITION}" for joint in given.steering_joints_names]

    def state_interface_names(self) -> list[str]:
        """Return position or velocity of traction, then the positions of steering."""
        given = self.params
        feedback = POSITION if given.position_feedback else VELOCITY
        traction = [f"{joint}/{feedback}" for joint in given.traction_states]
        return traction + [f"{joint}/{POSITION}" for joint in given.steering_states]

    def velocities(self) -> tuple[float, float, float]:
        """Return the means of its odometry."""
        return self.kinematics.linear, 0.0, self.kinematics.angular

    def work_out(self, twist: Sequence[float]) -> None:
        """Share a twist out to traction and steering."""
        wheels, given = self.kinematics, self.params
        wheels.command(twist[0], twist[1], given.open_loop, given.reduce_wheel_speed_until_steering_reached)
        wheels.bound(twist[0], twist[1])
        count = wheels.traction_count
        for index in range(count):
            self.targets[index] = wheels.traction[index]
        for index in range(wheels.steering_count):
            self.targets[count + index] = wheels.steering[index]

    def begin(self) -> None:
        """Take the wheels as they stand."""
        self._read()
        self.kinematics.begin(self._traction)
        self.kinematics.angle = self.kinematics.measured_angle(self._steering)

    def advance(self, dt: float) -> None:
        """Follow the wheels."""
        self._read()
        if self.params.position_feedback:
            self.kinematics.update_position(self._traction, self._steering, dt)
        else:
            self.kinematics.update_velocity(self._traction, self._steering, dt)

    def believe(self, dt: float) -> None:
        """Follow the twist."""
        self.kinematics.update_open_loop(self.limited[0], self.limited[1], dt)

    def _read(self) -> None:
        count = self.kinematics.traction_count
        for index in range(len(self._traction)):
            self._traction[index] = self.states[index].value
        for index in range(len(self._steering)):
            self._steering[index] = self.states[count + index].value

    def take_down(self) -> None:
        """Put down feedback and commands too."""
        super().take_down()
        for index in range(len(self._reading)):
            self._reading[index] = self.states[index].value
            self._driven[index] = self.commands[index].value

    def sample(self, wall_offset_ns: int) -> OdometrySample | None:
        """Return odometry, feedback and commands as they were published last."""
        odometry = self.odometry_sample(wall_offset_ns)
        if odometry is None:
            return None
        count = self.kinematics.traction_count
        reading, driven = [finite(each) for each in self._reading], [finite(each) for each in self._driven]
        measured = "traction_positions" if self.params.position_feedback else "traction_velocities"
        return grown(
            SteeringSample,
            odometry,
            steering=reading[count:],
            traction_commands=driven[:count],
            steering_commands=driven[count:],
            **{measured: reading[:count]},
        )


class BicycleSteeringController(SteeringController):
    """One traction wheel and one steered wheel."""

    kind: ClassVar[type[SteeringParams]] = BicycleParams

    def __init__(self, name: str, type_name: str = "bicycle_steering_controller/BicycleSteeringController") -> None:
        super().__init__(name, type_name)


class TricycleSteeringController(SteeringController):
    """Two traction wheels and one steered wheel."""

    kind: ClassVar[type[SteeringParams]] = TricycleParams

    def __init__(self, name: str, type_name: str = "tricycle_steering_controller/TricycleSteeringController") -> None:
        super().__init__(name, type_name)


class AckermannSteeringController(SteeringController):
    """Two traction wheels and two steered wheels; one of each with the keys of ROS 1, see `ackermann_ros1`."""

    kind: ClassVar[type[SteeringParams]] = AckermannParams

    def read(self, params: Params) -> SteeringParams:
        """Return checked parameters of ROS 2's controller, or of ROS 1's."""
        if not is_ros1(params):
            return super().read(params)
        given = read_ros1(params, self.geometry, self._tell_size)
        refuse(self.name, given.mistakes())
        return given

    def _tell_size(self, text: str) -> None:
        """Say which size is the description's, when it is configured and not at each parameter that is set."""
        if self.state is ControllerState.UNCONFIGURED:
            self.tell("parameter", text)

    def __init__(self, name: str, type_name: str = "ackermann_steering_controller/AckermannSteeringController") -> None:
        super().__init__(name, type_name)
