"""Communication between a check and one node, on a channel or in virtual time.

If the reactor has a manual clock, everything runs in virtual time. Every frame from or to the node is kept for the
report, up to `KEPT` frames per check.
"""

from __future__ import annotations

from collections import Counter, deque
from contextlib import contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NmtCommand, NmtState, nmt_frame, state_of_byte
from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.cia301.sdo_codec import ANSWER_BASE, REQUEST_BASE
from canopen_control.errors import BusClosed, CanopenError, RemoteProtocolError, SdoAbort
from canopen_control.frame import MAX_NODE_ID, CanFrame, frames_of, pack_records, remote_frame

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.bus.port import Port
    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.host.reactor import Reactor
    from canopen_control.od.eds import EdsFile
    from canopen_control.od.model import Entry


KEPT = 20  # maximum number of frames of a check in the report
MS = 1_000_000
NS_PER_S = 1_000_000_000
_UNBOOTED, _UNBOOTED_S = 2, 1.0  # after two resets without a boot-up message, wait for only 1 s


class CheckFailed(Exception):
    """Violation of a clause, with the observed and the expected behaviour of the device."""

    def __init__(self, observed: str, expected: str) -> None:
        self.observed, self.expected = observed, expected
        super().__init__(f"{observed}; expected: {expected}")


class NotApplicable(Exception):
    """Error of a check that does not apply, for instance because an optional object or the EDS is missing."""


class MotionBounds(NamedTuple):
    """Bounds of motions in the drive's units of position and velocity; a bound of 0 is derived from objects."""

    distance: int = 0
    speed: int = 0


