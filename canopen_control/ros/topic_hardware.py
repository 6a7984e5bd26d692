"""The other end of joint_state_topic_hardware_interface: C++ controllers of another controller manager move our joints.

The law of the file (joint_state_topic_hardware_interface 1.1): JointState in both directions. A command counts for an
active forward controller when it holds a finite value for each of its joints in the array of its interface; a NaN,
which that package sends before one of its controllers is active, commands nothing. An array that is neither empty nor
as long as `name` cannot be assigned to joints, and the whole message is refused. Silence ends in the controller's own
timeout, so `trigger_joint_command_threshold` must be -1: otherwise that package is silent while nothing changes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from sensor_msgs.msg import JointState

from canopen_control.ros.conversions import joint_arrays
from canopen_control.ros.endpoint import COMMANDER, Endpoint
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import LATEST
from canopen_control.rpc.messages.robot import CommandController

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.state import StateSample


_INTERFACES: Final = ("position", "velocity", "effort")


class TopicHardware(Endpoint):
    """Both topics of one robot."""

    def __init__(self, ros: Ros, commands: str, states: str) -> None:
        self._ros, self._topic = ros, commands
        self._subscription = ros.subscribe(JointState, commands, self._on_message, LATEST)
        self._publisher = ros.node.create_publisher(JointState, states, LATEST)
        self._message = JointState()

    def on_state(self, state: StateSample) -> None:
        """Publish every joint; what is not known is nan, which that package ignores."""
        message = self._message
        message.header.stamp = time_message(state.time)
        message.name, message.position, message.velocity, message.effort = joint_arrays(state.joints)
        self._publisher.publish(message)

    def close(self) -> None:
        """Leave both topics."""
        self._ros.unsubscribe(self._subscription)
        self._ros.node.destroy_publisher(self._publisher)

    def _on_message(self, message: JointState) -> None:
        arrays = {name: list(getattr(message, name)) for name in _INTERFACES}
        try:
            values = commanded(list(message.name), arrays)
        except ValueError as error:
            self._ros.warn(self._topic, f"{self._topic}: {error}; the message was dropped")
            return
        for controller in self._ros.controllers.values():
            if not controller.active or controller.topic != "commands" or controller.interface is None:
                continue
            wanted = [values.get((joint, controller.interface)) for joint in controller.joints]
            command = [value for value in wanted if value is not None]
            if len(command) == len(wanted):
                self._ros.command(
                    CommandController(controller=controller.name, values=command, source=COMMANDER, dead_man=True)
                )


def commanded(names: list[str], arrays: dict[str, list[float]]) -> dict[tuple[str, str], float]:
    """Return the finite values by (joint, interface); ValueError when it is not clear which joint has which."""
    if len(set(names)) != len(names):
        raise ValueError("a joint is named twice")
    values = {}
    for interface, array in arrays.items():
        if len(array) not in (0, len(names)):
            raise ValueError(f"{interface} has {len(array)} values for {len(names)} joints")
        pairs = zip(names, array, strict=False)
        values.update({(name, interface): value for name, value in pairs if math.isfinite(value)})
    return values
