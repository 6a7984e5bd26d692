"""Blocking calls for SDO, NMT and LSS on a bus without a running master.

The protocol cores implement the services; this module only transfers their frames and waits for the end of a request.
An SDO server has only one client: do not use the nodes of a running robot. If a wait is interrupted, for example by
Ctrl-C, the transfer is aborted, so that no server remains in the middle of a transfer.
"""

from __future__ import annotations

import select
import time
from functools import partial
from typing import TYPE_CHECKING, Protocol

from canopen_control.bus.channel import open_port
from canopen_control.bus.port import BusEventKind
from canopen_control.cia301.lss import LssMaster
from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NmtMaster, NmtState, NmtUnconfirmed, state_of_byte
from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.cia301.sdo_codec import SHORTEST_RUN, deliver
from canopen_control.errors import BusClosed, BusError, BusOff, CanopenError, SdoStopped, SdoTimeout
from canopen_control.frame import BROADCAST, MAX_NODE_ID, RECORD, RECORD_SIZE, CanFrame, pack_records

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from types import TracebackType

    from canopen_control.bus.port import Port
    from canopen_control.cia301.lss import LssRequest, LssResult
    from canopen_control.cia301.nmt import NmtCommand, NmtConfirmed
    from canopen_control.cia301.sdo_exchange import SdoRequest


_BOOT_UP = b"\0"
FLUSH_S = 1.0  # time for sending the last frames before the port is closed
_FIRST_HEARTBEAT, _LAST_HEARTBEAT = ERROR_CONTROL_COB_ID + 1, ERROR_CONTROL_COB_ID + MAX_NODE_ID
_FEW = (SHORTEST_RUN - 1) * RECORD_SIZE  # bytes; too few frames for a block transfer run
PARALLEL = 16  # servers used in parallel by `read_many`: as many as a slow bus can serve within one timeout


class FrameListener(Protocol):
    """Interface of an object that only receives frames."""

    def receive(self, frame: CanFrame, now: int) -> None:
        """Process a frame received at `now`, in monotonic ns."""


class Core(FrameListener, Protocol):
    """Interface of a protocol core, such as an SDO client, that `DirectBus.serve` drives."""

    def tick(self, now: int) -> None:
        """Process timeouts up to `now`, in monotonic ns."""

    def next_deadline(self) -> int | None:
        """Return the time of the next `tick` in monotonic ns, or None if not needed."""

    def frames(self) -> list[CanFrame]:
        """Return and clear the frames to send."""


