"""`~/controller_state` of a controller and topics like it: a message for each update that the state stream carries.

A message is made only where somebody listens, and one object serves for all of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from canopen_control.ros.endpoint import Endpoint, NewSamples
from canopen_control.ros.interfaces import interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.rpc.messages.samples import Sample

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.state import ControllerReading, StateSample


S = TypeVar("S", bound=Sample)


class ControllerStateTopic(Endpoint, ABC, Generic[S]):
    """The publisher of the samples of one `kind`, as messages named `message`; `fill` puts a sample into one."""

    def __init__(
        self, ros: Ros, controller: ControllerReading, kind: type[S], message: str, topic: str = "controller_state"
    ) -> None:
        self._ros, self._controller, self._samples = ros, controller.name, NewSamples(kind)
        self._message: Any = interface(message)()
        name = f"{controller.name}/{topic}"
        self._publisher = ros.node.create_publisher(type(self._message), name, SYSTEM_DEFAULT)

    @abstractmethod
    def fill(self, message: Any, sample: S) -> None:  # noqa: ANN401 - a class made by somebody's generator
        """Put everything but the header's stamp into the message."""

    def on_state(self, state: StateSample) -> None:
        """Publish what is new."""
        sample, message = self._samples.of(state).get(self._controller), self._message
        if sample is None or not self._publisher.get_subscription_count():
            return
        message.header.stamp = time_message(sample.time)
        self.fill(message, sample)
        self._publisher.publish(message)

    def close(self) -> None:
        """Leave the topic."""
        self._ros.node.destroy_publisher(self._publisher)
