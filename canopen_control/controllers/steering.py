"""Steering controllers: convert twists to speeds of traction wheels and angles of steered wheels.

Rules (ros2_controllers jazzy): odometry is updated and published in every update, with or without a twist. Without a
twist traction is 0 and the steered wheels keep their angle; a commanded zero twist steers them straight. In closed loop
the traction wheels turn at the speeds of the measured curve. Difference from upstream: with a `reference_timeout` of 0
a twist is valid for one update; no wheel turns faster than the desired curve needs, at any steering angle; the speed of
a base with two traction wheels is the fit to both (`SteeringKinematics.fits`); and missing feedback does not end the
controller, see `mobile_base`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from mypy_extensions import mypyc_attr

from canopen_control.controllers.base import ControllerState, DriveGeometry, finite
from canopen_control.controllers.mobile_base import MobileBase
from canopen_control.controllers.params import refuse
from canopen_control.controllers.steering_kinematics import SteeringKinematics
from canopen_control.controllers.steering_params import (
    AckermannParams,
    BicycleParams,
    SteeringParams,
    TricycleParams,
    is_ros1,
    read_params,
    read_ros1,
)
from canopen_control.rpc.messages.samples import SteeringSample, grown
from canopen_control.urdf.joint_element import POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.rpc.messages.samples import OdometrySample, Sample


@mypyc_attr(allow_interpreted_subclasses=True)
class SteeringController(MobileBase):
    """Base class of controllers with traction and steered wheels; `kinematics` contains the pose."""

    topic: ClassVar[str | None] = "reference"
    sample_type: ClassVar[type[Sample] | None] = SteeringSample
    timeout_key: ClassVar[str] = "reference_timeout"
    settable: ClassVar[tuple[str, ...]] = ("reference_timeout", "enable_odom_tf")
    reads: ClassVar[type[SteeringParams]] = SteeringParams

    def __init__(self, name: str, type_name: str = "") -> None:
        self.kinematics = SteeringKinematics(1.0, 1.0)
        super().__init__(name, type_name, self.kinematics)
        self.params = SteeringParams()
        self._traction: list[float] = []
        self._steering: list[float] = []
        self._reading: list[float] = []
        self._driven: list[float] = []

    def wheel_base(self) -> DriveGeometry:
        """Return the wheel geometry of the parameters, which list the right traction joint first."""
        params, (odom, base) = self.params, self.frame_ids()
        right, left = params.traction_joints_names[:1], params.traction_joints_names[1:]
        keys = (params.radius_key, "traction_track_width")
        separation = params.tracks[0]
        return DriveGeometry(left, right, separation, params.radius, odom, base, params.enable_odom_tf, (), *keys)

    def on_configure(self, params: Params) -> None:
        self.params = settings = self.read(params)
        self.kinematics = settings.fitted_kinematics()
        self.pose = self.kinematics
        self.joints = (*settings.traction_joints_names, *settings.steering_joints_names)
        count = len(self.joints)
        self._traction, self._steering = [0.0] * self.kinematics.traction_count, [0.0] * self.kinematics.steering_count
        self._reading, self._driven = [0.0] * count, [0.0] * count
        self.set_up(settings, settings.reference_timeout, count, settings.limits, open_loop=settings.open_loop)

    def read(self, params: Params) -> SteeringParams:
        """Return the checked parameters; raise RobotConfigError with all errors in them."""
        return read_params(params, self.reads)

    def on_set(self, params: Params) -> None:
        settings = self.read(params)
        self.apply_parameters(settings, settings.reference_timeout, settings.limits)
        self.params = settings

    def command_interface_names(self) -> list[str]:
        params = self.params
        traction = [f"{joint}/{VELOCITY}" for joint in params.traction_joints_names]
        return traction + [f"{joint}/{POSITION}" for joint in params.steering_joints_names]

    def state_interface_names(self) -> list[str]:
        params = self.params
        feedback = POSITION if params.position_feedback else VELOCITY
        traction = [f"{joint}/{feedback}" for joint in params.traction_states]
        return traction + [f"{joint}/{POSITION}" for joint in params.steering_states]

    def velocities(self) -> tuple[float, float, float]:
        return self.kinematics.linear, 0.0, self.kinematics.angular

    def compute_commands(self, twist: Sequence[float]) -> None:
        wheels, params = self.kinematics, self.params
        wheels.command(twist[0], twist[1], params.open_loop, params.reduce_wheel_speed_until_steering_reached)
        wheels.bound(twist[0], twist[1])
        count = wheels.traction_count
        for index in range(count):
            self.targets[index] = wheels.traction[index]
        for index in range(wheels.steering_count):
            self.targets[count + index] = wheels.steering[index]

    def begin(self) -> None:
        self._read()
        self.kinematics.begin(self._traction)
        self.kinematics.angle = self.kinematics.measured_angle(self._steering)

    def advance(self, dt: float) -> None:
        self._read()
        if self.params.position_feedback:
            self.kinematics.update_position(self._traction, self._steering, dt)
        else:
            self.kinematics.update_velocity(self._traction, self._steering, dt)

    def integrate_command(self, dt: float) -> None:
        self.kinematics.update_open_loop(self.limited[0], self.limited[1], dt)

    def _read(self) -> None:
        count = self.kinematics.traction_count
        for index in range(len(self._traction)):
            self._traction[index] = self.states[index].value
        for index in range(len(self._steering)):
            self._steering[index] = self.states[count + index].value

    def snapshot(self) -> None:
        super().snapshot()
        for index in range(len(self._reading)):
            self._reading[index] = self.states[index].value
            self._driven[index] = self.commands[index].value

    def sample(self, wall_offset_ns: int) -> OdometrySample | None:
        odometry = self.odometry_sample(wall_offset_ns)
        if odometry is None:
            return None
        count = self.kinematics.traction_count
        reading, driven = [finite(value) for value in self._reading], [finite(value) for value in self._driven]
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
    """Controller of a base with one traction wheel and one steered wheel."""

    title: ClassVar[str] = "Bicycle steering"
    reads: ClassVar[type[SteeringParams]] = BicycleParams


class TricycleSteeringController(SteeringController):
    """Controller of a base with two traction wheels and one steered wheel."""

    title: ClassVar[str] = "Tricycle steering"
    reads: ClassVar[type[SteeringParams]] = TricycleParams


class AckermannSteeringController(SteeringController):
    """Controller of a base with two traction wheels and two steered wheels.

    With the parameters of ROS 1's controller, the base has one wheel of each kind.
    """

    title: ClassVar[str] = "Ackermann steering"
    reads: ClassVar[type[SteeringParams]] = AckermannParams

    def read(self, params: Params) -> SteeringParams:
        if not is_ros1(params):
            return super().read(params)
        settings = read_ros1(params, self.geometry, self._report_size)
        refuse(params, settings.mistakes())
        return settings

    def _report_size(self, text: str) -> None:
        """Report, at configuration only, a dimension that is taken from the description."""
        if self.state is ControllerState.UNCONFIGURED:
            self.report("parameter", text)
