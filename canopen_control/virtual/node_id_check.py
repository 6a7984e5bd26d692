"""Check on the bus whether node ids are free, before virtual drives use them.

The question is an upload of 0x1000, which every node has; whoever answers it, or is heard with a heartbeat, holds the
id.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.lss import UNCONFIGURED
from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID
from canopen_control.cia301.sdo_codec import ANSWER_BASE, INITIATE, REQUEST_BASE, UPLOAD
from canopen_control.errors import BusError
from canopen_control.frame import CanFrame, frames_of, pack_records

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.bus.port import Port
    from canopen_control.host.reactor import Reactor


PROBE_NS = 40_000_000  # how long a node that is there already may take to answer
_DEVICE_TYPE = INITIATE.pack(UPLOAD, 0x1000, 0)


class NodeIdTaken(BusError):
    """Error: another node answers with the id."""

    def __init__(self, node_id: int, channel: str) -> None:
        self.node_id = node_id
        super().__init__(f"node id {node_id} already answers on {channel}; choose another --node-id, or end that node")


class NodeIdCheck:
    """Checks whether `node_ids` are free on `port`, from its creation on.

    A node without an id (255) holds none: CiA 305 lets any number of them wait for theirs on one bus.
    """

    def __init__(self, reactor: Reactor, port: Port, node_ids: Sequence[int]) -> None:
        self._reactor, self._port = reactor, port
        node_ids = [node_id for node_id in node_ids if node_id != UNCONFIGURED]
        self._answers = {
            base + node_id: node_id for node_id in node_ids for base in (ANSWER_BASE, ERROR_CONTROL_COB_ID)
        }
        self._taken: int | None = None
        self._until = reactor.now() + PROBE_NS
        port.send(pack_records([CanFrame(REQUEST_BASE + node_id, _DEVICE_TYPE) for node_id in node_ids]))

    def finish(self) -> None:
        """Wait for the remaining time; raise NodeIdTaken if another node answered."""
        self._reactor.add_reader(self._port, self._listen)
        self._reactor.run_until(lambda: self._taken is not None, max(0, self._until - self._reactor.now()))
        self._reactor.remove_reader(self._port)
        if self._taken is not None:
            raise NodeIdTaken(self._taken, self._port.channel)

    def _listen(self) -> None:
        for frame in frames_of(self._port.receive()):
            self._taken = self._answers.get(frame.can_id, self._taken)
