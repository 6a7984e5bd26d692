"""Publisher of a controller's samples, with one message for each publication by the controller.

Rules (ros2_controllers, Jazzy): names, types and quality of service of the topics are the same as upstream. One message
object is reused for all messages of a topic; a topic that is not `latched` is filled only if it has a subscriber.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from builtin_interfaces.msg import Time

from canopen_control.ros.conversions import stamp_of
from canopen_control.ros.endpoint import Endpoint, NewSamples
from canopen_control.ros.interfaces import interface
from canopen_control.ros.rcl import SYSTEM_DEFAULT
from canopen_control.ros.sample_topics import fill

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.ros.endpoint import NodeContext
    from canopen_control.ros.sample_topics import SampleTopic
    from canopen_control.rpc.messages.state import ControllerReading, StateSample


def time_message(unix_s: float) -> Time:
    """Convert Unix time in s to builtin_interfaces/msg/Time."""
    seconds, nanoseconds = stamp_of(unix_s)
    return Time(sec=seconds, nanosec=nanoseconds)


class RosMessages:
    """Factory of rclpy messages for `sample_topics.fill`."""

    def __init__(self, ros: NodeContext) -> None:
        self._ros = ros

    def empty(self, name: str) -> Any:  # noqa: ANN401 - a generated class
        """Return a new message of type `name`; raise MissingInterface if this ROS installation lacks the type."""
        return interface(name)()

    def floats(self, values: Iterable[float]) -> object:
        return list(values)

    def frame(self, name: str) -> str:
        return self._ros.frame(name)


class SamplePublisher(Endpoint):
    """Publisher of one `row` of `SAMPLE_TOPICS`; an optional topic is created with its first message."""

    def __init__(self, ros: NodeContext, controller: ControllerReading, row: SampleTopic) -> None:
        super().__init__(ros)
        self._row, self._controller, self._samples = row, controller, NewSamples(row.kind)
        self._messages = RosMessages(ros)
        self._message: Any = None
        self._publisher: Any = None
        if row.optional == "time":
            self._open()

    def _open(self) -> None:
        self._message = self._messages.empty(self._row.message)
        topic = self._row.name(self._controller)
        self._publisher = self.publisher(type(self._message), topic, SYSTEM_DEFAULT)

    def on_controller(self, controller: ControllerReading) -> None:
        self._controller = controller

    def on_state(self, state: StateSample) -> None:
        sample = self._samples.of(state).get(self._controller.name)
        if sample is None or getattr(sample, self._row.optional) is None:
            return
        if self._publisher is None:
            self._open()
        if self._row.latched or self._publisher.get_subscription_count():
            fill(self._messages, self._message, self._row, sample, self._controller.frame_id)
            self._publisher.publish(self._message)
