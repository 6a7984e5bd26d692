"""The omni wheel drive controller: a twist that may go sideways becomes the speeds of three wheels or more.

Rules (ros2_controllers jazzy): wheels stand at even angles around the middle; the odometry is the fit of
what they say. Ours: a `cmd_vel_timeout` of 0 lets a twist move it for one update, where upstream's lets it move never,
odometry starts at the first sample, and feedback is waited for, see `mobile_base`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar, Final

from canopen_control.controllers.base import DriveGeometry
from canopen_control.controllers.base_params import read_checked
from canopen_control.controllers.holonomic_base import HolonomicBase
from canopen_control.controllers.omni_params import LEAST_WHEELS, OmniParams
from canopen_control.controllers.planar_pose import HolonomicKinematics
from canopen_control.urdf.joint_element import VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.rpc.messages.samples import OdometrySample


# Wheel i of n stands at the angle 2 pi i / n + `offset` and rolls along the circle (ros2_controllers jazzy).


_LEAST_DT: Final = 1e-6  # s between two positions


class OmniKinematics(HolonomicKinematics):
    """The pose, and `forward`, `left` (m/s) and `angular` (rad/s); `wheels` are its commands in rad/s."""

    def __init__(self, count: int, robot_radius: float, wheel_radius: float, offset: float = 0.0) -> None:
        if count < LEAST_WHEELS:
            raise ValueError(f"{count} wheels do not determine three velocities; there are {LEAST_WHEELS} or more")
        angles = [math.tau * index / count + offset for index in range(count)]
        super().__init__([(math.sin(angle), -math.cos(angle), -robot_radius) for angle in angles], wheel_radius)
        self._positions = [0.0] * count
        self._speeds = [0.0] * count

    def begin(self, positions: Sequence[float]) -> None:
        """Set the start positions of the wheels, in rad."""
        for index in range(len(self.wheels)):
            self._positions[index] = positions[index]

    def update_position(self, positions: Sequence[float], dt: float) -> bool:
        """Follow the wheels' positions in rad; `dt` in s. Return False for a step too short to be one."""
        if abs(dt) < _LEAST_DT:
            return False
        for index in range(len(self.wheels)):
            self._speeds[index] = (positions[index] - self._positions[index]) / dt
            self._positions[index] = positions[index]
        return self.update_velocity(self._speeds, dt)

    def update_velocity(self, speeds: Sequence[float], dt: float) -> bool:
        """Follow the wheels' speeds in rad/s; it counts however short or backward the step is."""
        self.fit(speeds)
        return self.update_open_loop(self.forward, self.left, self.angular, dt)

    def update_open_loop(self, forward: float, left: float, angular: float, dt: float) -> bool:
        """Believe a command, in m/s and rad/s."""
        self.forward, self.left, self.angular = forward, left, angular
        self.shift(forward * dt, left * dt, angular * dt)
        return True


class OmniWheelDriveController(HolonomicBase):
    """Drives a base on omni wheels; `kinematics` has its pose."""

    settable: ClassVar[tuple[str, ...]] = ("cmd_vel_timeout", "enable_odom_tf", "publish_limited_velocity")

    def __init__(self, name: str, type_name: str = "") -> None:
        self.kinematics = OmniKinematics(LEAST_WHEELS, 1.0, 1.0)
        super().__init__(name, type_name, self.kinematics)
        self.params = OmniParams()
        self._reading: list[float] = []

    def wheel_base(self) -> DriveGeometry:
        """Return frames and wheel radius of the base."""
        params, (odom, base) = self.params, self.frame_ids()
        return DriveGeometry((), (), 0.0, params.wheel_radius, odom, base, params.enable_odom_tf)

    def on_configure(self, params: Params) -> None:
        """Read the parameters; the pose becomes 0."""
        self.params = settings = read_checked(params, OmniParams)
        count = len(settings.wheel_names)
        self.kinematics = OmniKinematics(
            count, settings.robot_radius, settings.wheel_radius, settings.wheel_offset or 0.0
        )
        self.move_by(self.kinematics)
        self.joints, self.interface = settings.wheel_names, VELOCITY
        self._reading = [0.0] * count
        self.set_up(settings, settings.cmd_vel_timeout, count, open_loop=settings.open_loop)

    def on_set(self, params: Params) -> None:
        """Apply another timeout and odometry options from the next update on."""
        settings = read_checked(params, OmniParams)
        self.take(settings, settings.cmd_vel_timeout)
        self.params = settings

    def state_interface_names(self) -> list[str]:
        """Return position or velocity of every wheel; nothing if the loop is open."""
        return self.wheel_states(self.params.position_feedback)

    def sample(self, wall_offset_ns: int) -> OdometrySample | None:
        """Return the last published odometry."""
        return self.odometry_sample(wall_offset_ns)

    def begin(self) -> None:
        """Set the start positions of the wheels."""
        self._read()
        self.kinematics.begin(self._reading)

    def advance(self, dt: float) -> None:
        """Integrate the wheels' motion into the pose."""
        self._read()
        if self.params.position_feedback:
            self.kinematics.update_position(self._reading, dt)
        else:
            self.kinematics.update_velocity(self._reading, dt)

    def integrate_command(self, dt: float) -> None:
        """Follow the twist."""
        self.kinematics.update_open_loop(self.limited[0], self.limited[1], self.limited[2], dt)

    def _read(self) -> None:
        for index in range(len(self._reading)):
            self._reading[index] = self.states[index].value
