"""The diff drive controller: a twist becomes wheel speeds, the wheels' motion becomes odometry.

The law of the file (ros2_controllers jazzy): (v -+ w * separation / 2) / radius is written to every wheel of a side.
Before the first command nothing is written; once the timeout has passed since the activation, zeros are. A
`cmd_vel_timeout` of 0 is never. A feedback that is nan is an ERROR. Ours, and safer: see `mobile_base`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Final

from canopen_control.controllers.base import ControllerState, WheelBase
from canopen_control.controllers.base_params import AxisLimits, PrefixedParams, refuse
from canopen_control.controllers.mobile_base import MobileBase
from canopen_control.controllers.planar_pose import MIN_DT, PlanarPose, RollingMean
from canopen_control.errors import RobotConfigError
from canopen_control.urdf.joint_element import VELOCITY
from canopen_control.yamlfile.convert import setting

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.controllers.base import Geometry
    from canopen_control.controllers.limiter import Limits
    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.rpc.messages.samples import OdometrySample


# The parameters of the diff drive controller, in the words of every ROS distribution.
#
# The law of the file: jazzy's names are ours; noetic's and humble's are translated and each is named once. Limits that
# are given are applied unless `has_*_limits` is false, as jazzy does and noetic and humble did not: a limit somebody
# wrote down is kept. `min_acceleration`, which jazzy declares and never reads, is `max_acceleration_reverse`, its exact
# equivalent.


NAN: Final = math.nan


@dataclass(frozen=True)
class SwitchedLimits(AxisLimits):
    """The limits of `linear.x` or `angular.z`; nan is none, and so is a group whose `has_` is false."""

    has_velocity_limits: bool = True
    has_acceleration_limits: bool = True
    has_jerk_limits: bool = True

    @property
    def freezes(self) -> bool:
        """Whether the limit of jerk counts and keeps the axis from ever changing its speed."""
        return self.has_jerk_limits and super().freezes

    def limits(self) -> Limits:
        """Return what the limiter is given."""
        found = super().limits()
        if not self.has_velocity_limits:
            found = replace(found, min_velocity=NAN, max_velocity=NAN)
        if not self.has_acceleration_limits:
            found = replace(
                found,
                max_acceleration_reverse=NAN,
                max_acceleration=NAN,
                max_deceleration=NAN,
                max_deceleration_reverse=NAN,
            )
        return found if self.has_jerk_limits else replace(found, min_jerk=NAN, max_jerk=NAN)


@dataclass(frozen=True)
class DiffDriveParams(PrefixedParams):
    """Parameters of diff_drive_controller/DiffDriveController: m, s, Hz, rad."""

    left_wheel_names: tuple[str, ...] | str = ()
    right_wheel_names: tuple[str, ...] | str = ()
    wheel_separation: float = setting(0.0, low=0.0)
    wheel_radius: float = setting(0.0, low=0.0)
    wheel_separation_multiplier: float = 1.0
    left_wheel_radius_multiplier: float = 1.0
    right_wheel_radius_multiplier: float = 1.0
    wheel_radius_multiplier: float = NAN
    open_loop: bool = False
    position_feedback: bool = True
    cmd_vel_timeout: float = setting(0.5, low=0.0, high=1e9)
    publish_limited_velocity: bool = False
    velocity_rolling_window_size: int = setting(10, low=1, high=100_000)
    publish_rate: float = setting(50.0, low=1e-3)
    linear: SwitchedLimits = setting(SwitchedLimits(), key="linear.x", section=True)  # noqa: RUF009 - it is a field
    angular: SwitchedLimits = setting(SwitchedLimits(), key="angular.z", section=True)  # noqa: RUF009 - it is a field

    @property
    def left(self) -> tuple[str, ...]:
        """The wheels of the left side."""
        return (self.left_wheel_names,) if isinstance(self.left_wheel_names, str) else self.left_wheel_names

    @property
    def right(self) -> tuple[str, ...]:
        """The wheels of the right side."""
        return (self.right_wheel_names,) if isinstance(self.right_wheel_names, str) else self.right_wheel_names

    @property
    def separation(self) -> float:
        """The distance of the wheels that counts, in m."""
        return self.wheel_separation * self.wheel_separation_multiplier

    @property
    def left_radius(self) -> float:
        """The radius of the left wheels that counts, in m."""
        return self.wheel_radius * self.left_wheel_radius_multiplier

    @property
    def right_radius(self) -> float:
        """The radius of the right wheels that counts, in m."""
        return self.wheel_radius * self.right_wheel_radius_multiplier

    @property
    def frozen(self) -> tuple[str, ...]:
        """The axes that a jerk limit of 0 keeps from ever changing their speed."""
        axes = {"linear.x": self.linear, "angular.z": self.angular}
        return tuple(name for name, each in axes.items() if each.freezes)


RENAMES: Final = {
    "left_wheel": "left_wheel_names",
    "right_wheel": "right_wheel_names",
    "publish_cmd": "publish_limited_velocity",
    "linear.x.min_acceleration": "linear.x.max_acceleration_reverse",
    "angular.z.min_acceleration": "angular.z.max_acceleration_reverse",
    "use_stamped_vel": "",  # Twist and TwistStamped are both taken
    "wheels_per_side": "",  # upstream overwrites it with the length of the lists
    "estimate_velocity_from_position": "position_feedback",
    "allow_multiple_cmd_vel_publishers": "",
    "publish_wheel_joint_controller_state": "",
}
"""Keys of noetic and humble to jazzy's; "" for what has no effect."""


