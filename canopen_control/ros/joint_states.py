"""`/joint_states` of the joint state broadcaster, one message per update of it that the state stream carries.

Rules (joint_state_broadcaster, Jazzy): published only while the broadcaster is active, on the topic and
in the frame that it tells; the joints in the broadcaster's order, and of them what it reads; what is not known is
nan; the stamp is the time of the update.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState

from canopen_control.ros.conversions import arrays_of, stamp_of
from canopen_control.ros.endpoint import Endpoint, NewSamples
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.rpc.messages.samples import JointStatesSample

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.state import ControllerReading, StateSample


def time_message(unix_s: float) -> Time:
    """Return a time in Unix seconds as a message."""
    seconds, nanoseconds = stamp_of(unix_s)
    return Time(sec=seconds, nanosec=nanoseconds)


class JointStates(Endpoint):
    """The publisher of one broadcaster; the message is made once and filled again."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._name, self._samples = ros, controller.name, NewSamples(JointStatesSample)
        self._publisher = ros.node.create_publisher(JointState, controller.published("joint_states"), SYSTEM_DEFAULT)
        self._message = JointState()
        self.on_controller(controller)

    def on_controller(self, controller: ControllerReading) -> None:
        """Follow its frame."""
        self._message.header.frame_id = self._ros.frame(controller.frame_id)

    def on_state(self, state: StateSample) -> None:
        """Publish what is new."""
        sample = self._samples.of(state).get(self._name)
        if sample is None:
            return
        message = self._message
        message.header.stamp = time_message(sample.time)
        message.name, message.position, message.velocity, message.effort = arrays_of(sample.joints, sample.names)
        self._publisher.publish(message)

    def close(self) -> None:
        """Leave the topic."""
        self._ros.node.destroy_publisher(self._publisher)
