"""Host of virtual nodes on one port: many nodes in one process, with frames routed to their receivers.

In one turn the host reads all frames of the port, passes each frame to the nodes that receive its identifier, and
sends all answers together. One timer is used for all nodes; an idle drive costs only its heartbeat. Nodes of one host
receive each other's frames as on a wire, although a port does not receive its own frames. Without a bus the nodes
continue to run and react like drives that are off the bus, until `rejoin` sets another port.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.bus.port import BusEventKind
from canopen_control.bus.port_abilities import set_filter
from canopen_control.cia301.sdo_codec import deliver
from canopen_control.errors import BusClosed, BusError
from canopen_control.frame import RECORD, CanFrame, pack_records

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.bus.port import BusEvent, Port
    from canopen_control.host.reactor import Reactor
    from canopen_control.host.timer import Timer
    from canopen_control.virtual.virtual_node import VirtualNode


_ECHOES = 64  # deliveries between nodes of one host in one turn; more would be a storm


def _ignore(*_arguments: object) -> None:
    pass


class NodeIdTaken(BusError):
    """Error: another node on the bus already uses the node-ID."""

    def __init__(self, node_id: int, channel: str) -> None:
        self.node_id = node_id
        super().__init__(f"node-ID {node_id} already answers on {channel}; choose another --node-id, or stop that node")


class NodeHost:
    """Host that runs `nodes` on `port`; the nodes are powered on in the next iteration of the reactor.

    `on_event(node, event)` is called for events of a node, `on_bus_event` for events of the channel, and `on_closed`
    when the port is lost; `rejoin` then sets another port. The caller closes the port.
    """

    def __init__(
        self,
        reactor: Reactor,
        port: Port,
        nodes: Sequence[VirtualNode],
        *,
        on_event: Callable[[VirtualNode, object], object] = _ignore,
        on_bus_event: Callable[[BusEvent], object] = _ignore,
        on_closed: Callable[[BusClosed], object] = _ignore,
    ) -> None:
        self.reactor, self.port, self.nodes = reactor, port, list(nodes)
        self.on_event, self.on_bus_event, self.on_closed = on_event, on_bus_event, on_closed
        self._routes: dict[int, tuple[VirtualNode, ...]] = {}
        self._versions = dict.fromkeys(self.nodes, -1)
        self._deadlines: dict[VirtualNode, int | None] = dict.fromkeys(self.nodes, 0)
        self._touched: dict[VirtualNode, None] = {}  # nodes that received a frame or event in this turn
        self._timer: Timer | None = None
        self._timer_at: int | None = None
        self._writing = self._closed = self._off = False
        reactor.add_reader(port, self._on_readable)
        reactor.call_soon(self._on_timer)

    def close(self) -> None:
        """Remove the nodes from the reactor; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        self._release()
        if self._timer is not None:
            self._timer.cancel()

    def _release(self) -> None:
        if self._off:
            return
        self._off = True
        self.reactor.remove_reader(self.port)
        if self._writing:
            self.reactor.remove_writer(self.port)
            self._writing = False

    def rejoin(self, port: Port) -> None:
        """Continue on a new port of the channel; no effect while the current port works."""
        if self._closed or not self._off:
            return
        self.port, self._off = port, False
        self.reactor.add_reader(port, self._on_readable)
        set_filter(port, self._routes)
        self._notify_all(BusEventKind.UP)

    def wake(self, node: VirtualNode) -> None:
        """Send the frames of a node that a client has changed, and update the timer."""
        if not self._closed:
            self._finish({node: None})

    def _on_readable(self) -> None:
        try:
            records = self.port.receive()
        except BusClosed as error:
            self._lost(error)
            return
        now = self.reactor.now()
        touched = self._touched
        touched.clear()
        deliver(records, now, self._take_run, self._take)
        for event in self.port.events():
            self.on_bus_event(event)
            for node in self.nodes:
                node.bus_event(event.kind, now)
                touched[node] = None
        if touched:
            self._finish(touched)

    def _take(self, frame: CanFrame, now: int) -> None:
        self._deliver(frame, now, self._touched)

    def _take_run(self, records: bytes, start: int, now: int) -> int:
        """Pass SDO records from `start` on to the only receiver of their identifier; return how many it took."""
        can_id = RECORD.unpack_from(records, start)[0]
        listeners = self._routes.get(can_id, ())
        if len(listeners) != 1 or can_id != listeners[0].sdo.request_cob_id:
            return 0
        if count := listeners[0].receive_records(records, start, now):
            self._touched[listeners[0]] = None
        return count

    def _deliver(self, frame: CanFrame, now: int, touched: dict[VirtualNode, None], sender: object = None) -> None:
        for node in self._routes.get(frame.can_id, ()):
            if node is not sender and not node.receive_sync_rpdo(frame, now):
                node.receive(frame, now)
                touched[node] = None
                if node.routing.version != self._versions[node]:
                    self._reroute()

    def _on_timer(self) -> None:
        if self._closed:
            return
        self._timer = self._timer_at = None
        now = self.reactor.now()
        expired = [node for node, deadline in self._deadlines.items() if deadline is not None and deadline <= now]
        for node in expired:
            node.tick(now)
        self._finish(dict.fromkeys(expired))

    def _finish(self, touched: dict[VirtualNode, None]) -> None:
        for node in touched:
            if node.routing.version != self._versions[node]:
                self._reroute()
                break
        if len(self.nodes) > 1:
            self._send(self._collect(touched))
        elif touched and (frames := self.nodes[0].frames()):
            self._send(frames)
        for node in touched:
            if node.outbox.new_events:
                for event in node.events():
                    self.on_event(node, event)
            self._deadlines[node] = node.next_deadline()
        self._set_timer()

    def _collect(self, touched: dict[VirtualNode, None]) -> list[CanFrame]:
        """Deliver the frames of the nodes to the other nodes of this host, and return all frames to send."""
        outgoing: list[CanFrame] = []
        waiting = list(touched)
        echoes = 0
        while waiting:
            node = waiting.pop(0)
            frames = node.frames()
            outgoing += frames
            if frames and echoes < _ECHOES:
                receivers: dict[VirtualNode, None] = {}
                for frame in frames:
                    self._deliver(frame, self.reactor.now(), receivers, node)
                echoes += len(receivers)
                waiting += receivers
                touched.update(receivers)
        return outgoing

    def _send(self, frames: list[CanFrame]) -> None:
        if not frames or self._off:
            return
        try:
            self.port.send(pack_records(frames))
            if self.port.wants_write:
                self._watch_writing()
        except BusClosed as error:
            self._lost(error)

    def _watch_writing(self) -> None:
        if not self._writing:
            self._writing = True
            self.reactor.add_writer(self.port, self._on_writable)

    def _on_writable(self) -> None:
        try:
            self.port.flush()
        except BusClosed as error:
            self._lost(error)
            return
        if not self.port.wants_write:
            self._writing = False
            self.reactor.remove_writer(self.port)

    def _lost(self, error: BusClosed) -> None:
        if not self._off:
            self._release()
            self._notify_all(BusEventKind.CLOSED)
            self.on_closed(error)

    def _notify_all(self, kind: BusEventKind) -> None:
        for node in self.nodes:
            node.bus_event(kind, self.reactor.now())
        self._finish(dict.fromkeys(self.nodes))

    def _reroute(self) -> None:
        versions = {node: node.routing.version for node in self.nodes}
        if versions == self._versions:
            return
        self._versions = versions
        routes: dict[int, list[VirtualNode]] = {}
        for node in self.nodes:
            for can_id in node.routes():
                routes.setdefault(can_id, []).append(node)
        self._routes = {can_id: tuple(listeners) for can_id, listeners in routes.items()}
        if not self._off:
            set_filter(self.port, self._routes)

    def _set_timer(self) -> None:
        at: int | None = None
        for deadline in self._deadlines.values():
            if deadline is not None and (at is None or deadline < at):
                at = deadline
        if at == self._timer_at or self._closed:
            return
        if self._timer is not None:
            self._timer.cancel()
        self._timer_at = at
        self._timer = None if at is None else self.reactor.call_at(at, self._on_timer)