def _silent(_text: str) -> None:
    """Tell nobody."""


def read_params(
    params: Params, geometry: Geometry | None = None, tell: Callable[[str], None] = _silent
) -> DiffDriveParams:
    """Return checked parameters; RobotConfigError with every mistake. What is legal and odd is a warning.

    Wheel sizes that are not given are those of the description's `geometry` (as noetic does); `tell` is told of each.
    """
    given = _completed(params.read(DiffDriveParams, RENAMES), geometry, tell)
    if not math.isnan(given.wheel_radius_multiplier):  # noetic: it overrides the sides' own
        both = given.wheel_radius_multiplier
        given = replace(given, left_wheel_radius_multiplier=both, right_wheel_radius_multiplier=both)
    refuse(params.name, _checks(given))
    params.taken = given
    return given


def _completed(given: DiffDriveParams, geometry: Geometry | None, tell: Callable[[str], None]) -> DiffDriveParams:
    if geometry is None:
        return given
    if given.wheel_separation <= 0.0 and (separation := geometry.separation(given.left, given.right)):
        tell(f"wheel_separation is not given, the description's is taken: {separation:g} m")
        given = replace(given, wheel_separation=separation)
    if given.wheel_radius <= 0.0 and (radius := geometry.radius((*given.left, *given.right))):
        tell(f"wheel_radius is not given, the description's is taken: {radius:g} m")
        given = replace(given, wheel_radius=radius)
    return given


def _checks(given: DiffDriveParams) -> list[tuple[bool, str]]:
    left, right = given.left, given.right
    both = sorted({*left} & {*right})
    positive = (given.separation > 0.0, given.left_radius > 0.0, given.right_radius > 0.0)
    return [
        (not left, "no left_wheel_names; give the joints of the left wheels"),
        (not right, "no right_wheel_names; give the joints of the right wheels"),
        (
            bool(left and right) and len(left) != len(right),
            f"{len(left)} left wheels and {len(right)} right ones; give as many of each",
        ),
        (bool(both), f"{', '.join(both)} is a wheel of both sides"),
        (given.wheel_separation <= 0.0, "wheel_separation is missing or 0; give the distance of the wheels in m"),
        (given.wheel_radius <= 0.0, "wheel_radius is missing or 0; give it in m"),
        (
            given.wheel_separation > 0.0 and given.wheel_radius > 0.0 and not all(positive),
            "a multiplier of wheel_separation or wheel_radius is not above 0",
        ),
    ]


# Where a differential drive robot is, from what its wheels did.
#
# The law of the file (ros2_controllers jazzy): a step is the exact arc of the two wheels' ways (`planar_pose`), and one
# shorter than `MIN_DT` is put off to the next; `linear` and `angular` are means over the last steps. Ours: the first
# sample after `stop` is the baseline, so that neither the wheels' angle at start nor the time before it moves the robot
# (upstream jumps by both).


NS: Final = 1_000_000_000


