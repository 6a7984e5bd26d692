"""`/dynamic_joint_states` of the joint state broadcaster: every state interface that it reads, by joint and name.

The law of the file (joint_state_broadcaster, Jazzy): published with `/joint_states`, on the topic that the broadcaster
tells, with the same stamp and frame; what is not known is nan. Where it is told not to, there is no topic.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from canopen_control.ros.endpoint import Endpoint, NewSamples
from canopen_control.ros.interfaces import interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.rpc.messages.samples import JointStatesSample

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.samples import Values
    from canopen_control.rpc.messages.state import ControllerReading, StateSample

__all__ = ["DynamicJointStates"]


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
