"""`/<controller>/commands` of the forward controllers: Float64MultiArray, one number per joint.

The law of the file (forward_command_controller, Jazzy): only `data` counts, in the order of the joints. A value that is
not finite, or a wrong number of them, drops the message; the runtime would refuse it as well.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from std_msgs.msg import Float64MultiArray

from canopen_control.ros.conversions import wrong
from canopen_control.ros.endpoint import COMMANDER, Endpoint
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.rpc.messages.robot import CommandController

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.state import ControllerReading

__all__ = ["ForwardCommands"]


class ForwardCommands(Endpoint):
    """The subscription of one forward controller."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._controller = ros, controller
        self._subscription = ros.subscribe(
            Float64MultiArray, f"{controller.name}/commands", self._on_message, SYSTEM_DEFAULT
        )

    def on_controller(self, controller: ControllerReading) -> None:
        """Know whether it is active, and how many joints it has."""
        self._controller = controller

    def close(self) -> None:
        """Leave the topic."""
        self._ros.unsubscribe(self._subscription)

    def _on_message(self, message: Float64MultiArray) -> None:
        values = list(message.data)
        refusal = wrong(values, self._controller)
        if refusal is not None:
            self._ros.warn(f"{self._controller.name}/commands", refusal)
            return
        self._ros.command(
            CommandController(controller=self._controller.name, values=values, source=COMMANDER, dead_man=True)
        )