class Odometry(PlanarPose):
    """The pose `x`, `y` (m), `heading` (rad), and `linear` (m/s), `angular` (rad/s).

    `separation` and the radii, in m, are those after their multipliers; `window` is how many steps are averaged.
    """

    def __init__(self, separation: float, left_radius: float, right_radius: float, window: int = 10) -> None:
        super().__init__()
        self._separation, self._left_radius, self._right_radius = separation, left_radius, right_radius
        self._linear, self._angular = RollingMean(window), RollingMean(window)
        self.started = False
        self._time = 0
        self._left = self._right = 0.0

    @property
    def linear(self) -> float:
        """The velocity along the robot, in m/s."""
        return self._linear.mean

    @property
    def angular(self) -> float:
        """The velocity of its heading, in rad/s."""
        return self._angular.mean

    def resize(self, separation: float, left_radius: float, right_radius: float) -> None:
        """Count with other wheels from now on, all in m; the pose stays."""
        self._left *= left_radius / self._left_radius
        self._right *= right_radius / self._right_radius
        self._separation, self._left_radius, self._right_radius = separation, left_radius, right_radius

    def begin(self, left: float, right: float, now: int) -> None:
        """Take the wheels' angles (rad) at `now` (ns) as the baseline; the pose stays."""
        self._left, self._right, self._time = left * self._left_radius, right * self._right_radius, now
        self.started = True

    def stop(self) -> None:
        """Count nothing that happens until the next sample, which becomes the baseline."""
        self.started = False

    def set_pose(self, x: float, y: float, heading: float) -> None:
        """Be somewhere else, in m and rad; the averages start anew."""
        super().set_pose(x, y, heading)
        self._linear.clear()
        self._angular.clear()

    def update_position(self, left: float, right: float, now: int) -> bool:
        """Follow the wheels' angles in rad; return whether the step counted."""
        if not self.started:
            self.begin(left, right, now)
            return False
        dt = (now - self._time) / NS
        if dt < MIN_DT:
            return False
        way_left, way_right = left * self._left_radius, right * self._right_radius
        step_left, step_right = way_left - self._left, way_right - self._right
        self._left, self._right = way_left, way_right
        return self._step(step_left, step_right, dt, now)

    def update_velocity(self, left: float, right: float, now: int) -> bool:
        """Follow the wheels' velocities in rad/s; return whether the step counted."""
        if not self.started:
            self.begin(0.0, 0.0, now)
            return False
        dt = (now - self._time) / NS
        if dt < MIN_DT:
            return False
        return self._step(left * self._left_radius * dt, right * self._right_radius * dt, dt, now)

    def update_open_loop(self, linear: float, angular: float, now: int) -> bool:
        """Believe the command, in m/s and rad/s; return whether the step counted."""
        if not self.started:
            self.begin(0.0, 0.0, now)
            return False
        dt = (now - self._time) / NS
        self._time = now
        for window, value in ((self._linear, linear), (self._angular, angular)):
            window.clear()
            window.add(value)
        self.drive(linear * dt, angular * dt)
        return True

    def _step(self, left: float, right: float, dt: float, now: int) -> bool:
        linear, angular = (left + right) * 0.5, (right - left) / self._separation
        self.drive(linear, angular)
        self._time = now
        self._linear.add(linear / dt)
        self._angular.add(angular / dt)
        return True


def wheel_velocities(
    linear: float, angular: float, separation: float, left_radius: float, right_radius: float
) -> tuple[float, float]:
    """Return the wheels' speeds in rad/s for a twist in m/s and rad/s; lengths in m."""
    turn = angular * separation / 2.0
    return (linear - turn) / left_radius, (linear + turn) / right_radius


