"""The diff drive controller: a twist becomes wheel speeds, the wheels' motion becomes odometry.

The law of the file (ros2_controllers jazzy): each update takes the newest twist, or zero when it is older than
`cmd_vel_timeout` (0: never), limits it against the last two limited ones (so a timeout brakes along the ramp), follows
the wheels, and writes (v -+ w * separation / 2) / radius to every wheel of a side. Before the first command nothing is
written; once the timeout has passed since the activation, zeros are. A feedback that is nan is an ERROR. When another
controller claims the references `NAME/linear/velocity` and `NAME/angular/velocity`, they are the twist (chaining).
Ours, and safer: a twist that is not finite is refused and does not refresh the timeout; odometry starts at the first
sample; feedback that is lost with a drive, which is off then, is waited for at standstill, so that enabling the drives
is enough to go on.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar, Final

from canopen_control.controllers.base import Controller, ControllerState, WheelBase, zero_targets
from canopen_control.controllers.command_life import ENDLESS, endless
from canopen_control.controllers.diff_drive_params import DiffDriveParams, read_params, tf_prefix
from canopen_control.controllers.limiter import Limits, RateLimiter
from canopen_control.controllers.odometry import Odometry
from canopen_control.errors import ControlError, RobotConfigError
from canopen_control.hardware.interfaces import ERROR, OK, POSITION, VELOCITY, CommandInterface, ReturnType
from canopen_control.rpc.messages.samples import OdometrySample

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import StateInterface
    from canopen_control.rpc.messages.samples import Sample

__all__ = ["DiffDriveController", "wheel_velocities"]

NS: Final = 1_000_000_000
_AT_ONCE: Final = -1  # before any cycle
_TWIST: Final = ("linear.x", "angular.z")


def wheel_velocities(
    linear: float, angular: float, separation: float, left_radius: float, right_radius: float
) -> tuple[float, float]:
    """Return the wheels' speeds in rad/s for a twist in m/s and rad/s; lengths in m."""
    turn = angular * separation / 2.0
    return (linear - turn) / left_radius, (linear + turn) / right_radius


class _Publication:
    """What is published at one time: pose, velocity, and the twist after the limits."""

    def __init__(self) -> None:
        self.x = self.y = self.heading = 0.0
        self.linear = self.angular = 0.0
        self.limited_linear = self.limited_angular = 0.0

    def take(self, odometry: Odometry, limited_linear: float, limited_angular: float) -> None:
        """Put down what is so now."""
        self.x, self.y, self.heading = odometry.x, odometry.y, odometry.heading
        self.linear, self.angular = odometry.linear, odometry.angular
        self.limited_linear, self.limited_angular = limited_linear, limited_angular


