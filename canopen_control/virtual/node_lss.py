"""A virtual node's layer setting services: where its file says LSS_Supported, the node has an LSS slave (CiA 305).

The slave's node id is the pending one until a reset of communication takes it, and is gone with the power unless it was
stored. A node without an id (255) does nothing but LSS until it has one. A virtual bus has no bit rate: a new one is
told, kept and stored, nothing else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.lss import BIT_TIMINGS, LssIdentity
from canopen_control.cia301.lss_slave import LssActivateBitTiming, LssNodeIdAssigned, LssSlave
from canopen_control.virtual.node_events import BitRateActivated

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.frame import CanFrame
    from canopen_control.virtual.node_outbox import NodeOutbox
    from canopen_control.virtual.object_store import ObjectStore

__all__ = ["NodeLss"]


class NodeLss:
    """The LSS slave of a node; `stored_node_id` and `stored_bitrate` (bit/s, None: none) outlast the power.

    `assigned` is called with the first id of a node that had none; `stored` when what outlasts the power changed, it
    returns whether that is kept.
    """

    def __init__(
        self,
        store: ObjectStore,
        node_id: int,
        outbox: NodeOutbox,
        *,
        assigned: Callable[[int, int], None],
        stored: Callable[[], bool],
    ) -> None:
        self._store, self._outbox, self._assigned, self._stored = store, outbox, assigned, stored
        self.stored_node_id = node_id
        self.stored_bitrate: int | None = None
        rates = store.od.device.bit_rates
        timings = frozenset(index for index, rate in BIT_TIMINGS.items() if not rates or rate in rates)
        self.slave = LssSlave(LssIdentity(0, 0, 0, 0), node_id, bit_timings=timings, store=self._keep)

    def receive(self, frame: CanFrame, now: int) -> None:
        """Serve a frame of the LSS master."""
        self.slave.identity = LssIdentity(*(self._store.number(0x1018, part) for part in range(1, 5)))
        self.slave.receive(frame, now)
        for event in self.slave.events():
            if isinstance(event, LssNodeIdAssigned):
                self._assigned(event.node_id, now)
            elif isinstance(event, LssActivateBitTiming):
                self._outbox.tell(BitRateActivated(event.bitrate))

    def reset(self, *, power: bool) -> int:
        """Take the pending node id (a reset), or the stored one (a power-on); return it."""
        if power:
            self.slave.pending_node_id, self.slave.pending_bitrate = self.stored_node_id, self.stored_bitrate
        self.slave.reset()
        return self.slave.node_id

    def _keep(self, node_id: int, bitrate: int | None) -> bool:
        before = self.stored_node_id, self.stored_bitrate
        self.stored_node_id = node_id
        self.stored_bitrate = self.stored_bitrate if bitrate is None else bitrate
        if self._stored():
            return True
        self.stored_node_id, self.stored_bitrate = before
        return False
