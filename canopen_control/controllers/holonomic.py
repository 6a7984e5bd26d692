"""Controllers of bases that can also move sideways, with omni or mecanum wheels.

Rules (ros2_controllers jazzy): three or more omni wheels are mounted at equal angles around the centre; each twist axis
of a mecanum base has its own limiter. The odometry of both is a least-squares fit to the measured wheel speeds.
Difference from upstream: with a timeout of 0 (the default of `reference_timeout` of mecanum bases) a twist applies for
one update, where upstream's omni wheels never move; after a timeout the base brakes along its limits, where upstream's
mecanum wheels brake for one update and then stop at once; odometry starts at the first sample, and missing feedback
does not end the controller, see `mobile_base`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar, Final

from mypy_extensions import mypyc_attr

from canopen_control.controllers.base import DriveGeometry, finite
from canopen_control.controllers.base_params import (
    COMMANDED,
    MIN_WHEELS,
    MecanumParams,
    OmniParams,
    TwistAxisLimits,
    read_checked,
)
from canopen_control.controllers.mobile_base import MobileBase
from canopen_control.controllers.planar_pose import MIN_DT, HolonomicKinematics
from canopen_control.rpc.messages.samples import MecanumSample, grown
from canopen_control.urdf.joint_element import VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.rpc.messages.samples import OdometrySample, Sample


HOLONOMIC: Final = ("linear.x", "linear.y", "angular.z")
"""Twist axes of a holonomic base: forward, to the left, and yaw."""


@mypyc_attr(allow_interpreted_subclasses=True)
class HolonomicBase(MobileBase):
    """Base class of controllers with omni or mecanum wheels; `wheels` are the kinematics including the pose."""

    twist_axes: ClassVar[tuple[str, ...]] = HOLONOMIC
    references: ClassVar[tuple[str, ...]] = ("linear/x", "linear/y", "angular/z")

    def __init__(self, name: str, type_name: str, wheels: HolonomicKinematics) -> None:
        super().__init__(name, type_name, wheels)
        self._drive = wheels

    def move_by(self, wheels: HolonomicKinematics) -> None:
        """Replace the kinematics, including the pose."""
        self.pose = self._drive = wheels

    def command_interface_names(self) -> list[str]:
        return [f"{joint}/{VELOCITY}" for joint in self.joints]

    def velocities(self) -> tuple[float, float, float]:
        return self._drive.forward, self._drive.left, self._drive.angular

    def compute_commands(self, twist: Sequence[float]) -> None:
        self._drive.command(twist[0], twist[1], twist[2])
        for index in range(len(self.targets)):
            self.targets[index] = self._drive.wheels[index]


# Omni wheels (ros2_controllers jazzy): wheel i of n is mounted at 2 pi i / n + `offset`, and rolls along the circle.


_MIN_DT: Final = 1e-6  # minimum time between two positions, in s


class OmniKinematics(HolonomicKinematics):
    """Kinematics and odometry of a base with omni wheels.

    `forward` and `left` in m/s and `angular` in rad/s are the velocities of the pose, `wheels` the commands in rad/s.
    """

    def __init__(self, count: int, robot_radius: float, wheel_radius: float, offset: float = 0.0) -> None:
        if count < MIN_WHEELS:
            raise ValueError(f"{count} wheels do not determine three velocities; use {MIN_WHEELS} or more")
        angles = [math.tau * index / count + offset for index in range(count)]
        super().__init__([(math.sin(angle), -math.cos(angle), -robot_radius) for angle in angles], wheel_radius)
        self._positions = [0.0] * count
        self._speeds = [0.0] * count

    def begin(self, positions: Sequence[float]) -> None:
        """Set the odometry baseline to these wheel positions in rad."""
        for index in range(len(self.wheels)):
            self._positions[index] = positions[index]

    def update_position(self, positions: Sequence[float], dt: float) -> bool:
        """Update the odometry from wheel positions in rad; `dt` is in s. Return False if the time step is too short."""
        if abs(dt) < _MIN_DT:
            return False
        for index in range(len(self.wheels)):
            self._speeds[index] = (positions[index] - self._positions[index]) / dt
            self._positions[index] = positions[index]
        return self.update_velocity(self._speeds, dt)

    def update_velocity(self, speeds: Sequence[float], dt: float) -> bool:
        """Integrate the wheel speeds in rad/s over `dt` s, which may be negative; return True."""
        self.fit(speeds)
        return self.update_open_loop(self.forward, self.left, self.angular, dt)

    def update_open_loop(self, forward: float, left: float, angular: float, dt: float) -> bool:
        """Integrate a commanded twist in m/s and rad/s over `dt` s; return True."""
        self.forward, self.left, self.angular = forward, left, angular
        self.shift(forward * dt, left * dt, angular * dt)
        return True


class OmniWheelDriveController(HolonomicBase):
    """Controller of a base with omni wheels; `kinematics` contains the pose."""

    title: ClassVar[str] = "Omni wheel drive"
    reads: ClassVar[type[OmniParams]] = OmniParams
    settable: ClassVar[tuple[str, ...]] = ("cmd_vel_timeout", "enable_odom_tf", "publish_limited_velocity")

    def __init__(self, name: str, type_name: str = "") -> None:
        self.kinematics = OmniKinematics(MIN_WHEELS, 1.0, 1.0)
        super().__init__(name, type_name, self.kinematics)
        self.params = OmniParams()
        self._reading: list[float] = []

    def wheel_base(self) -> DriveGeometry:
        params, (odom, base) = self.params, self.frame_ids()
        return DriveGeometry((), (), 0.0, params.wheel_radius, odom, base, params.enable_odom_tf)

    def on_configure(self, params: Params) -> None:
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
        settings = read_checked(params, OmniParams)
        self.apply_parameters(settings, settings.cmd_vel_timeout)
        self.params = settings

    def state_interface_names(self) -> list[str]:
        return self.wheel_states(self.params.position_feedback)

    def sample(self, wall_offset_ns: int) -> OdometrySample | None:
        return self.odometry_sample(wall_offset_ns)

    def begin(self) -> None:
        self._read()
        self.kinematics.begin(self._reading)

    def advance(self, dt: float) -> None:
        self._read()
        if self.params.position_feedback:
            self.kinematics.update_position(self._reading, dt)
        else:
            self.kinematics.update_velocity(self._reading, dt)

    def integrate_command(self, dt: float) -> None:
        self.kinematics.update_open_loop(self.limited[0], self.limited[1], self.limited[2], dt)

    def _read(self) -> None:
        for index in range(len(self._reading)):
            self._reading[index] = self.states[index].value


# Mecanum wheels (ros2_controllers jazzy) are in the order of `WHEELS`, clockwise from the front left wheel. The base
# frame may have an offset from the centre of the wheels.


class MecanumKinematics(HolonomicKinematics):
    """Kinematics and odometry of a base with four mecanum wheels, for the base frame.

    `forward` and `left` in m/s and `angular` in rad/s are the velocities of the pose, `wheels` the commands in rad/s.
    `reach` is the distance of a wheel from the centre along x plus the distance along y, in m; `offset` is the pose of
    the base frame relative to the centre: x, y and angle.
    """

    def __init__(self, radius: float, reach: float, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        x, y, angle = offset
        cosine, sine = math.cos(angle), math.sin(angle)
        rows = []
        for across, around in ((-1.0, -reach), (1.0, reach), (-1.0, reach), (1.0, -reach)):
            turn = around + y - across * x  # for a rotation about the base frame instead of the centre
            rows.append((cosine + across * sine, across * cosine - sine, turn))
        super().__init__(rows, radius)

    def update(self, speeds: Sequence[float], dt: float) -> bool:
        """Integrate the wheel speeds in rad/s over `dt` s; return whether the time step was long enough."""
        if dt < MIN_DT:
            return False
        self.fit(speeds)
        self.heading += self.angular * dt
        along, across = math.cos(self.heading) * dt, math.sin(self.heading) * dt
        self.x += along * self.forward - across * self.left
        self.y += across * self.forward + along * self.left
        return True


class MecanumDriveController(HolonomicBase):
    """Controller of a base with four mecanum wheels; `kinematics` contains the pose."""

    title: ClassVar[str] = "Mecanum drive"
    reads: ClassVar[type[MecanumParams]] = MecanumParams
    sections: ClassVar[dict[str, type[object]]] = {
        "Limits: `linear.x.KEY`, `linear.y.KEY` and `angular.z.KEY`": TwistAxisLimits,
    }
    topic: ClassVar[str | None] = "reference"
    sample_type: ClassVar[type[Sample] | None] = MecanumSample
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
        params, (odom, base) = self.params, self.frame_ids()
        front_left, front_right, rear_right, rear_left = params.commanded
        frozen = tuple(axis for axis, limit in zip(HOLONOMIC, params.limits, strict=True) if limit.freezes)
        sides = ((front_left, rear_left), (front_right, rear_right))
        return DriveGeometry(
            *sides, 0.0, params.radius, odom, base, params.enable_odom_tf, frozen, "kinematics.wheels_radius"
        )

    def on_configure(self, params: Params) -> None:
        self.params = settings = read_checked(params, MecanumParams)
        self.kinematics = MecanumKinematics(settings.radius, settings.reach, settings.offset)
        self.move_by(self.kinematics)
        self.joints, self.interface = settings.commanded, VELOCITY
        self.set_up(settings, settings.reference_timeout, len(self.joints), settings.limits)

    def on_set(self, params: Params) -> None:
        settings = read_checked(params, MecanumParams)
        self.apply_parameters(settings, settings.reference_timeout, settings.limits)
        self.params = settings

    def state_interface_names(self) -> list[str]:
        return [f"{joint}/{VELOCITY}" for joint in self.params.measured]

    def advance(self, dt: float) -> None:
        for index in range(len(self._speeds)):
            self._speeds[index] = self.states[index].value
        self.kinematics.update(self._speeds, dt)

    def snapshot(self) -> None:
        super().snapshot()
        for index in range(len(self._reading)):
            self._reading[index] = self.states[index].value
        for index in range(len(self._reference)):
            self._reference[index] = self.desired[index]

    def sample(self, wall_offset_ns: int) -> OdometrySample | None:
        odometry = self.odometry_sample(wall_offset_ns)
        if odometry is None:
            return None
        front_left, front_right, rear_right, rear_left = (finite(value) for value in self._reading)
        wheels = [front_left, rear_left, rear_right, front_right]
        return grown(MecanumSample, odometry, wheels=wheels, reference=[finite(value) for value in self._reference])
