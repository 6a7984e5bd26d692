"""Which service of a virtual node takes which frames: a table by identifier, made anew when an identifier changes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.emcy_codes import ErrorRegister
from canopen_control.cia301.lss import MASTER_COB_ID
from canopen_control.cia301.nmt import NmtState
from canopen_control.cia301.sync import SyncEventKind
from canopen_control.frame import EXTENDED_FLAG, REMOTE_FLAG, Service, cob_id, is_restricted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.cia301.guarding import GuardingSlave
    from canopen_control.cia301.heartbeat import HeartbeatConsumer
    from canopen_control.cia301.nmt import NmtSlave
    from canopen_control.cia301.sdo_server import SdoServer
    from canopen_control.cia301.sync import SyncConsumer
    from canopen_control.frame import CanFrame
    from canopen_control.virtual.node_lss import NodeLss
    from canopen_control.virtual.node_outbox import NodeOutbox
    from canopen_control.virtual.node_pdos import ProcessData

    Receiver = Callable[[CanFrame, int], None]
    Holder = Callable[[CanFrame, int], bool]

__all__ = ["FrameRoutes", "merged"]

SYNC_LENGTH_ERROR = 0x8240


class FrameRoutes:
    """Receivers of one node by identifier, with linux/can.h's flags; `version` grows when the identifiers change.

    `holders` take what waits for SYNC without a consequence until then, and whose identifier has no other receiver.
    """

    def __init__(
        self,
        nmt: NmtSlave,
        sdo: SdoServer,
        consumer: HeartbeatConsumer,
        guarding: GuardingSlave,
        sync: SyncConsumer,
        pdos: ProcessData,
        lss: NodeLss | None,
        outbox: NodeOutbox,
        advance_drives: Callable[[int], None],
    ) -> None:
        self.table: dict[int, Receiver] = {}
        self.holders: dict[int, Holder] = {}
        self.version = 0
        self._nmt, self._sdo, self._consumer, self._guarding, self._sync = nmt, sdo, consumer, guarding, sync
        self._pdos, self._lss, self._outbox, self._advance_drives = pdos, lss, outbox, advance_drives

    @property
    def sdo_alone(self) -> bool:
        """Whether nobody but the SDO server takes its requests."""
        return self.table.get(self._sdo.request_cob_id) == self._on_sdo

    def begin(self) -> None:
        """Leave LSS alone in the table: a node that initialises hears nothing else."""
        self.table = self._lss_routes()
        self.holders = {}
        self.version += 1

    def rebuild(self) -> None:
        """Make the table anew: an identifier changed."""
        if self._nmt.state is NmtState.INITIALISING:
            return
        error_control = cob_id(Service.HEARTBEAT, self._nmt.node_id)
        consumer = self._consumer
        routes: list[tuple[int, Receiver]] = [
            *self._lss_routes().items(),
            (0x000, self._nmt.receive),
            (self._sdo.request_cob_id, self._on_sdo),
            (error_control | REMOTE_FLAG, self._guarding.receive),
            *self._sync_routes(),
            *((cob_id(Service.HEARTBEAT, node_id), consumer.receive) for node_id in consumer.watched()),
            *self._pdos.routes(),
        ]
        identifiers = [can_id for can_id, _ in routes]
        self.holders = {can_id: hold for can_id, hold in self._pdos.holders() if identifiers.count(can_id) == 1}
        table = merged(routes)
        if table.keys() != self.table.keys():
            self.version += 1
        self.table = table

    def _lss_routes(self) -> dict[int, Receiver]:
        return {} if self._lss is None else {MASTER_COB_ID: self._lss.receive}

    def _sync_routes(self) -> list[tuple[int, Receiver]]:
        """Return who takes SYNC; nobody where 0x1005 holds 0 or another identifier that is no SYNC's."""
        can_id = self._sync.cob_id
        return [] if not can_id & EXTENDED_FLAG and is_restricted(can_id) else [(can_id, self._on_sync)]

    def _on_sdo(self, frame: CanFrame, now: int) -> None:
        if self._nmt.state is not NmtState.STOPPED:
            self._sdo.receive(frame, now)

    def _on_sync(self, frame: CanFrame, now: int) -> None:
        if self._nmt.state is NmtState.STOPPED:
            return
        self._advance_drives(now)
        self._sync.receive(frame, now)
        events = self._sync.events()
        if len(events) > 1 and any(event.kind is SyncEventKind.LENGTH_ERROR for event in events):
            self._outbox.emergency(SYNC_LENGTH_ERROR, ErrorRegister.COMMUNICATION)
        else:
            self._outbox.clear_error(SYNC_LENGTH_ERROR)
        for event in events:
            if event.kind is SyncEventKind.SYNC and self._nmt.state is NmtState.OPERATIONAL:
                self._pdos.sync(event.counter, now)


def merged(routes: Iterable[tuple[int, Receiver]]) -> dict[int, Receiver]:
    """Return the table of routes; two receivers of one identifier both hear its frames, in the order of the routes."""
    table: dict[int, Receiver] = {}
    for can_id, receiver in routes:
        table[can_id] = _both(table[can_id], receiver) if can_id in table else receiver
    return table


def _both(first: Receiver, second: Receiver) -> Receiver:
    def receive(frame: CanFrame, now: int) -> None:
        first(frame, now)
        second(frame, now)

    return receive
