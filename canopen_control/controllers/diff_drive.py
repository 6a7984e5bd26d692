"""Diff drive controller: converts twists to wheel speeds, and wheel motion to odometry.

Kinematics (ros2_controllers jazzy): (v -+ w * separation / 2) / radius is written to every wheel of a side. Nothing is
written before the first command; when the timeout has passed since the activation, zeros are written. A
`cmd_vel_timeout` of 0 disables the timeout. Feedback that is nan is an ERROR. For differences from upstream see
`mobile_base`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar, Final

from canopen_control.controllers.base import ControllerState, DriveGeometry
from canopen_control.controllers.base_params import DiffDriveParams, SwitchedLimits, read_params
from canopen_control.controllers.mobile_base import MobileBase
from canopen_control.controllers.planar_pose import MIN_DT, PlanarPose, RollingMean
from canopen_control.errors import RobotConfigError
from canopen_control.rpc.messages.state import WHEEL_CALIBRATION
from canopen_control.urdf.joint_element import VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.rpc.messages.samples import OdometrySample


# Odometry of a differential drive robot.
#
# Rules (ros2_controllers jazzy): a step is the exact arc that follows from the distances of the two wheels
# (`planar_pose`); a time step shorter than `MIN_DT` is added to the next step; `linear` and `angular` are means over
# the last steps. Difference from upstream: the first sample after `stop` is the baseline, so that neither the wheel
# angles nor the time before this sample move the pose (upstream jumps by both).


NS: Final = 1_000_000_000


class Odometry(PlanarPose):
    """Odometry of a differential drive: pose `x`, `y` in m and `heading` in rad, with mean velocities.

    `separation` and the radii, in m, include their multipliers; velocities are averaged over the last `window` steps.
    """

    def __init__(self, separation: float, left_radius: float, right_radius: float, window: int = 10) -> None:
        super().__init__()
        self._separation, self._left_radius, self._right_radius = separation, left_radius, right_radius
        self._linear, self._angular = RollingMean(window), RollingMean(window)
        self.started = False
        self._time = self._still = 0  # _still: steps in a row in which no wheel turned
        self._window = window
        self._left = self._right = 0.0

    @property
    def linear(self) -> float:
        """Mean forward velocity in m/s."""
        return self._linear.mean

    @property
    def angular(self) -> float:
        """Mean yaw rate in rad/s."""
        return self._angular.mean

    def resize(self, separation: float, left_radius: float, right_radius: float) -> None:
        """Replace the wheel dimensions, in m, for later steps; the pose is unchanged."""
        self._left *= left_radius / self._left_radius
        self._right *= right_radius / self._right_radius
        self._separation, self._left_radius, self._right_radius = separation, left_radius, right_radius

    def begin(self, left: float, right: float, now: int) -> None:
        """Set the baseline: the wheel angles in rad at time `now` in ns. The pose is unchanged."""
        self._left, self._right, self._time = left * self._left_radius, right * self._right_radius, now
        self.started = True

    def stop(self) -> None:
        """Ignore motion until the next sample, which becomes the new baseline."""
        self.started = False

    def set_pose(self, x: float, y: float, heading: float) -> None:
        super().set_pose(x, y, heading)
        self._linear.clear()
        self._angular.clear()

    def update_position(self, left: float, right: float, now: int) -> bool:
        """Integrate the wheel angles in rad; return False for the baseline or if the time step is too short."""
        if not self.started:
            self.begin(left, right, now)
            return False
        dt = (now - self._time) / NS
        if dt < MIN_DT:
            return False
        distance_left, distance_right = left * self._left_radius, right * self._right_radius
        step_left, step_right = distance_left - self._left, distance_right - self._right
        self._left, self._right = distance_left, distance_right
        if step_left == 0.0 == step_right and self._still > self._window:
            self._time = now  # pose and averages are unchanged
            return True
        return self._step(step_left, step_right, dt, now)

    def update_velocity(self, left: float, right: float, now: int) -> bool:
        """Integrate the wheel velocities in rad/s; return False for the baseline or if the time step is too short."""
        if not self.started:
            self.begin(0.0, 0.0, now)
            return False
        dt = (now - self._time) / NS
        if dt < MIN_DT:
            return False
        return self._step(left * self._left_radius * dt, right * self._right_radius * dt, dt, now)

    def update_open_loop(self, linear: float, angular: float, now: int) -> bool:
        """Integrate the commanded twist, in m/s and rad/s; return False for the first call, which is the baseline."""
        if not self.started:
            self.begin(0.0, 0.0, now)
            return False
        dt = (now - self._time) / NS
        self._time, self._still = now, 0
        for window, value in ((self._linear, linear), (self._angular, angular)):
            window.clear()
            window.add(value)
        self.drive(linear * dt, angular * dt)
        return True

    def _step(self, left: float, right: float, dt: float, now: int) -> bool:
        linear, angular = (left + right) * 0.5, (right - left) / self._separation
        self.drive(linear, angular)
        self._time = now
        self._still = self._still + 1 if left == 0.0 == right else 0
        self._linear.add(linear / dt)
        self._angular.add(angular / dt)
        return True


def wheel_velocities(
    linear: float, angular: float, separation: float, left_radius: float, right_radius: float
) -> tuple[float, float]:
    """Return the left and right wheel speeds in rad/s for a twist in m/s and rad/s; lengths are in m."""
    turn = angular * separation / 2.0
    return (linear - turn) / left_radius, (linear + turn) / right_radius


class DiffDriveController(MobileBase):
    """Controller of a differential drive base that is commanded by twists.

    The odometry is published at `publish_rate`, and the limited twist on `~/cmd_vel_out` if the parameters enable it.
    """

    title: ClassVar[str] = "Diff drive"
    reads: ClassVar[type[DiffDriveParams]] = DiffDriveParams
    sections: ClassVar[dict[str, type[object]]] = {
        "Limits: `linear.x.KEY` and `angular.z.KEY`": SwitchedLimits,
    }
    offers: ClassVar[tuple[str, ...]] = (WHEEL_CALIBRATION,)
    zero_is_never: ClassVar[bool] = True
    by_twist_alone: ClassVar[bool] = True
    waits_for_a_twist: ClassVar[bool] = True
    settable: ClassVar[tuple[str, ...]] = (
        "cmd_vel_timeout", "enable_odom_tf", "publish_limited_velocity", "linear.x.*", "angular.z.*",
        "wheel_separation_multiplier", "left_wheel_radius_multiplier", "right_wheel_radius_multiplier",
    )  # fmt: skip

    def __init__(self, name: str, type_name: str = "") -> None:
        self.odometry = Odometry(1.0, 1.0, 1.0)
        super().__init__(name, type_name, self.odometry)
        self.params = DiffDriveParams()
        self._wheels = (1.0, 1.0, 1.0)  # separation, left and right radius, in m
        self._side = 0
        self._left_states: list[StateInterface] = []
        self._right_states: list[StateInterface] = []
        self._pair: tuple[StateInterface, StateInterface] | None = None  # wheels of a base with one wheel on each side

    def wheel_base(self) -> DriveGeometry:
        """Return the nominal wheel geometry, without the multipliers, which are calibration factors."""
        params, (odom, base) = self.params, self.frame_ids()
        sizes = (params.wheel_separation, params.wheel_radius)
        return DriveGeometry(params.left, params.right, *sizes, odom, base, params.enable_odom_tf, params.frozen)

    def sample(self, wall_offset_ns: int) -> OdometrySample | None:
        return self.odometry_sample(wall_offset_ns, self.params.publish_limited_velocity)

    def on_configure(self, params: Params) -> None:
        settings = read_params(params, self.geometry, lambda text: self.report("parameter", text))
        self.params = settings
        self._wheels = (settings.separation, settings.left_radius, settings.right_radius)
        self.odometry = Odometry(*self._wheels, settings.velocity_rolling_window_size)
        self.pose = self.odometry
        self.joints, self.interface = (*settings.left, *settings.right), VELOCITY
        self._side = len(settings.left)
        limits = (settings.linear, settings.angular)
        self.set_up(
            settings, settings.cmd_vel_timeout, len(self.joints), limits, settings.publish_rate, settings.open_loop
        )

    def on_set(self, params: Params) -> None:
        settings = read_params(params, self.geometry)
        wheels = (settings.separation, settings.left_radius, settings.right_radius)
        if wheels != self._wheels and self.state is ControllerState.ACTIVE and any(self.limited):
            raise RobotConfigError(f"{self.name} is moving; set the wheel multipliers at standstill")
        self.apply_parameters(settings, settings.cmd_vel_timeout, (settings.linear, settings.angular))
        self.params, self._wheels = settings, wheels
        self.odometry.resize(*wheels)

    def command_interface_names(self) -> list[str]:
        return [f"{wheel}/{VELOCITY}" for wheel in self.joints]

    def state_interface_names(self) -> list[str]:
        return self.wheel_states(self.params.position_feedback)

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        super().on_activate(commands, states, now)
        self._left_states, self._right_states = states[: self._side], states[self._side :]
        self._pair = (states[0], states[1]) if len(states) == 2 and self._side == 1 else None

    @property
    def begun(self) -> bool:
        return self.odometry.started

    def stop_following(self) -> None:
        self.odometry.stop()

    def velocities(self) -> tuple[float, float, float]:
        return self.odometry.linear, 0.0, self.odometry.angular

    def compute_commands(self, twist: Sequence[float]) -> None:
        separation, left_radius, right_radius = self._wheels
        left, right = wheel_velocities(twist[0], twist[1], separation, left_radius, right_radius)
        for index in range(self._side):
            self.targets[index], self.targets[self._side + index] = left, right

    def follow(self, now: int) -> bool:
        if self.params.open_loop:
            self.odometry.update_open_loop(self.limited[0], self.limited[1], now)
            return True
        pair = self._pair
        if pair is None:
            left, right = _mean(self._left_states), _mean(self._right_states)
        else:
            left, right = pair[0].value, pair[1].value
        if not (math.isfinite(left) and math.isfinite(right)):
            return False
        if self.params.position_feedback:
            self.odometry.update_position(left, right, now)
        else:
            self.odometry.update_velocity(left, right, now)
        return True


def _mean(states: Sequence[StateInterface]) -> float:
    total = 0.0
    for state in states:
        total += state.value
    return total / len(states)