class CheckedNode:
    """Node under test on a port; `eds` is its EDS file, or None.

    `timeout_s` is the time allowed for each answer, `bounds` limits motions. BusError is raised when the bus is lost.
    """

    def __init__(
        self,
        reactor: Reactor,
        port: Port,
        node_id: int,
        eds: EdsFile | None = None,
        *,
        timeout_s: float = 0.5,
        bounds: MotionBounds | None = None,
    ) -> None:
        self.reactor, self.port, self.node_id, self.eds = reactor, port, node_id, eds
        self.timeout_s, self.bounds = timeout_s, bounds or MotionBounds()
        self.state: NmtState | None = None  # in the last heartbeat
        self.notes: list[str] = []  # notes of the current check
        self.log: deque[str] = deque(maxlen=KEPT)
        self._unbooted = 0  # resets without a boot-up message
        self.last_seen_ns: dict[
            int, int
        ] = {}  # node-IDs with a boot-up or heartbeat, and the time of the last one in ns
        self.rates: dict[int, int] = {}  # highest number of frames per second, by identifier
        self._second, self._counts = 0, Counter[int]()
        self._client = SdoClient(node_id, timeout_ns=round(timeout_s * 1e9))
        self._frames: deque[tuple[int, CanFrame]] = deque(maxlen=100_000)
        self._lost: BusClosed | None = None
        reactor.add_reader(port, self._on_readable)

    def close(self) -> None:
        """Remove the node from the reactor; the port stays open."""
        self.reactor.remove_reader(self.port)

    def begin(self) -> None:
        """Clear the frames and notes of the previous check."""
        self.log.clear()
        self.notes = []
        self._frames.clear()

    # -- frames

    def send(self, can_id: int, data: bytes = b"") -> None:
        self._send([CanFrame(can_id, data)])

    def exchange(self, can_id: int, data: bytes, answer_id: int, seconds: float | None = None) -> bytes | None:
        """Send a frame and return the data of the next frame with `answer_id`, or None after the timeout."""
        self._frames.clear()
        self.send(can_id, data)
        frame = self.wait_for(answer_id, seconds)
        return None if frame is None else frame.data

    def ask_remote(self, can_id: int, seconds: float | None = None) -> CanFrame | None:
        """Send a remote frame and return the response, or None after the timeout."""
        self._frames.clear()
        self._send([remote_frame(can_id)])
        return self.wait_for(can_id, seconds)

    def listen(self, seconds: float) -> list[tuple[int, CanFrame]]:
        """Return the frames received in the next `seconds`, each with its time in ns."""
        self._frames.clear()
        self.reactor.run_for(round(seconds * 1e9))
        self._check_bus()
        return list(self._frames)

    def frames(self, can_id: int, seconds: float) -> list[tuple[int, CanFrame]]:
        """Return the frames with an identifier received in the next `seconds`, each with its time in ns."""
        return [item for item in self.listen(seconds) if item[1].can_id == can_id]

    def wait_for(self, can_id: int, seconds: float | None = None) -> CanFrame | None:
        """Return the first frame with an identifier, even if received before the call, or None after `seconds`."""
        limit = round((self.timeout_s if seconds is None else seconds) * 1e9)
        self.reactor.run_until(lambda: self._lost is not None or self._first(can_id) is not None, limit)
        self._check_bus()
        return self._first(can_id)

    def heartbeat(self, seconds: float) -> NmtState | None:
        """Wait for the next heartbeat or boot-up message; return its NMT state, or None on timeout."""
        self._frames.clear()
        frame = self.wait_for(ERROR_CONTROL_COB_ID + self.node_id, seconds)
        return None if frame is None or not frame.data else state_of_byte(frame.data[0])

    def nmt(self, command: NmtCommand, node_id: int | None = None) -> None:
        """Send an NMT command to `node_id`, by default to this node."""
        self._frames.clear()
        self._client.forget()
        self._send([nmt_frame(command, self.node_id if node_id is None else node_id)])

    @contextmanager
    def operational(self) -> Iterator[None]:
        """Context with the node in OPERATIONAL; on exit the node is set to PRE-OPERATIONAL."""
        self.nmt(NmtCommand.START)
        try:
            yield
        finally:
            self.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
            self.reactor.run_for(MS)

    def reset(self, command: NmtCommand, seconds: float = 10.0) -> float | None:
        """Reset the node and return the time in s to its boot-up message, or None if none is received.

        After two resets without a boot-up message, later calls wait for at most one second.
        """
        self.nmt(command)
        seconds = seconds if self._unbooted < _UNBOOTED else min(seconds, _UNBOOTED_S)
        begin = self.reactor.now()
        can_id = ERROR_CONTROL_COB_ID + self.node_id  # a heartbeat from before the reset may still arrive

        def booted() -> bool:
            return any(frame.can_id == can_id and frame.data == b"\0" for _, frame in self._frames)

        self.reactor.run_until(lambda: self._lost is not None or booted(), round(seconds * 1e9))
        self._check_bus()
        self._unbooted = 0 if booted() else self._unbooted + 1
        return (self.reactor.now() - begin) / 1e9 if booted() else None

    # -- SDO

    def request(self, data: bytes) -> None:
        """Send a raw request to the SDO server, without waiting for its response."""
        self.send(REQUEST_BASE + self.node_id, data)

    def answers(self, data: bytes, seconds: float) -> list[bytes]:
        """Send a raw request to the SDO server; return the data of all responses received within `seconds`."""
        self.request(data)
        return [frame.data for _, frame in self.frames(ANSWER_BASE + self.node_id, seconds)]

    def ask(self, request: bytes) -> bytes | None:
        """Send eight raw bytes to the SDO server and return its response, or None after the timeout."""
        return self.exchange(REQUEST_BASE + self.node_id, request, ANSWER_BASE + self.node_id)

    def read(self, index: int, subindex: int = 0, *, block: bool = False) -> bytes:
        """Upload an object; raise SdoAbort, SdoTimeout or another RemoteProtocolError."""
        return self._transfer(self._client.read(index, subindex, block=block, now=self.reactor.now()))

    def write(self, index: int, subindex: int, data: bytes, *, block: bool = False) -> None:
        """Download an object; raise the same errors as `read`."""
        self._transfer(self._client.write(index, subindex, data, block=block, now=self.reactor.now()))

    def described(self, index: int, subindex: int = 0) -> Entry | None:
        """Return an entry of the EDS, or None without an EDS or without this entry."""
        return None if self.eds is None else self.eds.od.get(index, subindex)

    def optional(self, index: int, subindex: int = 0) -> bytes:
        """Upload an optional object; raise NotApplicable if the device refuses the upload."""
        try:
            return self.read(index, subindex)
        except SdoAbort as error:
            raise NotApplicable(f"0x{index:04X}:{subindex:02X} cannot be read: 0x{error.code:08X}") from None

    def has(self, index: int, subindex: int = 0) -> bool:
        """Whether an optional object can be read."""
        try:
            self.read(index, subindex)
        except SdoAbort:
            return False
        return True

    def number(self, index: int, subindex: int = 0) -> int:
        """Upload an optional unsigned number; raise NotApplicable if the device refuses the upload."""
        return int.from_bytes(self.optional(index, subindex), "little")

    def put(self, index: int, subindex: int, value: int, size: int) -> None:
        """Download an unsigned number of `size` bytes; raise the same errors as `read`."""
        self.write(index, subindex, value.to_bytes(size, "little"))

    @contextmanager
    def kept(self, index: int, subindex: int = 0) -> Iterator[int]:
        """Context that yields the value of an object and restores it on exit; raise NotApplicable if it cannot be read.

        NotApplicable is also raised for an object that the EDS calls read-only. A value that cannot be restored is
        reported by the comparison at the end of the run.
        """
        entry = self.described(index, subindex)
        if entry is not None and not entry.writable:
            raise NotApplicable(f"0x{index:04X}:{subindex:02X} is read-only in the EDS")
        data = self.optional(index, subindex)
        try:
            yield int.from_bytes(data, "little")
        finally:
            with suppress(RemoteProtocolError):
                self.write(index, subindex, data)

    def _transfer(self, request: SdoRequest) -> bytes:
        client = self._client
        while not request.done:
            now = self.reactor.now()
            deadline = client.next_deadline()
            if deadline is not None and deadline <= now:
                client.tick(now)
            self._send(client.frames())
            deadline = client.next_deadline()
            wait = None if deadline is None else max(deadline - self.reactor.now(), 0)
            if not request.done:
                count = len(self._frames)
                self.reactor.run_until(partial(self._more_than, count), wait)
            self._check_bus()
        self._send(client.frames())
        client.events()
        error: CanopenError | None = request.error
        if error is not None:
            raise error
        return request.data

    def _more_than(self, count: int) -> bool:
        return len(self._frames) != count or self._lost is not None

    # -- port

    def _send(self, frames: list[CanFrame]) -> None:
        if frames:
            for frame in frames:
                self._note(">", frame)
            self.port.send(pack_records(frames))

    def _on_readable(self) -> None:
        try:
            records = self.port.receive()
        except BusClosed as error:
            self._lost = error
            self.reactor.remove_reader(self.port)
            return
        now = self.reactor.now()
        for frame in frames_of(records):
            if len(self._frames) == self._frames.maxlen:
                self._frames.popleft()
            self._frames.append((now, frame))
            self._client.receive(frame, now)
            if frame.can_id == ERROR_CONTROL_COB_ID + self.node_id and frame.data:
                self.state = state_of_byte(frame.data[0])
            if 0 < frame.can_id - ERROR_CONTROL_COB_ID <= MAX_NODE_ID:
                self.last_seen_ns[frame.can_id - ERROR_CONTROL_COB_ID] = now
            self._count(frame.can_id, now)
            self._note("<", frame)

    def _count(self, can_id: int, now: int) -> None:
        if now // NS_PER_S != self._second:
            self._second = now // NS_PER_S
            self._counts.clear()
        self._counts[can_id] = count = self._counts[can_id] + 1
        if count > self.rates.get(can_id, 0):
            self.rates[can_id] = count

    def _note(self, direction: str, frame: CanFrame) -> None:
        seconds = self.reactor.now() / 1e9
        self.log.append(f"{seconds:.6f} {direction} {frame.can_id & 0x1FFFFFFF:03X} {frame.data.hex(' ').upper()}")

    def _first(self, can_id: int) -> CanFrame | None:
        return next((frame for _, frame in self._frames if frame.can_id == can_id), None)

    def _check_bus(self) -> None:
        if self._lost is not None:
            raise self._lost
