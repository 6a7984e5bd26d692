"""Error control of a node: the heartbeats it watches (0x1016), life guarding, and its CAN controller.

A lost communication, whichever way (0x1016, guarding, bus-off, a channel that is down), is one thing: the axes do what
0x6007 says, the node what 0x1029:01 says (CiA 301, 7.5.2.29).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from canopen_control.bus.port import BusEventKind
from canopen_control.cia301.emcy_codes import ErrorRegister
from canopen_control.cia301.error_behaviour import reaction
from canopen_control.cia301.guarding import GuardingEvent, GuardingEventKind
from canopen_control.cia301.heartbeat import HeartbeatEvent, HeartbeatEventKind
from canopen_control.virtual.node_events import HeartbeatMissed
from canopen_control.virtual.node_outbox import HEARTBEAT_ERROR

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.cia301.heartbeat import HeartbeatConsumer
    from canopen_control.cia301.nmt import NmtSlave
    from canopen_control.virtual.device_model import DeviceModel
    from canopen_control.virtual.node_outbox import NodeOutbox
    from canopen_control.virtual.object_store import ObjectStore

__all__ = ["Axis", "ErrorControl"]

OVERRUN, ERROR_PASSIVE, RECOVERED = 0x8110, 0x8120, 0x8140
_GONE = (BusEventKind.BUS_OFF, BusEventKind.DOWN, BusEventKind.CLOSED)


class Axis(Protocol):
    """What error control asks of an axis."""

    def connection_lost(self, now: int) -> None:
        """React to a lost communication."""


class ErrorControl:
    """Judges what `heartbeats` and the CAN controller say, and stops `axes` when the communication is lost."""

    def __init__(
        self,
        store: ObjectStore,
        nmt: NmtSlave,
        heartbeats: HeartbeatConsumer,
        outbox: NodeOutbox,
        model: DeviceModel,
        axes: Mapping[int, Axis],
    ) -> None:
        self._store, self._nmt, self._heartbeats, self._outbox = store, nmt, heartbeats, outbox
        self._model, self._axes = model, axes
        self._off_the_bus = False
        self.function: Axis | None = None  # of a device that is no drive

    def watch(self, wanted: Mapping[int, int]) -> None:
        """Watch the heartbeats of these nodes, node id to consumer time in ns, and of no others."""
        present = self._heartbeats.watched()
        for node_id in present.keys() - wanted.keys():
            self._heartbeats.unwatch(node_id)
            self._clear_if_all_heard()
        for node_id, timeout in wanted.items():
            if present.get(node_id) != timeout:
                self._heartbeats.watch(node_id, timeout)

    def follow(self, event: HeartbeatEvent | GuardingEvent, now: int) -> None:
        """React to what the heartbeat consumer or guarding found."""
        node_id = event.node_id if isinstance(event, HeartbeatEvent) else 0
        if event.kind in (HeartbeatEventKind.MISSED, GuardingEventKind.MISSED):
            self._outbox.tell(HeartbeatMissed(node_id, missed=True))
            self._outbox.emergency(HEARTBEAT_ERROR, ErrorRegister.COMMUNICATION, self._model.communication_data)
            self._stop_axes(now)
            self._leave_operational()
        elif event.kind in (HeartbeatEventKind.RESOLVED, GuardingEventKind.RESOLVED):
            self._outbox.tell(HeartbeatMissed(node_id, missed=False))
            self._clear_if_all_heard()

    def bus_event(self, kind: BusEventKind, now: int) -> None:
        """React to what happened to the node's CAN controller."""
        outbox = self._outbox
        if kind in _GONE:
            if not self._off_the_bus:
                self._off_the_bus = kind is BusEventKind.BUS_OFF
                self._leave_operational()
                self._stop_axes(now)
        elif kind is BusEventKind.ERROR_PASSIVE:
            outbox.emergency(ERROR_PASSIVE, ErrorRegister.COMMUNICATION)
        elif kind is BusEventKind.OVERRUN:
            outbox.report(OVERRUN, ErrorRegister.COMMUNICATION)
        else:
            outbox.clear_error(ERROR_PASSIVE)
            if self._off_the_bus:
                self._off_the_bus = False
                self.report_recovery()

    def report_recovery(self) -> None:
        """Say that the node was off the bus, and is back."""
        self._outbox.report(RECOVERED, ErrorRegister.COMMUNICATION, self._model.communication_data)

    def _clear_if_all_heard(self) -> None:
        """Clear the error of silent nodes when none is any more: heard again, or not watched."""
        if not any(self._heartbeats.is_missed(node_id) for node_id in self._heartbeats.watched()):
            self._outbox.clear_error(HEARTBEAT_ERROR)

    def _leave_operational(self) -> None:
        """Change the NMT state as 0x1029:01 says."""
        command = reaction(self._store.number(0x1029, 1), self._nmt.state)
        if command is not None:
            self._nmt.command(command)

    def _stop_axes(self, now: int) -> None:
        for axis in self._axes.values():
            axis.connection_lost(now)
        if self.function is not None:
            self.function.connection_lost(now)
