"""`/dynamic_joint_states` of the joint state broadcaster: every state interface that it reads, by joint and name.

The law of the file (joint_state_broadcaster, Jazzy): published with `/joint_states`, on the topic that the broadcaster
tells, with the same stamp and frame; what is not known is nan. Where it is told not to, there is no topic.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from canopen_control.ros.conversions import told_joints
from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import SYSTEM_DEFAULT

if TYPE_CHECKING:
    from canopen_control.ros.conversions import ControllerView
    from canopen_control.ros.endpoint import Ros

__all__ = ["DynamicJointStates"]


class DynamicJointStates(Endpoint):
    """The publisher of one broadcaster."""

    def __init__(self, ros: Ros, controller: ControllerView) -> None:
        self._ros, self._controller = ros, controller
        self._message = interface("control_msgs/msg/DynamicJointState")
        self._values = interface("control_msgs/msg/InterfaceValue")
        topic = controller.published("dynamic_joint_states")
        self._publisher = ros.node.create_publisher(self._message, topic, SYSTEM_DEFAULT)

    def on_controller(self, controller: ControllerView) -> None:
        """Follow its state, its joints and its frame."""
        self._controller = controller

    def on_state(self, state: dict[str, Any]) -> None:
        """Publish a sample; nothing is made where nobody listens."""
        if not self._controller.active or not self._publisher.get_subscription_count():
            return
        told = told_joints(state["joints"], self._controller)
        message = self._message(joint_names=list(told), interface_values=[self._of(each) for each in told.values()])
        message.header.stamp, message.header.frame_id = time_message(state["time"]), self._controller.frame_id
        self._publisher.publish(message)

    def close(self) -> None:
        """Leave the topic."""
        self._ros.node.destroy_publisher(self._publisher)

    def _of(self, joint: dict[str, Any]) -> Any:  # noqa: ANN401 - a class made by somebody's generator
        values = [math.nan if value is None else float(value) for value in joint.values()]
        return self._values(interface_names=list(joint), values=values)
