"""The omni wheel drive controller: a twist that may go sideways becomes the speeds of three wheels or more.

The law of the file (ros2_controllers jazzy): wheels stand at even angles around the middle; the odometry is the fit of
what they say. Ours: a `cmd_vel_timeout` of 0 lets a twist move it for one update, where upstream's lets it move never,
odometry starts at the first sample, and feedback is waited for, see `mobile_base`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from canopen_control.controllers.base import WheelBase
from canopen_control.controllers.mobile_base import BASELINE, HOLONOMIC, TOO_SHORT, MobileBase
from canopen_control.controllers.omni_kinematics import LEAST_WHEELS, OmniKinematics
from canopen_control.controllers.omni_params import OmniParams, read_params
from canopen_control.hardware.interfaces import POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.rpc.messages.samples import OdometrySample

__all__ = ["OmniWheelDriveController"]


class OmniWheelDriveController(MobileBase):
    """Drives a base on omni wheels; `kinematics` is where it is."""

    twist_axes: ClassVar[tuple[str, ...]] = HOLONOMIC
    references: ClassVar[tuple[str, ...]] = ("linear/x", "linear/y", "angular/z")
    settable: ClassVar[tuple[str, ...]] = ("cmd_vel_timeout", "enable_odom_tf", "publish_limited_velocity")

    def __init__(self, name: str, type_name: str = "omni_wheel_drive_controller/OmniWheelDriveController") -> None:
        self.kinematics = OmniKinematics(LEAST_WHEELS, 1.0, 1.0)
        super().__init__(name, type_name, self.kinematics)
        self.params = OmniParams()
        self._reading: list[float] = []

    def wheel_base(self) -> WheelBase:
        """Return its frames, and the radius of its wheels, which stand on no two sides."""
        given, (odom, base) = self.params, self.frame_ids()
        return WheelBase((), (), 0.0, given.wheel_radius, odom, base, given.enable_odom_tf)

    def on_configure(self, params: Params) -> None:
        """Read the parameters; the pose becomes 0."""
        self.params = given = read_params(params)
        count = len(given.wheel_names)
        self.kinematics = OmniKinematics(count, given.robot_radius, given.wheel_radius, given.wheel_offset or 0.0)
        self.pose = self.kinematics
        self.joints, self.interface = given.wheel_names, VELOCITY
        self._reading = [0.0] * count
        self.set_up(given, given.cmd_vel_timeout, count)

    def on_set(self, params: Params) -> None:
        """Take another timeout, other things to publish, from the next update on."""
        given = read_params(params)
        self.take(given, given.cmd_vel_timeout)
        self.params = given

    def command_interface_names(self) -> list[str]:
        """Return the velocity of every wheel."""
        return [f"{wheel}/{VELOCITY}" for wheel in self.joints]

    def state_interface_names(self) -> list[str]:
        """Return position or velocity of every wheel; nothing if the loop is open."""
        if self.params.open_loop:
            return []
        feedback = POSITION if self.params.position_feedback else VELOCITY
        return [f"{wheel}/{feedback}" for wheel in self.joints]

    def sample(self, wall_offset_ns: int) -> OdometrySample | None:
        """Return the odometry as it was published last."""
        return self.odometry_sample(wall_offset_ns)

    def velocities(self) -> tuple[float, float, float]:
        """Return those of the last step."""
        wheels = self.kinematics
        return wheels.forward, wheels.left, wheels.angular

    def work_out(self, twist: Sequence[float]) -> None:
        """Share a twist out to the wheels."""
        self.kinematics.command(twist[0], twist[1], twist[2])
        for index in range(len(self.targets)):
            self.targets[index] = self.kinematics.wheels[index]

    def follow(self, now: int) -> bool:
        """Move the odometry; return False if a wheel's feedback is not known."""
        given, wheels = self.params, self.kinematics
        if not self.states_known():
            return False
        dt = self.elapsed(now)
        if dt == TOO_SHORT:
            return True
        if given.open_loop:
            if dt != BASELINE:
                wheels.update_open_loop(self.limited[0], self.limited[1], self.limited[2], dt)
            return True
        for index in range(len(self._reading)):
            self._reading[index] = self.states[index].value
        if dt == BASELINE:
            wheels.begin(self._reading)
        elif given.position_feedback:
            wheels.update_position(self._reading, dt)
        else:
            wheels.update_velocity(self._reading, dt)
        return True
