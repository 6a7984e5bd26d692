"""The diff drive controller: a twist becomes wheel speeds, the wheels' motion becomes odometry.

Kinematics (ros2_controllers jazzy): (v -+ w * separation / 2) / radius is written to every wheel of a side.
Before the first command nothing is written; once the timeout has passed since the activation, zeros are. A
`cmd_vel_timeout` of 0 is never. A feedback that is nan is an ERROR. Ours, and safer: see `mobile_base`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar, Final

from canopen_control.controllers.base import ControllerState, DriveGeometry
from canopen_control.controllers.diff_drive_params import DiffDriveParams, SwitchedLimits, read_params
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


# Where a differential drive robot is, from what its wheels did.
#
# Rules (ros2_controllers jazzy): a step is the exact arc of the two wheels' ways (`planar_pose`), and one
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
        self._time = self._still = 0  # _still: steps in a row in which no wheel turned
        self._window = window
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
        """Use other wheel sizes from now on, in m; the pose is unchanged."""
        self._left *= left_radius / self._left_radius
        self._right *= right_radius / self._right_radius
        self._separation, self._left_radius, self._right_radius = separation, left_radius, right_radius

    def begin(self, left: float, right: float, now: int) -> None:
        """Set the wheels' angles (rad) at `now` (ns) as the baseline; the pose is unchanged."""
        self._left, self._right, self._time = left * self._left_radius, right * self._right_radius, now
        self.started = True

    def stop(self) -> None:
        """Ignore motion until the next sample, which becomes the baseline."""
        self.started = False

    def set_pose(self, x: float, y: float, heading: float) -> None:
        """Set the pose, in m and rad; the averages are reset."""
        super().set_pose(x, y, heading)
        self._linear.clear()
        self._angular.clear()

    def update_position(self, left: float, right: float, now: int) -> bool:
        """Integrate the wheels' angles in rad; return whether the time step was long enough."""
        if not self.started:
            self.begin(left, right, now)
            return False
        dt = (now - self._time) / NS
        if dt < MIN_DT:
            return False
        way_left, way_right = left * self._left_radius, right * self._right_radius
        step_left, step_right = way_left - self._left, way_right - self._right
        self._left, self._right = way_left, way_right
        if step_left == 0.0 == step_right and self._still > self._window:
            self._time = now  # pose and averages stay as they are
            return True
        return self._step(step_left, step_right, dt, now)

    def update_velocity(self, left: float, right: float, now: int) -> bool:
        """Integrate the wheels' velocities in rad/s; return whether the time step was long enough."""
        if not self.started:
            self.begin(0.0, 0.0, now)
            return False
        dt = (now - self._time) / NS
        if dt < MIN_DT:
            return False
        return self._step(left * self._left_radius * dt, right * self._right_radius * dt, dt, now)

    def update_open_loop(self, linear: float, angular: float, now: int) -> bool:
        """Integrate the command, in m/s and rad/s; return whether the time step was long enough."""
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
    """Return the wheels' speeds in rad/s for a twist in m/s and rad/s; lengths in m."""
    turn = angular * separation / 2.0
    return (linear - turn) / left_radius, (linear + turn) / right_radius


class DiffDriveController(MobileBase):
    """Controller that moves a robot with wheels on two sides by twists.

    `odometry` is published at `publish_rate`; the twist after the limits is published on `~/cmd_vel_out`.
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
        self._pair: tuple[StateInterface, StateInterface] | None = None  # of a base with one wheel on each side

    def wheel_base(self) -> DriveGeometry:
        """Return the wheel geometry in its parameters, without the multipliers, which are calibration."""
        params, (odom, base) = self.params, self.frame_ids()
        sizes = (params.wheel_separation, params.wheel_radius)
        return DriveGeometry(params.left, params.right, *sizes, odom, base, params.enable_odom_tf, params.frozen)

    def sample(self, wall_offset_ns: int) -> OdometrySample | None:
        """Return the last published odometry."""
        return self.odometry_sample(wall_offset_ns, self.params.publish_limited_velocity)

    def on_configure(self, params: Params) -> None:
        """Read the parameters; the pose becomes 0."""
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
        """Apply other limits, timeouts and publications from the next update on; wheel sizes only at rest."""
        settings = read_params(params, self.geometry)
        wheels = (settings.separation, settings.left_radius, settings.right_radius)
        if wheels != self._wheels and self.state is ControllerState.ACTIVE and any(self.limited):
            raise RobotConfigError(f"{self.name} moves; the multipliers of its wheels are set while it stands")
        self.take(settings, settings.cmd_vel_timeout, (settings.linear, settings.angular))
        self.params, self._wheels = settings, wheels
        self.odometry.resize(*wheels)

    def command_interface_names(self) -> list[str]:
        """Return the velocity of every wheel, the left ones first."""
        return [f"{wheel}/{VELOCITY}" for wheel in self.joints]

    def state_interface_names(self) -> list[str]:
        """Return position or velocity of every wheel; nothing in open loop."""
        return self.wheel_states(self.params.position_feedback)

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        """Start without a command; the pose is kept, and the next sample is the baseline."""
        super().on_activate(commands, states, now)
        self._left_states, self._right_states = states[: self._side], states[self._side :]
        self._pair = (states[0], states[1]) if len(states) == 2 and self._side == 1 else None

    @property
    def begun(self) -> bool:
        """Whether odometry has its baseline."""
        return self.odometry.started

    def stop_following(self) -> None:
        """Ignore motion until the next sample."""
        self.odometry.stop()

    def velocities(self) -> tuple[float, float, float]:
        """Return the mean velocities of its odometry."""
        return self.odometry.linear, 0.0, self.odometry.angular

    def compute_commands(self, twist: Sequence[float]) -> None:
        """Compute the velocities of both sides from a twist."""
        separation, left_radius, right_radius = self._wheels
        left, right = wheel_velocities(twist[0], twist[1], separation, left_radius, right_radius)
        for index in range(self._side):
            self.targets[index], self.targets[self._side + index] = left, right

    def follow(self, now: int) -> bool:
        """Update the odometry; return False if a wheel's feedback is unknown."""
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
