"""`~/commands` of a GPIO command controller: outputs of <gpio> parts by their names (DynamicInterfaceGroupValues).

The law of the file (gpio_controllers, Jazzy): a message names some outputs, the others stay. Ours: one that does not
fit (an unknown name, one named twice, as many names as values nowhere, a value that is not finite) is dropped whole
with a sentence, and the controller goes on. What comes while the robot has not answered yet is put together, the newest
value of each output, so that no flood waits and no output is lost. The outputs end with this bridge.
"""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING, Any

from canopen_control.ros.endpoint import COMMANDER, Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.rpc.messages.robot import CommandByName

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros, RosMessage
    from canopen_control.rpc.messages.state import ControllerReading

__all__ = ["GpioCommands", "outputs_of"]


class GpioCommands(Endpoint):
    """The subscription of one controller."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._controller, self._topic = ros, controller, f"{controller.name}/commands"
        self._lock = threading.Lock()
        self._coming: dict[str, float] = {}
        self._asking = False
        message: Any = interface("control_msgs/msg/DynamicInterfaceGroupValues")
        self._subscription = ros.subscribe(message, self._topic, self._on_message, SYSTEM_DEFAULT)

    def on_controller(self, controller: ControllerReading) -> None:
        """Know whether it is active, and its outputs; what waits for one that is not is gone."""
        self._controller = controller
        if not controller.active:
            with self._lock:
                self._coming.clear()

    def close(self) -> None:
        """Leave the topic."""
        self._ros.unsubscribe(self._subscription)

    def _on_message(self, message: RosMessage) -> None:
        try:
            values = outputs_of(message, self._controller)
        except ValueError as error:
            self._ros.warn(self._topic, f"{self._topic}: {error}; the message was dropped")
            return
        with self._lock:
            wake = not self._coming and bool(values)
            self._coming.update(values)
        if wake:
            self._ros.hand_over(self._send)

    def _send(self) -> None:
        """Have the robot set what has come, unless it has not answered yet."""
        if self._asking:
            return
        with self._lock:
            values, self._coming = self._coming, {}
        if values:
            self._asking = True
            request = CommandByName(controller=self._controller.name, values=values, source=COMMANDER, dead_man=True)
            self._ros.ask(request, self._on_answer)

    def _on_answer(self, _done: object, error: str | None) -> None:
        self._asking = False
        if error is not None:
            self._ros.warn(self._topic, f"{self._topic}: {error}")
        self._send()


def outputs_of(message: RosMessage, controller: ControllerReading) -> dict[str, float]:
    """Return the values of a message by "gpio/interface"; ValueError with why it cannot be taken."""
    if not controller.active:
        raise ValueError(f"{controller.name} is {controller.state}; activate it before commanding it")
    groups, inner = list(message.interface_groups), list(message.interface_values)
    if len(groups) != len(inner):
        raise ValueError(f"{len(groups)} interface_groups with {len(inner)} interface_values; give as many")
    known, found = controller.required_command_interfaces, dict[str, float]()
    for group, each in zip(groups, inner, strict=True):
        names, values = list(each.interface_names), list(each.values)
        if len(names) != len(values):
            raise ValueError(f"{group}: {len(names)} interface_names with {len(values)} values; give as many")
        for name, value in zip((f"{group}/{name}" for name in names), values, strict=True):
            if name not in known:
                raise ValueError(f"{name!r} is no output; there are: {', '.join(known) or 'none'}")
            if name in found:
                raise ValueError(f"{name} is named twice")
            if not math.isfinite(value):
                raise ValueError(f"{name} is {value}; give finite numbers")
            found[name] = float(value)
    return found
