"""The port of a SocketCAN interface: a raw AF_CAN socket without anything in between.

Law: linux/can.h and linux/can/raw.h. The kernel carries one frame a call. The receive buffer is at least 1 MiB (the
default holds 278 frames), what overflows is counted by the kernel (SO_RXQ_OVFL) and told in band. A full transmit queue
(ENOBUFS, or EAGAIN) makes frames wait here, bounded. An interface that goes down or is unplugged ends nothing: what is
sent meanwhile is lost and counted, since old commands must not arrive later, and the socket is bound again when the
interface is back. Once its owner says which identifiers he wants, the kernel keeps all others to itself.
"""

from __future__ import annotations

import errno
import socket
import struct
import time
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from canopen_control.bus.error_events import note_errors
from canopen_control.bus.error_frames import has_error_frames, overrun_frame
from canopen_control.bus.port import BusEvent, BusEventKind, EventLog, PortStats, Records, whole_records
from canopen_control.bus.sendqueue import SendQueue
from canopen_control.errors import BusClosed, BusError, InterfaceDown, InterfaceNotFound
from canopen_control.frame import EXTENDED_FLAG, RECORD_SIZE, REMOTE_FLAG, pack_records

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

__all__ = ["CanSocket", "SocketCanPort", "open_socketcan"]

# linux/can.h, linux/can/raw.h, asm-generic/socket.h: Python has them only where it was built with those headers.
_CAN_RAW = 1
_SOL_CAN_RAW = 101
_CAN_RAW_FILTER = 1
_CAN_RAW_ERR_FILTER = 2
_ALL_ERRORS = struct.pack("=I", 0x1FFFFFFF)
_SO_RCVBUFFORCE = 33
_SO_RXQ_OVFL = 40

_RECEIVE_BUFFER = 4 << 20
_ANCILLARY_SIZE = 64
_BATCH = 1024  # frames a call of receive, so that a flood leaves time for others
_FRAME_MEMORY = 768  # what a queued frame costs of SO_SNDBUF
_SHORT_QUEUE = 100
_REBIND_NS = 500_000_000
_U32 = struct.Struct("=I")
_FILTER = struct.Struct("=II")  # identifier, mask
_MOST_FILTERS = 512  # CAN_RAW_FILTER_MAX
_STANDARD_MASK = EXTENDED_FLAG | REMOTE_FLAG | 0x7FF  # this very mask has a fast path in the kernel
_EXTENDED_MASK = EXTENDED_FLAG | REMOTE_FLAG | 0x1FFFFFFF
_EVERYTHING = _FILTER.pack(0, 0)
_ALL_STANDARD = _FILTER.pack(0, EXTENDED_FLAG)
_CLOSED_HERE = "closed on this side"

NETWORK_CLASS = Path("/sys/class/net")


class CanSocket(Protocol):
    """What the port needs of a socket."""

    def fileno(self) -> int:
        """Return the descriptor."""

    def recvmsg(
        self, bufsize: int, ancbufsize: int = ..., flags: int = ..., /
    ) -> tuple[bytes, list[tuple[int, int, bytes]], int, object]:
        """Return a frame and what the kernel says beside it."""

    def send(self, data: Records, /) -> int:
        """Send a frame."""

    def bind(self, address: tuple[str], /) -> None:
        """Bind to an interface."""

    def setsockopt(self, level: int, option: int, value: int | bytes, /) -> None:
        """Set an option."""

    def close(self) -> None:
        """Close it."""


