"""`~/gpio_states` of GPIO controllers and broadcasters: inputs and outputs of drives and <gpio> parts, by their names.

The law of the file (gpio_controllers, Jazzy): a control_msgs/DynamicInterfaceGroupValues, published once per update;
what is not known is nan. Bits are numbers, as 0x60FD and 0x60FE hold them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from canopen_control.ros.endpoint import Endpoint, NewSamples
from canopen_control.ros.interfaces import interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.rpc.messages.samples import GpioSample

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.state import ControllerReading, StateSample

__all__ = ["GpioStates"]


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
