"""What steering and mecanum controllers tell beside odometry: `~/tf_odometry` and `~/controller_state`.

The law of the file (ros2_controllers, Jazzy): wheels stand in the order that the message says; of the traction wheels
positions or velocities are told, as they are measured. What is not known is nan.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from canopen_control.ros.controller_state import ControllerState
from canopen_control.ros.conversions import unknown_as_nan
from canopen_control.ros.endpoint import Endpoint, NewSamples
from canopen_control.ros.frames import odometry_transform
from canopen_control.ros.interfaces import interface, put
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.rpc.messages.samples import MecanumSample, OdometrySample, SteeringSample

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros, RosMessage
    from canopen_control.rpc.messages.state import ControllerReading, StateSample

__all__ = ["MecanumState", "SteeringState", "TfOdometry"]


class TfOdometry(Endpoint):
    """`~/tf_odometry`: the transform of odometry alone, where it is broadcast at all."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._name, self._samples = ros, controller.name, NewSamples(OdometrySample)
        self._kind: Any = interface("tf2_msgs/msg/TFMessage")
        self._publisher = ros.node.create_publisher(self._kind, f"{self._name}/tf_odometry", SYSTEM_DEFAULT)

    def on_state(self, state: StateSample) -> None:
        """Publish what is new."""
        sample = self._samples.of(state).get(self._name)
        if sample is not None and sample.enable_odom_tf:
            self._publisher.publish(self._kind(transforms=[odometry_transform(self._ros, sample)]))

    def close(self) -> None:
        """Leave the topic."""
        self._ros.node.destroy_publisher(self._publisher)


class SteeringState(ControllerState[SteeringSample]):
    """The wheels of a steered base."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        super().__init__(ros, controller, SteeringSample, "control_msgs/msg/SteeringControllerStatus")

    def fill(self, message: RosMessage, sample: SteeringSample) -> None:
        """Put wheels and commands into the message."""
        message.header.frame_id = self._ros.frame(sample.frame_id)
        message.traction_wheels_position = _numbers(sample.traction_positions)
        message.traction_wheels_velocity = _numbers(sample.traction_velocities)
        message.steer_positions = _numbers(sample.steering)
        commands = _numbers(sample.traction_commands)
        put(message, linear_velocity_command=commands, traction_command=commands)  # the latter in newer ones
        message.steering_angle_command = _numbers(sample.steering_commands)


class MecanumState(ControllerState[MecanumSample]):
    """The wheels of a base on mecanum wheels, and the twist that is wanted."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        super().__init__(ros, controller, MecanumSample, "control_msgs/msg/MecanumDriveControllerState")

    def fill(self, message: RosMessage, sample: MecanumSample) -> None:
        """Put wheels and twist into the message."""
        message.header.frame_id = self._ros.frame(sample.frame_id)
        wheels, reference = _numbers(sample.wheels), message.reference_velocity
        message.front_left_wheel_velocity, message.back_left_wheel_velocity = wheels[0], wheels[1]
        message.back_right_wheel_velocity, message.front_right_wheel_velocity = wheels[2], wheels[3]
        reference.linear.x, reference.linear.y, reference.angular.z = _numbers(sample.reference)


def _numbers(values: list[float | None]) -> list[float]:
    return [unknown_as_nan(each) for each in values]