class SocketCanPort:
    """A bound raw CAN socket as a port; see `canopen_control.bus.port.Port`. `now` is monotonic ns."""

    def __init__(self, name: str, sock: CanSocket, now: Callable[[], int] = time.monotonic_ns) -> None:
        self.channel = name
        self.stats = PortStats()
        self._socket = sock
        self._now = now
        self._queue = SendQueue()
        self._full = False  # by ENOBUFS, of which the kernel does not tell the end
        self._events = EventLog()
        self._overflows = 0
        self._dropping = False
        self._down = ""  # what was told of it, empty while it works
        self._bus_off = False
        self._heard: frozenset[int] | None = None
        self._filters = _EVERYTHING
        self._rebind_at: int | None = None
        self._closed = False

    @property
    def wants_write(self) -> bool:
        """Whether frames wait for the kernel and it will say when it takes them."""
        return bool(self._queue.data) and not self._full

    def fileno(self) -> int:
        """Return the socket's descriptor, -1 once closed."""
        return -1 if self._closed else self._socket.fileno()

    def events(self) -> list[BusEvent]:
        """Return what happened since the last call."""
        return self._events.drain()

    def close(self) -> None:
        """Close the socket; a second call does nothing."""
        if not self._closed:
            self._closed = True
            self._socket.close()

    # Receiving -----------------------------------------------------------------------------------------------------

    def hear(self, can_ids: Iterable[int]) -> None:
        """Let the kernel give these identifiers only, and error frames; more than it can choose: all of 11 bits."""
        wanted = frozenset(can_ids)
        if wanted == self._heard or self._closed:
            return
        self._heard = wanted
        filters = [_filter(can_id) for can_id in sorted(wanted)]
        self._filters = b"".join(filters) if len(filters) <= _MOST_FILTERS else _ALL_STANDARD
        self._socket.setsockopt(_SOL_CAN_RAW, _CAN_RAW_FILTER, self._filters)

    def receive(self) -> bytes:
        """Return the whole records that wait, or ``b""``; raise `BusClosed` on a closed port."""
        self._prepare()
        records: list[bytes] = []
        problem: OSError | None = None
        try:
            for _ in range(_BATCH):
                data, ancillary, _flags, _address = self._socket.recvmsg(RECORD_SIZE, _ANCILLARY_SIZE)
                if ancillary:
                    records += self._overflow(ancillary)
                if len(data) == RECORD_SIZE:
                    records.append(data)
        except BlockingIOError:
            pass
        except OSError as error:
            problem = error
        received = self._taken(b"".join(records)) if records else b""
        if problem is not None:
            self._fail(problem)
        return received

    def _overflow(self, ancillary: Sequence[tuple[int, int, bytes]]) -> list[bytes]:
        """Return the in-band report of frames that did not fit the receive buffer; the kernel's counter wraps."""
        for level, kind, data in ancillary:
            if level == socket.SOL_SOCKET and kind == _SO_RXQ_OVFL and len(data) >= _U32.size:
                (total,) = _U32.unpack_from(data)
                lost, self._overflows = (total - self._overflows) & 0xFFFFFFFF, total
                if lost:
                    return [pack_records([overrun_frame(lost)])]
        return []

    def _taken(self, records: bytes) -> bytes:
        self.stats.rx += len(records) // RECORD_SIZE
        if has_error_frames(records):
            events = note_errors(records, self.stats)
            self._events.extend(events)
            self._follow(events)
        else:
            self._bus_off = False
        self._works_again()
        if self._queue.data:
            self.flush()
        return records

    def _follow(self, events: list[BusEvent]) -> None:
        """Note what error frames say of the controller: while it is off the bus nothing may wait for it."""
        for event in events:
            if event.kind is BusEventKind.BUS_OFF:
                self._bus_off = True
                self._drop_queue()
            elif event.kind is BusEventKind.ERROR_ACTIVE:
                self._bus_off = False

    # Sending -------------------------------------------------------------------------------------------------------

    def send(self, records: Records) -> None:
        """Send whole records; what the kernel does not take is queued. Raise `BusClosed` on a closed port."""
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
        """Hand queued records to the kernel as far as it takes them."""
        self._full = False
        taken, data = 0, memoryview(bytes(self._queue.data))
        problem: OSError | None = None
        try:
            while taken < len(data):
                taken += self._send_one(data[taken : taken + RECORD_SIZE])
        except BlockingIOError:
            pass
        except OSError as error:
            problem = error
        self._queue.taken(taken)
        if problem is not None:
            self._refused(problem)
        self.stats.queued = len(self._queue)

    def _send_one(self, record: memoryview) -> int:
        """Send a frame; one that the kernel finds wrong is lost and counted, so that it stops nobody."""
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

    # Down and up ---------------------------------------------------------------------------------------------------

    def _prepare(self) -> None:
        if self._closed:
            raise BusClosed(self.channel, _CLOSED_HERE)
        if self._rebind_at is not None and self._now() >= self._rebind_at:
            self._rebind()

    def _fail(self, error: OSError) -> None:
        """Note that the interface is down, or gone: told once, until it works again."""
        self._drop_queue()
        self._bus_off = False
        gone = error.errno in (errno.ENODEV, errno.ENXIO)
        if gone and self._rebind_at is None:
            self._rebind_at = self._now() + _REBIND_NS
        text = _DOWN_TEXTS.get(error.errno or 0, error.strerror or str(error))
        if not self._down or (gone and self._down != _GONE):  # one that is removed goes down first
            self._down = text
            self._events.add(BusEventKind.DOWN, f"bus {self.channel}: {text}")

    def _rebind(self) -> None:
        """Bind to the interface of this name again, which may be another one by now.

        With the removed one the kernel has thrown the filters away too; without any, nothing would be heard.
        """
        try:
            self._socket.setsockopt(_SOL_CAN_RAW, _CAN_RAW_FILTER, self._filters)
            self._socket.bind((self.channel,))
        except OSError:
            self._rebind_at = self._now() + _REBIND_NS
        else:
            self._rebind_at = None

    def _works_again(self) -> None:
        if self._down:
            self._down = ""
            self._events.add(BusEventKind.UP, f"bus {self.channel}: up again")


