"""Port of a SocketCAN interface, with a raw AF_CAN socket (linux/can.h, linux/can/raw.h).

The kernel transfers one frame per call. It counts frames that overflow the receive buffer and reports the count with a
frame. If the transmit queue is full (ENOBUFS or EAGAIN), frames wait in a bounded queue. When an interface is down or
unplugged the port remains open: frames sent meanwhile are lost and counted, since old commands must not arrive later. A
removed interface is bound again as soon as an interface with its name exists: a sender tries this twice a second, and a
receiver reads all interfaces meanwhile, until the first frame from this name. With a filter the kernel drops all other
identifiers.
"""

from __future__ import annotations

import errno
import time
from typing import TYPE_CHECKING

from canopen_control.bus.error_events import note_errors
from canopen_control.bus.error_frames import has_error_frames, overrun_frame
from canopen_control.bus.port import BusEvent, BusEventKind, BusEventLog, PortStats, Records, SendQueue, whole_records
from canopen_control.bus.port_abilities import UnixOffset
from canopen_control.bus.rawsocket import (
    ALL_INTERFACES,
    EVERYTHING,
    NETWORK_CLASS,
    ask_stamps,
    bind_to,
    filters_of,
    interface_of,
    open_raw,
    overflow_of,
    set_filters,
    stamp_of,
)
from canopen_control.errors import BusClosed
from canopen_control.frame import RECORD_SIZE, pack_records

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from canopen_control.bus.rawsocket import Ancillary, CanSocket


_ANCILLARY_SIZE = 64
_BATCH = 1024  # frames per call of receive, so that a flood does not block the process
_REBIND_NS = 500_000_000
_CLOSED_HERE = "closed on this side"


