"""`/NODE/*` topics of each drive, as ros2_canopen's drivers have them, as far as the runtime's API carries them.

The law of the file: `nmt_state` is what the node's heartbeat says, told when it changes and kept for who comes later,
in ros2_canopen's words; `joint_states` has the stamp of its sample; `emcy` holds the node's EMCY messages in words.
`rpdo` has the statusword of each axis (0x6041, or its axis' offset) when it changes: the API carries no other object
as it came. `tpdo` is written by SDO, and an object that moves the drive is refused: those are the controllers'.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from sensor_msgs.msg import JointState
from std_msgs.msg import String

from canopen_control.ros.conversions import joint_arrays
from canopen_control.ros.diagnostics import log_message
from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.nodes import NMT_STATES
from canopen_control.ros.objects import Address, of_uint32
from canopen_control.ros.qos import EVENTS, LATCHED, LATEST
from canopen_control.ros.sdo import write_object

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros
    from canopen_control.ros.nodes import NodeView

__all__ = ["DriveTopics"]

_STATUSWORD: Final = 0x6041
_AXIS: Final = 0x800
#: controlword, mode, and what the modes take for a target (CiA 402)
_MOVING: Final = frozenset((0x6040, 0x6060, 0x607A, 0x60FF, 0x6071, 0x6042, 0x60C1, 0x6098))


class DriveTopics(Endpoint):
    """The topics of one node."""

    def __init__(self, ros: Ros, node: NodeView) -> None:
        self._ros, self._view = ros, node
        self._object, self._log = interface("canopen_interfaces/msg/COData"), interface("rcl_interfaces/msg/Log")
        make = ros.node.create_publisher
        self._nmt = make(String, node.path("nmt_state"), LATCHED)
        self._joint_states = make(JointState, node.path("joint_states"), LATEST)
        self._emcy = make(self._log, node.path("emcy"), EVENTS)
        self._rpdo = make(self._object, node.path("rpdo"), EVENTS)
        self._tpdo = ros.subscribe(self._object, node.path("tpdo"), self._on_tpdo, EVENTS)
        self._told: str | None = None
        self._statuswords: dict[int, int] = {}

    def on_state(self, state: dict[str, Any]) -> None:
        """Publish a sample of this node."""
        node = state["nodes"].get(self._view.name)
        if node is None:
            return
        self._publish_nmt(node)
        axes = node.get("axes") or ()
        for number, axis in enumerate(axes):
            self._publish_statusword(_STATUSWORD + _AXIS * number, axis.get("statusword"))
        if axes and self._joint_states.get_subscription_count():
            self._publish_joints(state, [str(axis["joint"]) for axis in axes])

    def on_event(self, event: dict[str, Any]) -> None:
        """Publish an EMCY message of this node."""
        if event.get("node") == self._view.name and str(event.get("kind")).startswith("emcy"):
            self._emcy.publish(log_message(self._log, event, self._ros.robot))

    def close(self) -> None:
        """Leave the topics."""
        self._ros.unsubscribe(self._tpdo)
        for publisher in (self._nmt, self._joint_states, self._emcy, self._rpdo):
            self._ros.node.destroy_publisher(publisher)

    def _publish_nmt(self, node: dict[str, Any]) -> None:
        told = NMT_STATES.get(node.get("nmt_state"), "ERROR")
        if told != self._told:
            self._told = told
            self._nmt.publish(String(data=told))

    def _publish_statusword(self, index: int, statusword: int | None) -> None:
        if statusword is not None and self._statuswords.get(index) != statusword:
            self._statuswords[index] = statusword
            self._rpdo.publish(self._object(index=index, subindex=0, data=statusword))

    def _publish_joints(self, state: dict[str, Any], joints: list[str]) -> None:
        """Publish the state under the node's name, as ros2_canopen does; with several axes, the joints' names."""
        message = JointState()
        message.header.stamp = time_message(state["time"])
        names, message.position, message.velocity, message.effort = joint_arrays(state["joints"], joints)
        message.name = [self._view.name] if len(joints) == 1 and names else names
        self._joint_states.publish(message)

    def _on_tpdo(self, message: Any) -> None:  # noqa: ANN401 - a class made by somebody's generator
        node, address, data = self._view.name, Address(message.index, message.subindex, ""), int(message.data)

        def told(error: str | None) -> None:
            if error is not None:
                self._ros.warn(f"{node}/tpdo", f"{node}/tpdo: {error}")

        if 0x6000 <= address.index < 0xA000 and 0x6000 + (address.index - 0x6000) % _AXIS in _MOVING:
            told(f"{address} moves the drive, and belongs to the controllers; the message was dropped")
            return
        self._ros.hand_over(
            lambda: write_object(self._ros, node, address, lambda length: of_uint32(data, length), told)
        )
