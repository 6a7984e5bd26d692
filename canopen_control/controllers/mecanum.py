"""The mecanum drive controller: a twist that may go sideways becomes the speeds of four wheels.

Rules (ros2_controllers jazzy): each axis of the twist has its limiter; the odometry is what four measured
speeds say. Its `reference_timeout` is 0 unless it is given, which lets a twist move it for one update. Ours, and safer:
a timeout brakes along the limits, where upstream's does so for one update and then stands, see `mobile_base`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from canopen_control.controllers.base import DriveGeometry, finite
from canopen_control.controllers.base_params import read_checked
from canopen_control.controllers.holonomic_base import HOLONOMIC, HolonomicBase
from canopen_control.controllers.mecanum_params import COMMANDED, MecanumParams
from canopen_control.controllers.planar_pose import MIN_DT, HolonomicKinematics
from canopen_control.rpc.messages.samples import MecanumSample, grown
from canopen_control.urdf.joint_element import VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.rpc.messages.samples import OdometrySample, Sample


# Wheels go round the base from the front left one with the clock: front left, front right, rear right, rear left, as
# `WHEELS` has it. The frame of the base may stand off the middle of the wheels (ros2_controllers jazzy).


class MecanumKinematics(HolonomicKinematics):
    """The pose, and `forward`, `left` (m/s) and `angular` (rad/s), of the base's frame; `wheels` are its commands.

    `reach` is the sum of the wheels' distances from the middle along x and y, `offset` where the frame is: x, y, angle.
    """

    def __init__(self, radius: float, reach: float, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        x, y, angle = offset
        cosine, sine = math.cos(angle), math.sin(angle)
        rows = []
        for across, around in ((-1.0, -reach), (1.0, reach), (-1.0, reach), (1.0, -reach)):
            turn = around + y - across * x  # of the frame of the base, seen from the middle of the wheels
            rows.append((cosine + across * sine, across * cosine - sine, turn))
        super().__init__(rows, radius)

    def update(self, speeds: Sequence[float], dt: float) -> bool:
        """Follow the wheels' speeds in rad/s for `dt` s; return whether the step was long enough to count."""
        if dt < MIN_DT:
            return False
        self.fit(speeds)
        self.heading += self.angular * dt
        along, across = math.cos(self.heading) * dt, math.sin(self.heading) * dt
        self.x += along * self.forward - across * self.left
        self.y += across * self.forward + along * self.left
        return True


class MecanumDriveController(HolonomicBase):
    """Drives a base on four mecanum wheels; `kinematics` has its pose."""

    topic: ClassVar[str | None] = "reference"
    tells: ClassVar[type[Sample] | None] = MecanumSample
    timeout_key: ClassVar[str] = "reference_timeout"
    roller_wheels: ClassVar[tuple[str, ...]] = COMMANDED
    settable: ClassVar[tuple[str, ...]] = (
        "reference_timeout", "enable_odom_tf", "linear.x.*", "linear.y.*", "angular.z.*",
    )  # fmt: skip

    def __init__(self, name: str, type_name: str = "") -> None:
        self.kinematics = MecanumKinematics(1.0, 1.0)
        super().__init__(name, type_name, self.kinematics)
        self.params = MecanumParams()
        self._speeds, self._reading = [0.0] * 4, [0.0] * 4
        self._reference = [0.0, 0.0, 0.0]

    def wheel_base(self) -> DriveGeometry:
        """Return the drive geometry of the parameters."""
        params, (odom, base) = self.params, self.frame_ids()
        front_left, front_right, rear_right, rear_left = params.commanded
        frozen = tuple(axis for axis, limit in zip(HOLONOMIC, params.limits, strict=True) if limit.freezes)
        sides = ((front_left, rear_left), (front_right, rear_right))
        return DriveGeometry(
            *sides, 0.0, params.radius, odom, base, params.enable_odom_tf, frozen, "kinematics.wheels_radius"
        )

    def on_configure(self, params: Params) -> None:
        """Read the parameters; the pose becomes 0."""
        self.params = settings = read_checked(params, MecanumParams)
        self.kinematics = MecanumKinematics(settings.radius, settings.reach, settings.offset)
        self.move_by(self.kinematics)
        self.joints, self.interface = settings.commanded, VELOCITY
        self.set_up(settings, settings.reference_timeout, len(self.joints), settings.limits)

    def on_set(self, params: Params) -> None:
        """Apply other limits and another timeout from the next update on."""
        settings = read_checked(params, MecanumParams)
        self.take(settings, settings.reference_timeout, settings.limits)
        self.params = settings

    def state_interface_names(self) -> list[str]:
        """Return the velocity of every wheel, in the same order."""
        return [f"{joint}/{VELOCITY}" for joint in self.params.measured]

    def advance(self, dt: float) -> None:
        """Integrate the wheels' motion into the pose."""
        for index in range(len(self._speeds)):
            self._speeds[index] = self.states[index].value
        self.kinematics.update(self._speeds, dt)

    def snapshot(self) -> None:
        """Copy the wheels' speeds and the requested twist too."""
        super().snapshot()
        for index in range(len(self._reading)):
            self._reading[index] = self.states[index].value
        for index in range(len(self._reference)):
            self._reference[index] = self.wanted[index]

    def sample(self, wall_offset_ns: int) -> OdometrySample | None:
        """Return odometry, speeds and twist as they were published last."""
        odometry = self.odometry_sample(wall_offset_ns)
        if odometry is None:
            return None
        front_left, front_right, rear_right, rear_left = (finite(value) for value in self._reading)
        wheels = [front_left, rear_left, rear_right, front_right]
        return grown(MecanumSample, odometry, wheels=wheels, reference=[finite(value) for value in self._reference])