class SocketCanPort:
    """Port around a bound raw CAN socket; see `canopen_control.bus.port.Port`. `now` is monotonic ns."""

    def __init__(self, name: str, sock: CanSocket, now: Callable[[], int] = time.monotonic_ns) -> None:
        self.channel = name
        self.stats = PortStats()
        self._socket = sock
        self._now = now
        self._queue = SendQueue()
        self._full = False  # after ENOBUFS, of which the kernel does not signal the end
        self._events = BusEventLog()
        self._overflows = 0
        self._dropping = False
        self._down = ""  # reported reason, empty while it works
        self._bus_off = False
        self._identifiers: frozenset[int] | None = None
        self._filters = EVERYTHING
        self._rebind_at: int | None = None  # while the interface is removed
        self._unix: UnixOffset | None = None  # set once stamps are requested
        self._closed = False

    @property
    def wants_write(self) -> bool:
        """Whether frames wait and the kernel will signal when it accepts them."""
        return bool(self._queue.data) and not self._full

    def fileno(self) -> int:
        return -1 if self._closed else self._socket.fileno()

    def events(self) -> list[BusEvent]:
        return self._events.drain()

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._socket.close()

    # -- receiving

    def set_filter(self, can_ids: Iterable[int]) -> None:
        """Set kernel filters for these identifiers, or for all 11-bit ones if there are too many; error frames pass."""
        identifiers = frozenset(can_ids)
        if identifiers == self._identifiers or self._closed:
            return
        self._identifiers, self._filters = identifiers, filters_of(identifiers)
        set_filters(self._socket, self._filters)

    def receive(self) -> bytes:
        return self._receive(None)

    def ask_stamps(self) -> None:
        """Request time stamps from the kernel from now on; a second call does nothing."""
        if self._unix is None and not self._closed:
            ask_stamps(self._socket)
            self._unix = UnixOffset(self._now)

    def receive_stamped(self) -> tuple[bytes, list[int]]:
        """Return the records of `receive` and the kernel's time of each, in monotonic ns; 0 if unknown.

        The kernel's stamps are Unix time. A stamp in the future was taken before the clock was set back; it is replaced
        by the current time.
        """
        stamps: list[int] = []
        records = self._receive(stamps)
        if stamps and self._unix is not None:
            offset, now = self._unix.ns(), self._now()
            stamps = [min(stamp - offset, now) if stamp else 0 for stamp in stamps]
        return records, stamps

    def _receive(self, stamps: list[int] | None) -> bytes:
        self._prepare()
        records: list[bytes] = []
        problem: OSError | None = None
        try:
            for _ in range(_BATCH):
                data, ancillary, _flags, address = self._socket.recvmsg(RECORD_SIZE, _ANCILLARY_SIZE)
                if len(data) != RECORD_SIZE or (self._rebind_at is not None and not self._is_back(address)):
                    continue
                if ancillary:
                    records += self._overflow(ancillary)
                records.append(data)
                if stamps is not None:
                    stamp = stamp_of(ancillary) or 0
                    stamps += [stamp] * (len(records) - len(stamps))
        except BlockingIOError:
            pass
        except OSError as error:
            problem = error
        received = self._accept(b"".join(records)) if records else b""
        if problem is not None:
            self._fail(problem)
        return received

    def _overflow(self, ancillary: Ancillary) -> list[bytes]:
        """Return an overrun report if the kernel's wrapping counter shows frames lost in its buffer, else []."""
        total = overflow_of(ancillary)
        if total is None:
            return []
        lost, self._overflows = (total - self._overflows) & 0xFFFFFFFF, total
        return [pack_records([overrun_frame(lost)])] if lost else []

    def _accept(self, records: bytes) -> bytes:
        self.stats.rx += len(records) // RECORD_SIZE
        if has_error_frames(records):
            self._follow(note_errors(records, self.stats))
        elif self._bus_off:  # an adapter that restarts by itself may report it only by new frames
            self._bus_off = False
            self._events.add(BusEventKind.ERROR_ACTIVE, f"bus {self.channel}: frames are received again after bus-off")
        self._works_again()
        if self._queue.data:
            self.flush()
        return records

    def _follow(self, events: list[BusEvent]) -> None:
        """Log events and update the controller state; bus-off clears the send queue."""
        for event in events:
            text = event.text
            if event.kind is BusEventKind.BUS_OFF:
                self._bus_off = True
                self._drop_queue()
                text += f". Without --restart-ms, restart it with: canopen-control bus up {self.channel}"
            elif event.kind is BusEventKind.ERROR_ACTIVE:
                self._bus_off = False
            self._events.add(event.kind, text)

    # -- sending

    def send(self, records: Records) -> None:
        count = whole_records(records)
        self._prepare()
        self.stats.tx += count
        if self._bus_off or self._rebind_at is not None:
            self.stats.lost += count
            return
        dropped = self._queue.put(records)
        self.stats.lost += dropped
        if dropped and not self._dropping:
            self._events.add(BusEventKind.OVERRUN, f"bus {self.channel}: transmit queue full, frames are dropped")
        self._dropping = dropped > 0
        self.flush()

    def flush(self) -> None:
        self._full = False
        sent, data = 0, memoryview(bytes(self._queue.data))
        problem: OSError | None = None
        try:
            while sent < len(data):
                sent += self._send_one(data[sent : sent + RECORD_SIZE])
        except BlockingIOError:
            pass
        except OSError as error:
            problem = error
        self._queue.taken(sent)
        if problem is not None:
            self._refused(problem)
        self.stats.queued = len(self._queue)

    def _send_one(self, record: memoryview) -> int:
        """Send one frame and return its size; a frame that the kernel refuses as invalid is lost and counted."""
        try:
            self._socket.send(record)
        except OSError as error:
            if error.errno != errno.EINVAL:
                raise
            self.stats.lost += 1
        else:
            self._works_again()
        return RECORD_SIZE

    def _refused(self, error: OSError) -> None:
        if error.errno == errno.ENOBUFS:
            self._full = True
        else:
            self._fail(error)

    def _drop_queue(self) -> None:
        self.stats.lost += self._queue.clear()
        self.stats.queued = 0

    # -- failure and recovery

    def _prepare(self) -> None:
        if self._closed:
            raise BusClosed(self.channel, _CLOSED_HERE)
        if self._rebind_at is not None and self._now() >= self._rebind_at:
            self._rebind()

    def _fail(self, error: OSError) -> None:
        """Record that the interface is down or removed; DOWN is reported once until it works again."""
        self._drop_queue()
        self._bus_off = False
        removed = error.errno in (errno.ENODEV, errno.ENXIO)
        if removed and self._rebind_at is None:
            self._rebind_at = self._now() + _REBIND_NS
            self._bind(ALL_INTERFACES)
        text = _DOWN_TEXTS.get(error.errno or 0, error.strerror or str(error))
        if not self._down or (removed and self._down != _GONE):  # a removed interface goes down first
            self._down = text
            self._events.add(BusEventKind.DOWN, f"bus {self.channel}: {text}")

    def _bind(self, name: str) -> bool:
        try:
            bind_to(self._socket, name, self._filters)
        except OSError:
            return False
        return True

    def _rebind(self) -> None:
        self._rebind_at = None if self._bind(self.channel) else self._now() + _REBIND_NS

    def _is_back(self, address: object) -> bool:
        """Bind again if a frame came from an interface with the name of the removed one; return True if so."""
        if interface_of(address) != self.channel:
            return False
        self._rebind()
        return True

    def _works_again(self) -> None:
        if self._down:
            self._down = ""
            self._events.add(BusEventKind.UP, f"bus {self.channel}: up again")


_GONE = "the interface was removed; check that the adapter is plugged in"
_DOWN_TEXTS = {
    errno.ENETDOWN: "the interface is down; bring it up: canopen-control bus up",
    errno.ENODEV: _GONE,
    errno.ENXIO: _GONE,
}


def open_socketcan(
    name: str, *, make_socket: Callable[[], CanSocket] | None = None, network_class: Path = NETWORK_CLASS
) -> SocketCanPort:
    """Open the interface `name`; raise InterfaceNotFound, InterfaceDown or another BusError with advice."""
    return SocketCanPort(name, open_raw(name, make_socket, network_class))