class DiffDriveController(MobileBase):
    """Drives a robot with wheels on two sides by twists.

    `odometry` is where it is, published at `publish_rate`; `twist_out` is the twist after the limits, for
    `~/cmd_vel_out`.
    """

    zero_is_never: ClassVar[bool] = True
    waits_for_a_twist: ClassVar[bool] = True
    settable: ClassVar[tuple[str, ...]] = (
        "cmd_vel_timeout", "enable_odom_tf", "publish_limited_velocity", "linear.x.*", "angular.z.*",
        "wheel_separation_multiplier", "left_wheel_radius_multiplier", "right_wheel_radius_multiplier",
    )  # fmt: skip

    def __init__(self, name: str, type_name: str = "diff_drive_controller/DiffDriveController") -> None:
        self.odometry = Odometry(1.0, 1.0, 1.0)
        super().__init__(name, type_name, self.odometry)
        self.params = DiffDriveParams()
        self._wheels = (1.0, 1.0, 1.0)  # separation, left and right radius, in m
        self._side = 0
        self._left_states: list[StateInterface] = []
        self._right_states: list[StateInterface] = []

    def wheel_base(self) -> WheelBase:
        """Return what its parameters say of the wheels, before the multipliers, which are calibration."""
        given, (odom, base) = self.params, self.frame_ids()
        sizes = (given.wheel_separation, given.wheel_radius)
        return WheelBase(given.left, given.right, *sizes, odom, base, given.enable_odom_tf, given.frozen)

    def sample(self, wall_offset_ns: int) -> OdometrySample | None:
        """Return the odometry as it was published last."""
        return self.odometry_sample(wall_offset_ns, self.params.publish_limited_velocity)

    def on_configure(self, params: Params) -> None:
        """Read the parameters; the pose becomes 0."""
        given = read_params(params, self.geometry, lambda text: self.tell("parameter", text))
        self.params = given
        self._wheels = (given.separation, given.left_radius, given.right_radius)
        self.odometry = Odometry(*self._wheels, given.velocity_rolling_window_size)
        self.pose = self.odometry
        self.joints, self.interface = (*given.left, *given.right), VELOCITY
        self._side = len(given.left)
        limits = (given.linear, given.angular)
        self.set_up(given, given.cmd_vel_timeout, len(self.joints), limits, given.publish_rate, given.open_loop)

    def on_set(self, params: Params) -> None:
        """Take other limits, another timeout, what to publish, from the next update on; at rest other wheels."""
        given = read_params(params, self.geometry)
        wheels = (given.separation, given.left_radius, given.right_radius)
        if wheels != self._wheels and self.state is ControllerState.ACTIVE and any(self.limited):
            raise RobotConfigError(f"{self.name} moves; the multipliers of its wheels are set while it stands")
        self.take(given, given.cmd_vel_timeout, (given.linear, given.angular))
        self.params, self._wheels = given, wheels
        self.odometry.resize(*wheels)

    def command_interface_names(self) -> list[str]:
        """Return the velocity of every wheel, the left ones first."""
        return [f"{wheel}/{VELOCITY}" for wheel in self.joints]

    def state_interface_names(self) -> list[str]:
        """Return position or velocity of every wheel; nothing if the loop is open."""
        return self.wheel_states(self.params.position_feedback)

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        """Start with no command; the pose is kept, the next sample is where it goes on from."""
        super().on_activate(commands, states, now)
        self._left_states, self._right_states = states[: self._side], states[self._side :]

    @property
    def begun(self) -> bool:
        """Whether odometry has its baseline."""
        return self.odometry.started

    def stop_following(self) -> None:
        """Count nothing that happens until the next sample."""
        self.odometry.stop()

    def velocities(self) -> tuple[float, float, float]:
        """Return the means of its odometry."""
        return self.odometry.linear, 0.0, self.odometry.angular

    def work_out(self, twist: Sequence[float]) -> None:
        """Share a twist out to both sides."""
        separation, left_radius, right_radius = self._wheels
        left, right = wheel_velocities(twist[0], twist[1], separation, left_radius, right_radius)
        for index in range(self._side):
            self.targets[index], self.targets[self._side + index] = left, right

    def follow(self, now: int) -> bool:
        """Move the odometry; return False if a wheel's feedback is not known."""
        if self.params.open_loop:
            self.odometry.update_open_loop(self.limited[0], self.limited[1], now)
            return True
        left, right = _mean(self._left_states), _mean(self._right_states)
        if not (math.isfinite(left) and math.isfinite(right)):
            return False
        if self.params.position_feedback:
            self.odometry.update_position(left, right, now)
        else:
            self.odometry.update_velocity(left, right, now)
        return True


def _mean(states: Sequence[StateInterface]) -> float:
    total = 0.0
    for each in states:
        total += each.value
    return total / len(states)
