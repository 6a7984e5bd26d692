"""Topics of each node, as in ros2_canopen's drivers, plus `emcy`.

`nmt_state` is the state reported by the node, in ros2_canopen's spelling, published on a change and transient local for
later subscribers; `joint_states` has the stamp of its sample. `rpdo` has one message per object of the node's TPDOs
(ros2_canopen names them from the master's side): all objects for a new subscriber, then the changed ones, once per
cycle of the robot; they are requested from the robot only while there is a subscriber. An object received on `tpdo` is
sent in the RPDO to which it is mapped, from the next cycle on, or by SDO if it is not mapped; objects that move a drive
are refused, because they belong to the controllers. A node without a joint has no `joint_states`. `emcy` has the node's
EMCY messages: a DiagnosticArray with a stamp and one status, whose message is the text and whose values are
`error_code` and `error_register` (hexadecimal) and `data` (bytes, hexadecimal).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from canopen_control.ros.conversions import joint_arrays
from canopen_control.ros.drive_services import DriveServices, DriveTargets
from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.ros.nodes import NMT_STATES, nodes_of, ros_name
from canopen_control.ros.rcl import EVENTS, LATCHED, LATEST
from canopen_control.ros.sample_publisher import time_message
from canopen_control.ros.sdo_services import Address, as_uint32, of_uint32, write_object
from canopen_control.rpc.messages.robot import GetLayout, GetNodes, PdoWrite

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import NodeContext
    from canopen_control.ros.nodes import RosNode
    from canopen_control.rpc.messages.layout import Layout
    from canopen_control.rpc.messages.robot import MappedValue, NodeListing
    from canopen_control.rpc.messages.state import ControllerReading, NodeReading, RobotEvent, StateSample


_AXIS: Final = 0x800  # offset between the objects of two axes (CiA 402-2)
#: controlword, mode of operation, targets of the modes, and homing method (CiA 402-2)
_MOVING: Final = frozenset((0x6040, 0x6060, 0x607A, 0x60FF, 0x6071, 0x6042, 0x60C1, 0x6098))
_LEVELS: Final = {"info": DiagnosticStatus.OK, "warning": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}


class DriveTopics(Endpoint):
    """Topics of one node, below the node's name or a controller's name."""

    def __init__(self, ros: NodeContext, node: RosNode) -> None:
        super().__init__(ros)
        self._view = node
        self._object = interface("canopen_interfaces/msg/COData")
        self._nmt = self.publisher(String, node.path("nmt_state"), LATCHED)
        self._joint_states = self.publisher(JointState, node.path("joint_states"), LATEST) if node.joints else None
        self._emcy = self.publisher(DiagnosticArray, node.path("emcy"), EVENTS)
        self._rpdo = self.publisher(self._object, node.path("rpdo"), EVENTS)
        self.subscribe(self._object, node.path("tpdo"), self._on_tpdo, EVENTS)
        self._published: str | None = None
        self._listeners = 0
        self._objects: dict[tuple[int, int], int] = {}

    def on_state(self, state: StateSample) -> None:
        self._count_listeners()
        node = state.nodes.get(self._view.name)
        if node is None:
            return
        self._publish_nmt(node)
        axes = node.axes
        if axes and self._joint_states is not None and self._joint_states.get_subscription_count():
            self._joint_states.publish(self._joints(state, [axis.joint for axis in axes]))

    def on_event(self, event: RobotEvent) -> None:
        if event.node == self._view.name and event.kind.startswith("emcy"):
            self._emcy.publish(self._emergency(event))

    def on_process_data(self, nodes: dict[str, list[MappedValue]]) -> None:
        if not self._listeners:
            return
        for mapped in nodes.get(self._view.name, ()):
            if len(mapped.data) > 4:
                continue  # larger than 32 bits, the size of COData
            value = self._objects[mapped.index, mapped.subindex] = as_uint32(mapped.data)
            self._rpdo.publish(self._object(index=mapped.index, subindex=mapped.subindex, data=value))

    def _count_listeners(self) -> None:
        """Request process data while `rpdo` has subscribers, and send all known objects to a new subscriber."""
        before, self._listeners = self._listeners, self._rpdo.get_subscription_count()
        if bool(before) is not bool(self._listeners):
            self._objects.clear()
            self._ros.watch_process_data(self, bool(self._listeners))
        if before and self._listeners > before:
            for (index, subindex), value in self._objects.items():
                self._rpdo.publish(self._object(index=index, subindex=subindex, data=value))

    def _publish_nmt(self, node: NodeReading) -> None:
        nmt_state = NMT_STATES.get(node.nmt_state, "ERROR")
        if nmt_state != self._published:
            self._published = nmt_state
            self._nmt.publish(String(data=nmt_state))

    def _joints(self, state: StateSample, joints: list[str]) -> JointState:
        """Return a JointState message; for a single axis the name is the node's, as in ros2_canopen."""
        message = JointState()
        message.header.stamp = time_message(state.time)
        names, message.position, message.velocity, message.effort = joint_arrays(state.joints, joints)
        message.name = [self._view.name] if len(joints) == 1 and names else names
        return message

    def _emergency(self, event: RobotEvent) -> DiagnosticArray:
        """Return an EMCY event as a message; a summary of several EMCY messages has no values."""
        level = _LEVELS.get(event.level, DiagnosticStatus.WARN)
        status = DiagnosticStatus(level=level, name=self._view.name, message=event.text)
        status.hardware_id = f"node {self._view.node_id}"
        if (fault := event.details) is not None:
            status.values = [KeyValue(key=key, value=value) for key, value in fault.values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = time_message(event.time)
        return message

    def _on_tpdo(self, message: Any) -> None:  # noqa: ANN401 - a generated class
        address, data = Address(message.index, message.subindex, ""), int(message.data)
        drive = self._view.is_drive or self._view.joints
        if drive and 0x6000 <= address.index < 0xA000 and 0x6000 + (address.index - 0x6000) % _AXIS in _MOVING:
            self._report(f"{address} moves the drive and belongs to the controllers; the message was dropped")
        else:
            self._ros.hand_over(lambda: self._write(address, data))

    def _write(self, address: Address, data: int) -> None:
        node, bits = self._view.name, self._view.rpdo.get((address.index, address.subindex))
        if bits is None:
            write_object(self._ros, node, address, lambda length: of_uint32(data, length), self._report)
            return
        try:
            value = of_uint32(data, (bits + 7) // 8)
        except ValueError as error:
            self._report(f"{address}: {error}")
            return
        request = PdoWrite(node=node, index=address.index, subindex=address.subindex, data=value)
        self._ros.ask(request, lambda _result, error: self._report(error))

    def _report(self, error: str | None) -> None:
        self.report(f"{self._view.name}/tpdo", error)


# `~/tpdo`, `~/rpdo`, `~/nmt_state` and services of ros2_canopen's device controllers, for the node of one joint.
#
# Rules (canopen_ros2_controllers): a CanopenProxyController has `~/nmt_reset_node`, `~/nmt_start_node`, `~/sdo_read`
# and `~/sdo_write` (upstream answers false to every SDO); a Cia402DeviceController has in addition the services of a
# drive, only for its own joint. These topics and services are the same as below the node's own name. If no node drives
# the joint, the joint's name may be the name of a node.


class ProxyNode(Endpoint):
    """Topics and services of one node, below the name of its CanopenProxyController."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller = controller
        self._parts: list[Endpoint] = []
        self._requested = self._closed = False

    def on_controller(self, controller: ControllerReading) -> None:
        """Find the node that drives the controller's joint; no effect before the controller is configured."""
        self._controller = controller
        if controller.joints and not self._requested:
            self._requested = True
            self._ask()

    def on_state(self, state: StateSample) -> None:
        for part in self._parts:
            part.on_state(state)

    def on_event(self, event: RobotEvent) -> None:
        for part in self._parts:
            part.on_event(event)

    def on_process_data(self, nodes: dict[str, list[MappedValue]]) -> None:
        for part in self._parts:
            part.on_process_data(nodes)

    def close(self) -> None:
        self._closed = True
        for part in self._parts:
            part.close()

    def own_joint(self) -> str | None:
        """Return the joint whose axis the services act on, or None if they act on all axes."""
        return None

    def _ask(self) -> None:
        def listed(listing: NodeListing | None, error: str | None) -> None:
            if listing is None:
                self._report(str(error))
            else:
                self._ros.ask(GetLayout(), lambda layout, _error: self._make(listing, layout))

        self._ros.ask(GetNodes(), listed)

    def _make(self, listing: NodeListing, layout: Layout | None) -> None:
        (joint,), name = self._controller.joints, self._controller.name
        node = next((node.name for node in listing.nodes if joint in node.joints), joint)
        namespace = str(self._ros.node.get_namespace())
        views = {view.name: view for view in nodes_of(listing, namespace, layout)}
        view = views.get(node)
        if view is None:
            self._report(f"no node drives joint {joint!r} or has this name; set `joint` to a joint or node of bus.yml")
        elif not self._closed:
            own_joint = self.own_joint()
            moved = () if own_joint is None else (own_joint,)
            below = view._replace(place=ros_name(name), namespace=namespace, remappings=(), joints=moved)
            self._parts = [DriveTopics(self._ros, below), DriveServices(self._ros, below, DriveTargets(), own_joint)]

    def _report(self, text: str) -> None:
        self._ros.warn(self._controller.name, f"{self._controller.name} has no topics: {text}")


class DeviceNode(ProxyNode):
    """Topics and services of one drive, below the name of its Cia402DeviceController."""

    def own_joint(self) -> str | None:
        return self._controller.joints[0]
