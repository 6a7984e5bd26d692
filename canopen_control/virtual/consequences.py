"""What follows from what a node's services say: of its NMT state, of a master that is silent, of its CAN controller.

The law of this file: a service only says what happened; what the device makes of it is here, until nothing more is
said. A lost communication, whichever way (0x1016, guarding, bus-off, a channel that is down), is one thing: the axes do
what 0x6007 says, the node what 0x1029:01 says (CiA 301, 7.5.2.29).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.bus.port import BusEventKind
from canopen_control.cia301.emcy_codes import ErrorRegister
from canopen_control.cia301.error_behaviour import reaction
from canopen_control.cia301.guarding import GuardingEventKind
from canopen_control.cia301.heartbeat import HeartbeatEventKind
from canopen_control.cia301.nmt import NmtResetRequested, NmtState, NmtStateChanged
from canopen_control.virtual.events import HeartbeatMissed

if TYPE_CHECKING:
    from canopen_control.virtual.node import VirtualNode

__all__ = ["HEARTBEAT_ERROR", "Consequences"]

OVERRUN, ERROR_PASSIVE, HEARTBEAT_ERROR, RECOVERED = 0x8110, 0x8120, 0x8130, 0x8140
_GONE = (BusEventKind.BUS_OFF, BusEventKind.DOWN, BusEventKind.CLOSED)


class Consequences:
    """Follows up what happened to `node`; `touched`: values changed which nobody wrote."""

    def __init__(self, node: VirtualNode) -> None:
        self._node = node
        self.touched = False
        self.settling = False
        self._off_the_bus = False

    def settle(self, now: int) -> None:
        """Follow up what the cores said until they say nothing more."""
        if self.settling:
            return
        node = self._node
        self.settling = True
        while events := [*node.nmt.events(), *node.consumer.events(), *node.guarding.events()]:
            for event in events:
                self._follow_up(event, now)
        node.sync.events()
        if self.touched:
            self.touched = False
            node.pdos.touched(now)
        self.settling = False

    def bus_event(self, kind: BusEventKind, now: int) -> None:
        """React to what happened to the node's CAN controller."""
        node = self._node
        if kind in _GONE:
            if not self._off_the_bus:
                self._off_the_bus = kind is BusEventKind.BUS_OFF
                self.communication_lost()
                self._stop_axes(now)
        elif kind is BusEventKind.ERROR_PASSIVE:
            node.emergency(ERROR_PASSIVE, ErrorRegister.COMMUNICATION)
        elif kind is BusEventKind.OVERRUN:
            node.report(OVERRUN, ErrorRegister.COMMUNICATION)
        else:
            node.clear_error(ERROR_PASSIVE)
            if self._off_the_bus:
                self._off_the_bus = False
                node.report(RECOVERED, ErrorRegister.COMMUNICATION, node.personality.communication_data)
        self.settle(now)

    def communication_lost(self) -> None:
        """Change the NMT state as 0x1029:01 says."""
        node = self._node
        command = reaction(node.store.number(0x1029, 1), node.nmt.state)
        if command is not None:
            node.nmt.command(command)

    def _stop_axes(self, now: int) -> None:
        for drive in self._node.drives.values():
            drive.connection_lost(now)

    def _follow_up(self, event: object, now: int) -> None:
        node = self._node
        if isinstance(event, NmtStateChanged):
            self._state_changed(event, now)
        elif isinstance(event, NmtResetRequested):
            node.reset(event.command, now)
        else:
            kind, node_id = getattr(event, "kind", None), getattr(event, "node_id", 0)
            if kind is HeartbeatEventKind.MISSED:
                self._silent(node_id, now)
            elif kind is GuardingEventKind.MISSED:
                self._silent(0, now)
            elif kind in (HeartbeatEventKind.RESOLVED, GuardingEventKind.RESOLVED):
                node.tell(HeartbeatMissed(node_id if kind is HeartbeatEventKind.RESOLVED else 0, missed=False))
                node.stop_missing()

    def _state_changed(self, event: NmtStateChanged, now: int) -> None:
        node, state = self._node, event.state
        node.tell(event)
        node.heartbeat.state = node.guarding.state = state
        node.emcy.allowed = state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL)
        if state is NmtState.OPERATIONAL:
            node.pdos.start(now)
        else:
            node.pdos.stop()
        if state is NmtState.STOPPED:
            node.sdo.reset()
            node.sync.reset()
        if state in (NmtState.STOPPED, NmtState.INITIALISING):
            for drive in node.drives.values():
                drive.communication_stopped(now)
        node.touch()

    def _silent(self, node_id: int, now: int) -> None:
        """0x1016 or life guarding: EMCY 0x8130, then as every lost communication."""
        node = self._node
        node.tell(HeartbeatMissed(node_id, missed=True))
        node.emergency(HEARTBEAT_ERROR, ErrorRegister.COMMUNICATION, node.personality.communication_data)
        self._stop_axes(now)
        self.communication_lost()
