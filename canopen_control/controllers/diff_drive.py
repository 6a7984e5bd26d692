"""The diff drive controller: a twist becomes wheel speeds, the wheels' motion becomes odometry.

The law of the file (ros2_controllers jazzy): each update takes the newest twist, or zero when it is older than
`cmd_vel_timeout` (0: never), limits it against the last two limited ones (so a timeout brakes along the ramp), follows
the wheels, and writes (v -+ w * separation / 2) / radius to every wheel of a side. Before the first command nothing is
written; once the timeout has passed since the activation, zeros are. A feedback that is nan is an ERROR. When another
controller claims the references `NAME/linear/velocity` and `NAME/angular/velocity`, they are the twist (chaining).
Ours, and safer: a twist that is not finite is refused and does not refresh the timeout; odometry starts at the first
sample.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar, Final

from canopen_control.controllers.base import Controller, ControllerState
from canopen_control.controllers.diff_drive_params import DiffDriveParams, frozen_by_jerk, read_params, tf_prefix
from canopen_control.controllers.limiter import Limits, RateLimiter
from canopen_control.controllers.odometry import Odometry
from canopen_control.errors import ControlError, RobotConfigError
from canopen_control.hardware.interfaces import ERROR, OK, POSITION, VELOCITY, CommandInterface, ReturnType

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import StateInterface

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


class DiffDriveController(Controller):
    """Drives a robot with wheels on two sides by twists.

    `odometry` is where it is. `publications` counts the times its odometry was due at `publish_rate`, last at `stamp`
    (ns); `limited` is the twist after the limits, for `~/cmd_vel_out`.
    """

    topic: ClassVar[str | None] = "cmd_vel"

    def __init__(self, name: str, type_name: str = "diff_drive_controller/DiffDriveController") -> None:
        super().__init__(name, type_name)
        self.params = DiffDriveParams()
        self.odometry = Odometry(1.0, 1.0, 1.0)
        self.limited_linear = self.limited_angular = 0.0
        self.publications = 0
        self.stamp = 0
        self._references = (CommandInterface(f"{name}/linear", VELOCITY), CommandInterface(f"{name}/angular", VELOCITY))
        self._linear_limiter = self._angular_limiter = RateLimiter(Limits())
        self._timeout_ns = 0
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

    def set_odometry(self, x: float, y: float, heading: float) -> None:
        """Be somewhere else, in m and rad, from the next update on; ControlError if it is not active."""
        if self.state is not ControllerState.ACTIVE:
            raise ControlError(f"{self.name} is {self.state.value}; its odometry is set while it is active")
        if not all(map(math.isfinite, (x, y, heading))):
            raise ControlError(f"{self.name}: a pose is three finite numbers, got {x}, {y}, {heading}")
        self.odometry.set_pose(x, y, heading)

    def sample(self, namespace: str = "") -> dict[str, Any]:
        """Return its odometry as plain values: m, rad, s, and the six of each covariance's diagonal."""
        frame, child = self.frame_ids(namespace)
        return {
            "x": self.odometry.x,
            "y": self.odometry.y,
            "heading": self.odometry.heading,
            "linear": self.odometry.linear,
            "angular": self.odometry.angular,
            "frame_id": frame,
            "child_frame_id": child,
            "pose_covariance": list(self.params.pose_covariance_diagonal),
            "twist_covariance": list(self.params.twist_covariance_diagonal),
            "enable_odom_tf": self.params.enable_odom_tf,
            "limited": [self.limited_linear, self.limited_angular] if self.params.publish_limited_velocity else None,
        }

    # ----------------------------------------------------------------------------------------------------- lifecycle

    def on_configure(self, params: Params) -> None:
        """Read the parameters; the pose becomes 0."""
        given = read_params(params, self.geometry, lambda text: self.tell("parameter", text))
        self.params = given
        self._linear_limiter = _limiter(self.name, "linear.x", given.linear.limits())
        self._angular_limiter = _limiter(self.name, "angular.z", given.angular.limits())
        for axis, limits in (("linear.x", given.linear), ("angular.z", given.angular)):
            if frozen_by_jerk(limits):
                self.tell("parameter", f"{axis}.max_jerk: 0 keeps it from ever changing speed; remove it")
        self._wheels = (given.separation, given.left_radius, given.right_radius)
        self.odometry = Odometry(*self._wheels, given.velocity_rolling_window_size)
        self._timeout_ns, self._publish_ns = round(given.cmd_vel_timeout * NS), round(NS / given.publish_rate)
        self.update_rate = given.update_rate
        self.joints, self.interface = (*given.left, *given.right), VELOCITY
        self._publish_at = _AT_ONCE

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

    def _forget(self, now: int) -> None:
        """Have no command, and none before it."""
        self._linear = self._angular = math.nan
        self._command_stamp = now
        self._commanded = self._was_chained = self._writing = False
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
        made = min(stamp or now, now)
        if self._timeout_ns and now - made >= self._timeout_ns:
            age, timeout = (now - made) / NS, self._timeout_ns / NS
            raise self.refusal(
                f"got a twist that is {age:.3f} s old, cmd_vel_timeout is {timeout:g} s; check the clocks"
            )
        self._linear, self._angular = float(values[0]), float(values[1])
        self._command_stamp, self._commanded = made, True

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
            return ERROR
        self._before_linear, self._previous_linear = self._previous_linear, linear
        self._before_angular, self._previous_angular = self._previous_angular, angular
        self.limited_linear, self.limited_angular = linear, angular
        if now > self._publish_at:
            self._publish(now)
        self._write(linear, angular)
        return OK

    def _take_reference(self, now: int) -> None:
        """Find the twist wanted now: the chain's, or the last command, or zero if that is too old."""
        linear, angular = self._references
        if linear.owner is not None or angular.owner is not None:
            self._linear, self._angular = linear.value, angular.value
            if self._writing and (math.isnan(self._linear) or math.isnan(self._angular)):
                self._linear = self._angular = 0.0  # who was driven by a topic does not go on by itself
            self._was_chained, self._commanded = True, False
        elif self._was_chained and not self._commanded:
            self._was_chained = False
            self._linear = self._angular = 0.0
        elif self._timeout_ns and now - self._command_stamp > self._timeout_ns:
            if self._commanded:
                self._commanded = False
                age = (now - self._command_stamp) / NS
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

    def _publish(self, now: int) -> None:
        """Count a publication; the next is due at the next step of the period on a fixed grid, without a burst."""
        due, period = self._publish_at, self._publish_ns
        self._publish_at = (now if due == _AT_ONCE else max(due, now - period)) + period
        self.stamp = now
        self.publications += 1

    def _write(self, linear: float, angular: float) -> None:
        self._writing = True
        separation, left_radius, right_radius = self._wheels
        left, right = wheel_velocities(linear, angular, separation, left_radius, right_radius)
        for wheel in self._left_commands:
            wheel.value = left
        for wheel in self._right_commands:
            wheel.value = right


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
