"""`~/imu`, `~/range`, `~/wrench` and `~/pose` of the broadcasters of sensors.

The law of the file (ros2_controllers, Jazzy): names, types and quality are upstream's; a message for each update of the
broadcaster that the state stream carries; what is not known is nan.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.ros.controller_state import ControllerState
from canopen_control.ros.conversions import unknown_as_nan
from canopen_control.rpc.messages.samples import ImuSample, PoseSample, RangeSample, WrenchSample

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.ros.endpoint import Ros, RosMessage
    from canopen_control.rpc.messages.state import ControllerReading

__all__ = ["ImuTopic", "PoseTopic", "RangeTopic", "WrenchTopic"]


class ImuTopic(ControllerState[ImuSample]):
    """The publisher of `~/imu`."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        super().__init__(ros, controller, ImuSample, "sensor_msgs/msg/Imu", "imu")

    def fill(self, message: RosMessage, sample: ImuSample) -> None:
        """Put the measurement into the message."""
        message.header.frame_id = self._ros.frame(sample.frame_id)
        _put(message.orientation, "xyzw", sample.orientation)
        _put(message.angular_velocity, "xyz", sample.angular_velocity)
        _put(message.linear_acceleration, "xyz", sample.linear_acceleration)
        message.orientation_covariance = sample.orientation_covariance
        message.angular_velocity_covariance = sample.angular_velocity_covariance
        message.linear_acceleration_covariance = sample.linear_acceleration_covariance


class RangeTopic(ControllerState[RangeSample]):
    """The publisher of `~/range`."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        super().__init__(ros, controller, RangeSample, "sensor_msgs/msg/Range", "range")

    def fill(self, message: RosMessage, sample: RangeSample) -> None:
        """Put the measurement into the message."""
        message.header.frame_id = self._ros.frame(sample.frame_id)
        message.range = unknown_as_nan(sample.range)
        message.radiation_type, message.field_of_view = sample.radiation_type, sample.field_of_view
        message.min_range, message.max_range = sample.min_range, sample.max_range
        if hasattr(message, "variance"):  # ROS has it since Iron
            message.variance = sample.variance


class WrenchTopic(ControllerState[WrenchSample]):
    """The publisher of `~/wrench`."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        super().__init__(ros, controller, WrenchSample, "geometry_msgs/msg/WrenchStamped", "wrench")

    def fill(self, message: RosMessage, sample: WrenchSample) -> None:
        """Put the measurement into the message."""
        message.header.frame_id = self._ros.frame(sample.frame_id)
        _put(message.wrench.force, "xyz", sample.force)
        _put(message.wrench.torque, "xyz", sample.torque)


class PoseTopic(ControllerState[PoseSample]):
    """The publisher of `~/pose`; its transform is on `/tf`, see `frames`."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        super().__init__(ros, controller, PoseSample, "geometry_msgs/msg/PoseStamped", "pose")

    def fill(self, message: RosMessage, sample: PoseSample) -> None:
        """Put the measurement into the message."""
        message.header.frame_id = self._ros.frame(sample.frame_id)
        _put(message.pose.position, "xyz", sample.position)
        _put(message.pose.orientation, "xyzw", sample.orientation)


def _put(into: RosMessage, axes: str, values: Sequence[float | None]) -> None:
    for axis, value in zip(axes, values, strict=True):
        setattr(into, axis, unknown_as_nan(value))