class DiffDriveController(Controller):
    """Drives a robot with wheels on two sides by twists.

    `odometry` is where it is. `publications` counts the times its odometry was due at `publish_rate`, last at `stamp`
    (ns); `limited` is the twist after the limits, for `~/cmd_vel_out`.
    """

    topic: ClassVar[str | None] = "cmd_vel"
    is_base: ClassVar[bool] = True
    tells: ClassVar[type[Sample] | None] = OdometrySample
    settable: ClassVar[tuple[str, ...]] = (
        "cmd_vel_timeout", "enable_odom_tf", "publish_limited_velocity", "linear.x.*", "angular.z.*",
    )  # fmt: skip

    def __init__(self, name: str, type_name: str = "diff_drive_controller/DiffDriveController") -> None:
        super().__init__(name, type_name)
        self.params = DiffDriveParams()
        self.odometry = Odometry(1.0, 1.0, 1.0)
        self.limited_linear = self.limited_angular = 0.0
        self.publications = 0
        self._told = _Publication()
        self._references = (CommandInterface(f"{name}/linear", VELOCITY), CommandInterface(f"{name}/angular", VELOCITY))
        self._linear_limiter = self._angular_limiter = RateLimiter(Limits())
        self._publish_ns = 0
        self._publish_at = _AT_ONCE
        self._wheels = (1.0, 1.0, 1.0)  # separation, left and right radius, in m
        self._left_commands: list[CommandInterface] = []
        self._right_commands: list[CommandInterface] = []
        self._left_states: list[StateInterface] = []
        self._right_states: list[StateInterface] = []
        self._forget(0)

    @property
    def limited(self) -> tuple[float, float]:
        """The last limited twist, in m/s and rad/s."""
        return self.limited_linear, self.limited_angular

    @property
    def chained(self) -> bool:
        """Whether another controller commands it."""
        return self._references[0].owner is not None or self._references[1].owner is not None

    def frame_ids(self, namespace: str = "") -> tuple[str, str]:
        """Return the names of the odometry and the base frame, with their prefix."""
        prefix = tf_prefix(self.params.tf_frame_prefix, namespace, enable=self.params.tf_frame_prefix_enable)
        return prefix + self.params.odom_frame_id, prefix + self.params.base_frame_id

    def wheel_base(self) -> WheelBase:
        """Return what its parameters say of the wheels, before the multipliers, which are calibration."""
        given, (odom, base) = self.params, self.frame_ids()
        sizes = (given.wheel_separation, given.wheel_radius)
        return WheelBase(given.left, given.right, *sizes, odom, base, given.enable_odom_tf, given.frozen)

    def set_odometry(self, x: float, y: float, heading: float) -> None:
        """Be somewhere else, in m and rad, from the next update on; ControlError if it is not active."""
        if self.state is not ControllerState.ACTIVE:
            raise ControlError(f"{self.name} is {self.state.value}; its odometry is set while it is active")
        if not all(map(math.isfinite, (x, y, heading))):
            raise ControlError(f"{self.name}: a pose is three finite numbers, got {x}, {y}, {heading}")
        self.odometry.set_pose(x, y, heading)

    def sample(self, wall_offset_ns: int) -> OdometrySample | None:
        """Return the odometry as it was published last."""
        if not self.publications:
            return None
        told, params = self._told, self.params
        frame, child = self.frame_ids()
        return OdometrySample(
            time=self.published(wall_offset_ns),
            x=told.x,
            y=told.y,
            heading=told.heading,
            linear=told.linear,
            angular=told.angular,
            frame_id=frame,
            child_frame_id=child,
            pose_covariance=list(params.pose_covariance_diagonal),
            twist_covariance=list(params.twist_covariance_diagonal),
            enable_odom_tf=params.enable_odom_tf,
            limited=(told.limited_linear, told.limited_angular) if params.publish_limited_velocity else None,
        )

    # ----------------------------------------------------------------------------------------------------- lifecycle

    def on_configure(self, params: Params) -> None:
        """Read the parameters; the pose becomes 0."""
        given = read_params(params, self.geometry, lambda text: self.tell("parameter", text))
        self.params = given
        self._linear_limiter = _limiter(self.name, "linear.x", given.linear.limits())
        self._angular_limiter = _limiter(self.name, "angular.z", given.angular.limits())
        for axis in given.frozen:
            self.tell("parameter", f"{axis}.max_jerk: 0 keeps it from ever changing speed; remove it")
        self._wheels = (given.separation, given.left_radius, given.right_radius)
        self.odometry = Odometry(*self._wheels, given.velocity_rolling_window_size)
        self.life.limit_ns, self._publish_ns = round(given.cmd_vel_timeout * NS), round(NS / given.publish_rate)
        if (text := endless("cmd_vel_timeout", given.cmd_vel_timeout, (VELOCITY,))) is not None:
            self.tell(ENDLESS, text)
        self.update_rate, self.publish_rate = given.update_rate, given.publish_rate
        self.joints, self.interface = (*given.left, *given.right), VELOCITY
        self._publish_at = _AT_ONCE

    def on_set(self, params: Params) -> None:
        """Take other limits, another timeout, other things to publish, from the next update on."""
        given = read_params(params, self.geometry)
        linear = _limiter(self.name, "linear.x", given.linear.limits())
        angular = _limiter(self.name, "angular.z", given.angular.limits())
        self.params, self._linear_limiter, self._angular_limiter = given, linear, angular
        self.life.limit_ns = round(given.cmd_vel_timeout * NS)

    def command_interface_names(self) -> list[str]:
        """Return the velocity of every wheel, the left ones first."""
        return [f"{wheel}/{VELOCITY}" for wheel in self.joints]

    def state_interface_names(self) -> list[str]:
        """Return position or velocity of every wheel; nothing if the loop is open."""
        if self.params.open_loop:
            return []
        feedback = POSITION if self.params.position_feedback else VELOCITY
        return [f"{wheel}/{feedback}" for wheel in self.joints]

    def reference_interfaces(self) -> Sequence[CommandInterface]:
        """Return the twist that another controller may command."""
        return self._references

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        """Start with no command; the pose is kept, the next sample is where it goes on from."""
        super().on_activate(commands, states, now)
        side = len(self.params.left)
        self._left_commands, self._right_commands = commands[:side], commands[side:]
        self._left_states, self._right_states = states[:side], states[side:]
        self.odometry.stop()
        self._forget(now)

    def on_deactivate(self, now: int) -> None:
        """Stop the wheels at once, without a ramp: the drive's own deceleration takes over."""
        super().on_deactivate(now)
        self._forget(now)

    def forget(self, now: int) -> None:
        """Have the wheels stop at once, and go on following them; the next twist begins at standstill."""
        zero_targets(self.commands)
        self._forget(now)
        self._linear = self._angular = 0.0
        self._writing = True

    def _forget(self, now: int) -> None:
        """Have no command, and none before it."""
        self._linear = self._angular = math.nan
        self.life.end()
        self.life.given = now
        self._was_chained = self._writing = self._too_fast = False
        self._previous_linear = self._before_linear = 0.0
        self._previous_angular = self._before_angular = 0.0
        for reference in self._references:
            reference.value = math.nan

    # ------------------------------------------------------------------------------------------------------- command

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        """Take a twist (m/s, rad/s); one as old as the timeout, by its `stamp` (ns; 0 or None: now), is refused.

        A stamp from the future, of a clock that is ahead, is now: it must not put the timeout off.
        """
        self.checked(values, _TWIST)
        if self.chained:
            raise self.refusal(f"is commanded by {self._references[0].owner}; deactivate that controller first")
        made, limit = min(stamp or now, now), self.life.limit_ns
        if limit and now - made >= limit:
            age, timeout = (now - made) / NS, limit / NS
            raise self.refusal(
                f"got a twist that is {age:.3f} s old, cmd_vel_timeout is {timeout:g} s; check the clocks"
            )
        for wheels, speed in zip(self._sides(), self._speeds(values[0], values[1]), strict=True):
            self.refuse_misfit(wheels, speed, now)
        self._linear, self._angular = float(values[0]), float(values[1])
        self.life.give(made)

    # --------------------------------------------------------------------------------------------------------- cycle

    def update(self, now: int, period: float) -> ReturnType:
        """Do one step; `period` in s is what the limits are scaled with."""
        if not self.odometry.started:
            self._follow(0.0, 0.0, now)
        self._take_reference(now)
        if math.isnan(self._linear) or math.isnan(self._angular):
            return OK
        linear = self._linear_limiter.limit(self._linear, self._previous_linear, self._before_linear, period)
        angular = self._angular_limiter.limit(self._angular, self._previous_angular, self._before_angular, period)
        if not self._follow(linear, angular, now):
            return self._without_feedback()
        self._before_linear, self._previous_linear = self._previous_linear, linear
        self._before_angular, self._previous_angular = self._previous_angular, angular
        self.limited_linear, self.limited_angular = linear, angular
        if now > self._publish_at:
            self._publish(now)
        self._write(linear, angular)
        return OK

    def _take_reference(self, now: int) -> None:
        """Find the twist wanted now: the chain's, or the last command, or zero if that is too old."""
        (linear, angular), life = self._references, self.life
        if linear.owner is not None or angular.owner is not None:
            self._linear, self._angular = linear.value, angular.value
            if self._writing and (math.isnan(self._linear) or math.isnan(self._angular)):
                self._linear = self._angular = 0.0  # who was driven by a topic does not go on by itself
            self._was_chained = True
            life.end()
        elif self._was_chained and not life.live:
            self._was_chained = False
            self._linear = self._angular = 0.0
        elif life.limit_ns and now - life.given > life.limit_ns:
            if life.runs_out(now):
                age = (now - life.given) / NS
                self.tell("command_timeout", f"no twist for {age:.2f} s, it brakes until the next one")
            self._linear = self._angular = 0.0

    def _follow(self, linear: float, angular: float, now: int) -> bool:
        """Move the odometry; return False if a wheel's feedback is not known."""
        if self.params.open_loop:
            self.odometry.update_open_loop(linear, angular, now)
            return True
        left, right = _mean(self._left_states), _mean(self._right_states)
        if not (math.isfinite(left) and math.isfinite(right)):
            return False
        if self.params.position_feedback:
            self.odometry.update_position(left, right, now)
        else:
            self.odometry.update_velocity(left, right, now)
        return True

    def _without_feedback(self) -> ReturnType:
        """Stand, and wait for the next sample, while a drive is off; drives that run with no feedback are an ERROR."""
        if all(each.enabled for each in self.commands):
            unknown = [each.name for each in (*self._left_states, *self._right_states) if not math.isfinite(each.value)]
            self.tell("feedback", f"{', '.join(unknown)} is not a number")
            return ERROR
        zero_targets(self.commands)
        self.odometry.stop()
        return OK

    def _publish(self, now: int) -> None:
        """Count a publication; the next is due at the next step of the period on a fixed grid, without a burst."""
        due, period = self._publish_at, self._publish_ns
        self._publish_at = (now if due == _AT_ONCE else max(due, now - period)) + period
        self.stamp = now
        self.publications += 1
        self._told.take(self.odometry, self.limited_linear, self.limited_angular)

    def _write(self, linear: float, angular: float) -> None:
        self._writing = True
        left, right = self._speeds(linear, angular)
        for wheel in self._left_commands:
            wheel.value = left
            if not wheel.lowest <= left <= wheel.highest:
                self._stand(left)
                return
        for wheel in self._right_commands:
            wheel.value = right
            if not wheel.lowest <= right <= wheel.highest:
                self._stand(right)
                return
        self._too_fast = False

    def _speeds(self, linear: float, angular: float) -> tuple[float, float]:
        separation, left_radius, right_radius = self._wheels
        return wheel_velocities(linear, angular, separation, left_radius, right_radius)

    def _sides(self) -> tuple[list[CommandInterface], list[CommandInterface]]:
        return self._left_commands, self._right_commands

    def _stand(self, speed: float) -> None:
        """Stop all wheels together where the speed of one does not fit its drive."""
        zero_targets(self.commands)
        if not self._too_fast:
            self._too_fast = True
            self.rejected += 1
            self.tell(
                "refused", f"a wheel would have to turn at {speed:g} rad/s, more than its drive can hold; it stands"
            )


def _mean(states: Sequence[StateInterface]) -> float:
    total = 0.0
    for each in states:
        total += each.value
    return total / len(states)


def _limiter(name: str, axis: str, limits: Limits) -> RateLimiter:
    try:
        return RateLimiter(limits)
    except ValueError as error:
        raise RobotConfigError(f"{name}: {axis}: {error}: a minimum is above its maximum") from error
