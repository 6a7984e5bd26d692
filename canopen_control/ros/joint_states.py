"""`/joint_states` of the joint state broadcaster, one message per sample of the state stream.

The law of the file (joint_state_broadcaster, Jazzy): published only while the broadcaster is active, on the topic and
in the frame that it tells; the joints in the broadcaster's order, and of them what it reads; what is not known is
nan; the stamp is the time of the sample.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState

from canopen_control.ros.conversions import joint_arrays, stamp_of, told_joints
from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.qos import SYSTEM_DEFAULT

if TYPE_CHECKING:
    from canopen_control.ros.conversions import ControllerView
    from canopen_control.ros.endpoint import Ros

__all__ = ["JointStates", "time_message"]


def time_message(unix_s: float) -> Time:
    """Return a time in Unix seconds as a message."""
    seconds, nanoseconds = stamp_of(unix_s)
    return Time(sec=seconds, nanosec=nanoseconds)


class JointStates(Endpoint):
    """The publisher of one broadcaster; the message is made once and filled again."""

    def __init__(self, ros: Ros, controller: ControllerView) -> None:
        self._ros, self._controller = ros, controller
        self._publisher = ros.node.create_publisher(JointState, controller.published("joint_states"), SYSTEM_DEFAULT)
        self._message = JointState()
        self.on_controller(controller)

    def on_controller(self, controller: ControllerView) -> None:
        """Follow its state, its joints and its frame."""
        self._controller = controller
        self._message.header.frame_id = controller.frame_id

    def on_state(self, state: dict[str, Any]) -> None:
        """Publish a sample."""
        if not self._controller.active:
            return
        controller, message = self._controller, self._message
        message.header.stamp = time_message(state["time"])
        message.name, message.position, message.velocity, message.effort = joint_arrays(
            told_joints(state["joints"], controller), controller.joints
        )
        self._publisher.publish(message)

    def close(self) -> None:
        """Leave the topic."""
        self._ros.node.destroy_publisher(self._publisher)