class DirectBus:
    """Port of a bus, with blocking calls for SDO, NMT and LSS services.

    `states` maps each node-ID to the NMT state in its last boot-up, heartbeat or guarding answer. `timeout_s` is the
    timeout of an SDO answer. `listeners` receive every frame. Every call raises BusError when the bus is lost.
    """

    def __init__(self, port: Port, *, timeout_s: float = 0.5, retries: int = 1) -> None:
        self.port = port
        self.timeout_s, self.retries = timeout_s, retries
        self.states: dict[int, NmtState | None] = {}
        self.listeners: list[FrameListener] = []
        self._clients: dict[int, SdoClient] = {}
        self._poll = select.poll()
        self._fd = port.fileno()
        self._poll.register(self._fd, select.POLLIN)
        self._watches_writing = False
        self._errors = port.stats.errors
        self._down = ""  # reason why the interface is down, "" if it is up
        self._cancelled = False

    @classmethod
    def open(
        cls, channel: str, *, label: str = "direct", timeout_s: float = 0.5, retries: int = 1, join: bool = True
    ) -> DirectBus:
        """Open a channel; `join` is passed to `open_port`.

        Raise ConfigError for an invalid channel name, BusError if the channel cannot be opened.
        """
        return cls(open_port(channel, label=label, join=join), timeout_s=timeout_s, retries=retries)

    def __enter__(self) -> DirectBus:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Send the remaining frames, then close the port; a second call does nothing."""
        try:
            deadline = time.monotonic() + FLUSH_S
            while (self.port.wants_write or self.port.stats.queued) and time.monotonic() < deadline:
                self._wait(10_000_000)
                self._receive([], time.monotonic_ns())
        except CanopenError:
            pass  # the bus is lost
        self.port.close()

    # -- SDO

    def read(self, node_id: int, index: int, subindex: int = 0, *, block: bool = False) -> bytes:
        """Upload an object by SDO; raise SdoAbort, SdoTimeout or another RemoteProtocolError on failure."""
        client = self.client(node_id)
        return self._transfer(client, client.read(index, subindex, block=block, now=time.monotonic_ns()))

    def write(self, node_id: int, index: int, subindex: int, data: bytes, *, block: bool | None = None) -> None:
        """Download an object by SDO; if `block` is None, the length selects the transfer. Errors as in `read`."""
        client = self.client(node_id)
        self._transfer(client, client.write(index, subindex, data, block=block, now=time.monotonic_ns()))

    def read_many(
        self, addresses: Iterable[tuple[int, int, int]], *, timeout_s: float | None = None
    ) -> dict[tuple[int, int, int], bytes | CanopenError]:
        """Upload objects (node_id, index, subindex) from many nodes in parallel; return the data or error of each.

        `timeout_s` is the timeout of each answer, None for that of the bus.
        """
        timeout = None if timeout_s is None else round(timeout_s * 1e9)
        by_node: dict[int, list[tuple[int, int]]] = {}
        for node_id, index, subindex in addresses:
            by_node.setdefault(node_id, []).append((index, subindex))
        nodes = list(by_node)
        answers: dict[tuple[int, int, int], bytes | CanopenError] = {}
        for start in range(0, len(nodes), PARALLEL):
            batch = nodes[start : start + PARALLEL]
            requests = [
                (node_id, self.client(node_id).read(*address, timeout_ns=timeout))
                for node_id in batch
                for address in by_node[node_id]
            ]
            self.serve([self.client(node_id) for node_id in batch], partial(_all_done, requests))
            for node_id, request in requests:
                answers[node_id, request.index, request.subindex] = self._error(request) or request.data
        return answers

    def client(self, node_id: int) -> SdoClient:
        """Return the SDO client of a node, which is created once so that late responses are recognised."""
        client = self._clients.get(node_id)
        if client is None:
            client = SdoClient(node_id, timeout_ns=round(self.timeout_s * 1e9), retries=self.retries)
            self._clients[node_id] = client
        return client

    def cancel(self) -> None:
        """Cancel the SDO transfer in progress, so that its call raises SdoCancelled; any thread may call this."""
        self._cancelled = True

    def _transfer(self, client: SdoClient, request: SdoRequest) -> bytes:
        self._cancelled = False
        try:
            self._run(client, request)
        except BaseException:
            client.cancel_all(BusClosed(self.port.channel, "interrupted"))
            self.port.send(pack_records(client.frames()))
            raise
        client.events()
        if (error := self._error(request)) is not None:
            raise error
        return request.data

    def _error(self, request: SdoRequest) -> CanopenError | None:
        """Return a request's error, or None; a timeout is a BusError if the bus is down, SdoStopped in STOPPED."""
        error = request.error
        if isinstance(error, SdoTimeout) and self._down:
            return BusError(f"{self._down}; node {error.node_id} could not be read")
        if isinstance(error, SdoTimeout) and self.states.get(error.node_id) is NmtState.STOPPED:
            return SdoStopped(error)
        return error

    def _run(self, client: SdoClient, request: SdoRequest) -> None:
        """Drive one SDO client until a request has ended; about a third faster than `serve`."""
        cores = (client,)
        now = time.monotonic_ns()
        while True:
            if self._cancelled:
                client.cancel_transfer(request)
            if out := client.frames():
                self.port.send(pack_records(out))
            if request.done:
                return
            deadline = client.next_deadline()
            if deadline is not None and deadline <= now:
                client.tick(now)  # the next iteration sends the frames
            else:
                self._wait(None if deadline is None else deadline - now)
                now = time.monotonic_ns()
                self._receive(cores, now)

    # -- NMT

    def command(self, command: NmtCommand, node_id: int, timeout_s: float) -> list[NmtConfirmed | NmtUnconfirmed]:
        """Send an NMT command to a node (0: all nodes); return the confirmations received within `timeout_s`.

        Only heartbeats and boot-ups can confirm a command: a node that sends neither is returned as `NmtUnconfirmed`
        with state None, and is left out if the command is for all nodes.
        """
        timeout = round(timeout_s * 1e9)
        master = NmtMaster(retry_ns=timeout, tries=1, reset_timeout_ns=timeout)
        nodes = range(1, MAX_NODE_ID + 1) if node_id == BROADCAST else (node_id,)
        master.command(command, node_id, time.monotonic_ns(), confirm_by=nodes)
        self.serve([master], lambda: master.next_deadline() is None)
        events = master.events()
        if node_id == BROADCAST:
            events = [event for event in events if not isinstance(event, NmtUnconfirmed) or event.state is not None]
        return sorted(events, key=lambda event: event.node_id)

    def listen(self, seconds: float) -> None:
        """Receive frames for `seconds` and update `states`."""
        self.serve([], lambda: False, seconds)

    # -- LSS

    def lss(self, ask: Callable[[LssMaster], LssRequest], scan_s: float | None = None) -> LssResult:
        """Run the LSS request that `ask` starts and return its result; raise RemoteProtocolError if it fails.

        An example of `ask` is `lambda master: master.store()`. `scan_s` is the timeout of each request during a scan,
        None for the default.
        """
        master = LssMaster(timeout_ns=round(self.timeout_s * 1e9))
        if scan_s is not None:
            master.scan_timeout_ns = round(scan_s * 1e9)
        request = ask(master)
        self.serve([master], lambda: request.done)
        if request.error is not None:
            raise request.error
        return request.result

    # -- the loop

    def serve(self, cores: Sequence[Core], done: Callable[[], bool], seconds: float | None = None) -> bool:
        """Transfer the frames of protocol cores until `done()` is True; return False if `seconds` pass first."""
        now = time.monotonic_ns()
        end = None if seconds is None else now + round(seconds * 1e9)
        while True:
            deadline = end
            for core in cores:
                core_deadline = core.next_deadline()
                if core_deadline is not None and core_deadline <= now:
                    core.tick(now)
                    core_deadline = core.next_deadline()
                if out := core.frames():
                    self.port.send(pack_records(out))
                if core_deadline is not None and (deadline is None or core_deadline < deadline):
                    deadline = core_deadline
            if done():
                return True
            if end is not None and now >= end:
                return False
            self._wait(None if deadline is None else deadline - now)
            now = time.monotonic_ns()
            self._receive(cores, now)

    def _receive(self, cores: Sequence[Core], now: int) -> None:
        records = self.port.receive()
        if len(records) > _FEW and len(cores) == 1 and isinstance(client := cores[0], SdoClient):
            deliver(records, now, client.receive_records, partial(self._hand_out, cores))
        else:  # every core gets every frame
            for can_id, length, data in RECORD.iter_unpack(records):
                self._hand_out(cores, CanFrame(can_id, data[:length]), now)
        if self.port.wants_write:
            self.port.flush()
        if not records or self.port.stats.errors != self._errors:  # other events are possible only then
            self._errors = self.port.stats.errors
            self._check_events()

    def _hand_out(self, cores: Sequence[Core], frame: CanFrame, now: int) -> None:
        can_id, data = frame
        for listener in (*cores, *self.listeners) if self.listeners else cores:
            listener.receive(frame, now)
        if _FIRST_HEARTBEAT <= can_id <= _LAST_HEARTBEAT and len(data) == 1:
            node_id = can_id - ERROR_CONTROL_COB_ID
            self.states[node_id] = state_of_byte(data[0])
            if data == _BOOT_UP and (client := self._clients.get(node_id)) is not None:
                client.forget()

    def _check_events(self) -> None:
        for event in self.port.events():
            if event.kind is BusEventKind.BUS_OFF:
                raise BusOff(self.port.channel)
            if event.kind in (BusEventKind.DOWN, BusEventKind.UP):
                self._down = event.text if event.kind is BusEventKind.DOWN else ""

    def _wait(self, nanoseconds: int | None) -> None:
        """Wait until the port is readable or writable, at most for a given time; None waits indefinitely."""
        if self.port.wants_write != self._watches_writing:
            self._watches_writing = not self._watches_writing
            self._poll.modify(self._fd, select.POLLIN | select.POLLOUT if self._watches_writing else select.POLLIN)
        # Rounded up: a deadline in half a millisecond must not cause a busy loop.
        self._poll.poll(None if nanoseconds is None else max(0, -(-nanoseconds // 1_000_000)))


def _all_done(requests: list[tuple[int, SdoRequest]]) -> bool:
    return all(request.done for _, request in requests)
