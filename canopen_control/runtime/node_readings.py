"""Nodes and events in the form used in the status and the state samples for clients."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402.modes import mode_name
from canopen_control.master.event_log import Level
from canopen_control.rpc.messages.state import AxisReading, NodeReading, RobotEvent, SdoCounts

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from canopen_control.hardware.device_parts import DeviceParts
    from canopen_control.hardware.joint import JointDrive
    from canopen_control.hardware.system import CanopenSystem
    from canopen_control.master.event_log import Event, EventLog
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.runtime.robot_bus import RobotBus


_MAX_EVENTS: Final = 50
_LEVELS: Final = {level: level.name.lower() for level in Level}


class EventReadings:
    """Latest events of an event log as client messages, cached until the log changes."""

    def __init__(self, log: EventLog) -> None:
        self._log = log
        self._version = -1, 0
        self._messages: list[RobotEvent] = []

    def at(self, wall_offset_ns: int) -> list[RobotEvent]:
        """Return the events, oldest first, with times in Unix s. Do not modify the list."""
        version = self._log.version, wall_offset_ns
        if version != self._version:
            self._version = version
            self._messages = [event_message(event, wall_offset_ns) for event in self._log.recent[-_MAX_EVENTS:]]
        return self._messages


def event_message(event: Event, wall_offset_ns: int) -> RobotEvent:
    """Convert an event to a message for clients, with times in Unix s."""
    several = event.count >= 2
    since = event.time if event.since is None else event.since
    return RobotEvent(
        time=(event.time + wall_offset_ns) / 1e9,
        kind=event.kind,
        node=event.node or None,
        level=_LEVELS[event.level],
        text=event.sentence,
        count=event.count if several else 1,
        since=(since + wall_offset_ns) / 1e9 if several else None,
        details=event.details,
        controller=event.controller or None,
    )


class NodeReadings:
    """State of all nodes of a robot as messages for clients, by node name."""

    def __init__(
        self,
        nodes: Mapping[str, RemoteNode],
        buses: Mapping[str, RobotBus],
        joints: Collection[JointDrive],
        systems: Sequence[CanopenSystem],
    ) -> None:
        devices = [system.devices for system in systems]
        self._nodes = {
            name: _ReadNode(node, buses[name].name, [joint for joint in joints if joint.node is node], devices)
            for name, node in nodes.items()
        }

    def at(self, now: int) -> dict[str, NodeReading]:
        """Return the state of every node at `now`, in ns."""
        return {name: node.at(now) for name, node in self._nodes.items()}


class _ReadNode:
    """State of one node as a client message; its parts are cached until their inputs change."""

    def __init__(
        self, node: RemoteNode, bus: str, joints: Sequence[JointDrive], devices: Sequence[DeviceParts]
    ) -> None:
        self._node, self._bus, self._joints, self._devices = node, bus, joints, devices
        self._values: tuple[object, ...] = ()
        self._nmt_state: str | None = None
        self._sdo = SdoCounts()
        self._axes: tuple[AxisReading, ...] = ()
        self._void: tuple[str, ...] = ()

    def at(self, now: int) -> NodeReading:
        node = self._node
        values = self._inputs()
        if values != self._values:
            self._values = values
            self._gather()
        age = node.age_ns(now)
        return NodeReading(
            name=node.name,
            node_id=node.node_id,
            bus=self._bus,
            nmt_state=self._nmt_state,
            ready=node.ready,
            age=None if age is None else age / 1e9,
            taken_out=node.is_taken_out,
            error=node.error,
            sdo=self._sdo,
            axes=self._axes,
            void_outputs=self._void,
            unsupervised=node.plan.unsupervised,
            fault=node.active_fault,
        )

    def _inputs(self) -> tuple[object, ...]:
        """Return the inputs of the cached parts."""
        node = self._node
        values: list[object] = [node.nmt_state, node.error, node.sdo_reads, node.sdo_writes, node.sdo_failed]
        for joint in self._joints:
            machine = joint.machine
            values += (joint.state, joint.statusword, _mode(joint), machine.state, joint.fault)
        for device in self._devices:
            values += device.void_outputs(node)
        return tuple(values)

    def _gather(self) -> None:
        node = self._node
        self._nmt_state = node.nmt_state.name if node.nmt_state is not None else None
        self._sdo = SdoCounts(node.sdo_reads, node.sdo_writes, node.sdo_failed)
        self._axes = tuple(map(_axis, self._joints))
        self._void = tuple(name for device in self._devices for name in device.void_outputs(node))


def _mode(joint: JointDrive) -> int | None:
    """Return the mode of operation that a drive displays (0x6061), else the requested mode, else None."""
    request = joint.machine.mode_request
    # some drives show 0 (no mode) until they are enabled
    hidden = not joint.machine.enabled and request.missed != request.mode
    unshown = request.display is None or (request.display == 0 and hidden)
    return request.mode if request.mode is None or unshown else request.display


def _axis(joint: JointDrive) -> AxisReading:
    state, mode, fault = joint.state, _mode(joint), joint.fault
    return AxisReading(
        joint.joint,
        joint.axis.number,
        state.name if state is not None else None,
        joint.statusword if state is not None else None,
        mode_name(mode) if mode is not None else None,
        None if fault is None else joint.node.error or fault.code_text or None,
        fault,
    )
