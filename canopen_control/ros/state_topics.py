"""Topics of the broadcasters: sensors, batteries, GPIO and interface values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from canopen_control.ros.controller_state import ControllerStateTopic
from canopen_control.ros.conversions import unknown_as_nan
from canopen_control.ros.endpoint import Endpoint, NewSamples
from canopen_control.ros.interfaces import MissingInterface, interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.rpc.messages.samples import (
    BatteriesSample,
    GpioSample,
    ImuSample,
    JointStatesSample,
    PoseSample,
    RangeSample,
    WrenchSample,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.ros.endpoint import Ros, RosMessage
    from canopen_control.rpc.messages.samples import BatteryReading, Values
    from canopen_control.rpc.messages.state import ControllerReading, StateSample


# `~/imu`, `~/range`, `~/wrench` and `~/pose` of the broadcasters of sensors.
#
# The law of the file (ros2_controllers, Jazzy): names, types and quality are upstream's; a message for each update of
# the broadcaster that the state stream carries; what is not known is nan.


class ImuTopic(ControllerStateTopic[ImuSample]):
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


class RangeTopic(ControllerStateTopic[RangeSample]):
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


class WrenchTopic(ControllerStateTopic[WrenchSample]):
    """The publisher of `~/wrench`."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        super().__init__(ros, controller, WrenchSample, "geometry_msgs/msg/WrenchStamped", "wrench")

    def fill(self, message: RosMessage, sample: WrenchSample) -> None:
        """Put the measurement into the message."""
        message.header.frame_id = self._ros.frame(sample.frame_id)
        _put(message.wrench.force, "xyz", sample.force)
        _put(message.wrench.torque, "xyz", sample.torque)


class PoseTopic(ControllerStateTopic[PoseSample]):
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


# `~/battery_state` and `~/raw_battery_states` of the battery state broadcaster.
#
# The law of the file (battery_state_broadcaster): the first is all batteries as one, a BatteryState, the second each by
# itself, a BatteryStateArray whose headers name the battery as their frame. What is not known is nan. A message is made
# only where somebody listens.


_MEASURED = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity", "percentage")
_TOLD = ("power_supply_status", "power_supply_health", "power_supply_technology", "present", "location",
         "serial_number")  # fmt: skip


class BatteryTopics(Endpoint):
    """The publishers of one broadcaster."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._name, self._samples = ros, controller.name, NewSamples(BatteriesSample)
        self._one: Any = interface("sensor_msgs/msg/BatteryState")
        make = ros.node.create_publisher
        self._together = make(self._one, f"{self._name}/battery_state", SYSTEM_DEFAULT)
        self._each: Any = None
        try:
            self._array: Any = interface("control_msgs/msg/BatteryStateArray")
        except MissingInterface as error:
            ros.leave_out(error.name)
        else:
            self._each = make(self._array, f"{self._name}/raw_battery_states", SYSTEM_DEFAULT)

    def on_state(self, state: StateSample) -> None:
        """Publish what is new."""
        sample = self._samples.of(state).get(self._name)
        if sample is None:
            return
        if self._together.get_subscription_count():
            self._together.publish(self._message(sample.together, sample.time))
        if self._each is not None and self._each.get_subscription_count():
            self._each.publish(
                self._array(battery_states=[self._message(each, sample.time) for each in sample.batteries])
            )

    def close(self) -> None:
        """Leave the topics."""
        for publisher in filter(None, (self._together, self._each)):
            self._ros.node.destroy_publisher(publisher)

    def _message(self, battery: BatteryReading, time: float) -> RosMessage:
        message = self._one()
        message.header.stamp, message.header.frame_id = time_message(time), battery.name
        for field in _MEASURED:
            setattr(message, field, unknown_as_nan(getattr(battery, field)))
        for field in _TOLD:
            setattr(message, field, getattr(battery, field))
        return message


# `~/gpio_states` of GPIO controllers and broadcasters: inputs and outputs of drives and <gpio> parts, by their names.
#
# The law of the file (gpio_controllers, Jazzy): a control_msgs/DynamicInterfaceGroupValues, published once per update;
# what is not known is nan. Bits are numbers, as 0x60FD and 0x60FE hold them.


class GpioStates(Endpoint):
    """The publisher of one controller."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._name, self._samples = ros, controller.name, NewSamples(GpioSample)
        self._message = interface("control_msgs/msg/DynamicInterfaceGroupValues")
        self._values = interface("control_msgs/msg/InterfaceValue")
        self._publisher = ros.node.create_publisher(self._message, f"{self._name}/gpio_states", SYSTEM_DEFAULT)

    def on_state(self, state: StateSample) -> None:
        """Publish what is new."""
        sample = self._samples.of(state).get(self._name)
        if sample is None:
            return
        parts = sample.parts
        values = [self._of(each) for each in parts.values()]
        message = self._message(interface_groups=list(parts), interface_values=values)
        message.header.stamp = time_message(sample.time)
        self._publisher.publish(message)

    def close(self) -> None:
        """Leave the topic."""
        self._ros.node.destroy_publisher(self._publisher)

    def _of(self, values: dict[str, float | None]) -> Any:  # noqa: ANN401 - a class made by somebody's generator
        known = [math.nan if value is None else value for value in values.values()]
        return self._values(interface_names=list(values), values=known)


# `/dynamic_joint_states` of the joint state broadcaster: every state interface that it reads, by joint and name.
#
# The law of the file (joint_state_broadcaster, Jazzy): published with `/joint_states`, on the topic that the
# broadcaster tells, with the same stamp and frame; what is not known is nan. Where it is told not to, there is no
# topic.


class DynamicJointStates(Endpoint):
    """The publisher of one broadcaster."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._controller, self._samples = ros, controller, NewSamples(JointStatesSample)
        self._message = interface("control_msgs/msg/DynamicJointState")
        self._values = interface("control_msgs/msg/InterfaceValue")
        topic = controller.published("dynamic_joint_states")
        self._publisher = ros.node.create_publisher(self._message, topic, SYSTEM_DEFAULT)

    def on_controller(self, controller: ControllerReading) -> None:
        """Follow its frame."""
        self._controller = controller

    def on_state(self, state: StateSample) -> None:
        """Publish what is new; nothing is made where nobody listens."""
        sample = self._samples.of(state).get(self._controller.name)
        if sample is None or not self._publisher.get_subscription_count():
            return
        joints = sample.joints
        message = self._message(joint_names=list(joints), interface_values=[self._of(each) for each in joints.values()])
        message.header.stamp = time_message(sample.time)
        message.header.frame_id = self._ros.frame(self._controller.frame_id)
        self._publisher.publish(message)

    def close(self) -> None:
        """Leave the topic."""
        self._ros.node.destroy_publisher(self._publisher)

    def _of(self, joint: Values) -> Any:  # noqa: ANN401 - a class made by somebody's generator
        values = [math.nan if value is None else value for value in joint.values()]
        return self._values(interface_names=list(joint), values=values)