def _filter(can_id: int) -> bytes:
    return _FILTER.pack(can_id, _EXTENDED_MASK if can_id & EXTENDED_FLAG else _STANDARD_MASK)


_GONE = "the interface is gone; is the adapter unplugged?"
_DOWN_TEXTS = {
    errno.ENETDOWN: "the interface is down; bring it up: canopen-control bus up",
    errno.ENODEV: _GONE,
    errno.ENXIO: _GONE,
}


# Opening -----------------------------------------------------------------------------------------------------------


def open_socketcan(
    name: str, *, make_socket: Callable[[], CanSocket] | None = None, network_class: Path = NETWORK_CLASS
) -> SocketCanPort:
    """Open the interface `name`; raise `InterfaceNotFound`, `InterfaceDown` or `BusError`, each with what to type."""
    try:
        sock = (make_socket or _raw_socket)()
    except OSError as error:
        hint = f"this system has no SocketCAN ({error.strerror}); the bus without kernel CAN is local:{name}"
        raise InterfaceNotFound(name, hint) from error
    try:
        _set_options(sock, network_class / name)
        sock.bind((name,))
        _refuse_down(name, network_class / name)
    except BaseException as error:
        sock.close()
        if isinstance(error, OSError):
            raise _explained(name, error) from error
        raise
    return SocketCanPort(name, sock)


def _raw_socket() -> CanSocket:
    family = getattr(socket, "AF_CAN", None)
    if family is None:
        raise OSError(errno.EAFNOSUPPORT, "Python has no AF_CAN here")
    sock = socket.socket(family, socket.SOCK_RAW, _CAN_RAW)
    sock.setblocking(False)
    return sock


def _set_options(sock: CanSocket, interface: Path) -> None:
    sock.setsockopt(_SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _ALL_ERRORS)
    sock.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER)
    except PermissionError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)  # as far as rmem_max allows
    length = _number(interface / "tx_queue_len", 10)
    if 0 < length <= _SHORT_QUEUE:
        # Less send buffer than the transmit queue holds: the kernel then says EAGAIN and when to go on, instead of
        # ENOBUFS, of whose end it tells nobody. It doubles the value and has a minimum of its own.
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, max(1, length - 2) * _FRAME_MEMORY // 2)


def _refuse_down(name: str, interface: Path) -> None:
    if not _number(interface / "flags", 16) & 1:  # IFF_UP
        raise InterfaceDown(name, f"bring it up: canopen-control bus up {name}")


def _number(path: Path, base: int) -> int:
    """Return the number in a file of sysfs, -1 if there is none: then nothing is known, and all bits are set."""
    try:
        return int(path.read_text(), base)
    except (OSError, ValueError):
        return -1


def _explained(name: str, error: OSError) -> BusError:
    if error.errno != errno.ENODEV:
        return BusError(f"bus {name}: {error.strerror or error}")
    if name.startswith("vcan"):
        return InterfaceNotFound(name, f"make it: canopen-control bus up {name}")
    return InterfaceNotFound(name, "is the adapter plugged in? What there is: canopen-control bus list")
