"""Interface of all ports, and their common parts: an event log, a send queue, a wake-up descriptor.

Rules:
- Frames pass a port as whole 16-byte records (`canopen_control.frame`), many at once.
- No method waits; the owner's reactor waits on `fileno()`, and for writability while `wants_write`.
- Frames that do not fit a queue are dropped, counted in `stats` and reported as an event.
- Ports raise only `BusClosed`, and `LocalProtocolError` for malformed records.
"""

from __future__ import annotations

import enum
import os
import sys
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.errors import LocalProtocolError
from canopen_control.frame import RECORD_SIZE

if TYPE_CHECKING:
    from collections.abc import Iterable


Records = bytes | bytearray | memoryview
"""Concatenated frames of 16 bytes each."""


class BusEventKind(enum.Enum):
    """Kind of a channel event; the states of the controller are those of ISO 11898-1."""

    BUS_OFF = "bus-off"
    ERROR_PASSIVE = "error-passive"
    ERROR_ACTIVE = "error-active"
    DOWN = "down"
    UP = "up"
    OVERRUN = "overrun"
    CLOSED = "closed"


@dataclass(frozen=True, slots=True)
class BusEvent:
    """Channel event; `text` is one sentence for users."""

    kind: BusEventKind
    text: str


@dataclass(slots=True)
class PortStats:
    """Counters of a port since it was opened, in frames; `queued` is the current number of frames waiting to be sent.

    `rx` includes error frames, which `errors` counts too. `tx` counts the frames given to `send`. `lost` counts both
    directions.
    """

    rx: int = 0
    tx: int = 0
    lost: int = 0
    errors: int = 0
    queued: int = 0


class Port(Protocol):
    """Open CAN channel of any kind. A sender does not receive its own frames."""

    @property
    def channel(self) -> str:
        """Name of the channel, such as ``local:robby``."""

    @property
    def stats(self) -> PortStats:
        """Counters of the port, updated with each call."""

    @property
    def wants_write(self) -> bool:
        """Whether frames wait to be sent: call `flush` when the file descriptor is writable."""

    def fileno(self) -> int:
        """Return the descriptor that is readable when `receive` or `events` may return something."""

    def receive(self) -> bytes:
        """Return the received whole records, or ``b""``; raise BusClosed when the channel is gone."""

    def send(self, records: Records) -> None:
        """Send whole records in order; queue those that the channel does not accept, dropping the oldest if full.

        Raise BusClosed when the channel is gone.
        """

    def flush(self) -> None:
        """Send queued records as far as the channel accepts them; raise BusClosed when the channel is gone."""

    def events(self) -> list[BusEvent]:
        """Return the events since the last call."""

    def close(self) -> None:
        """Close the channel; a second call does nothing."""


def whole_records(records: Records) -> int:
    """Return the number of records; raise LocalProtocolError if the last record is incomplete."""
    size = len(records)
    if size % RECORD_SIZE:
        raise LocalProtocolError(f"{size} bytes are not a whole number of {RECORD_SIZE}-byte records")
    return size // RECORD_SIZE


EVENT_LIMIT: Final = 1000
_ONE: Final = (1).to_bytes(8, sys.byteorder)  # increment written to an eventfd
_MAX: Final = 4096
SEND_LIMIT: Final = 4096
"""Maximum number of waiting frames: most of a second at 1 Mbit/s; older frames would be obsolete."""


class BusEventLog:
    """Bounded log of port events that have not been fetched; if full, it drops the oldest events."""

    __slots__ = ("_events",)

    def __init__(self) -> None:
        self._events: deque[BusEvent] = deque(maxlen=EVENT_LIMIT)

    def add(self, kind: BusEventKind, text: str) -> None:
        self._events.append(BusEvent(kind, text))

    def extend(self, events: Iterable[BusEvent]) -> None:
        self._events.extend(events)

    def drain(self) -> list[BusEvent]:
        """Return and clear the events, oldest first."""
        if not self._events:
            return []
        events = list(self._events)
        self._events.clear()
        return events


class SendQueue:
    """Bounded queue of frames to send; if full, it drops the oldest frames, but never a partly sent one.

    `data` begins with the rest of a partly sent record, if there is one.
    """

    __slots__ = ("data", "limit")

    def __init__(self, limit: int = SEND_LIMIT) -> None:
        self.data = bytearray()
        self.limit = limit

    def __len__(self) -> int:
        """Return the number of waiting frames, including one that was partly sent."""
        return (len(self.data) + RECORD_SIZE - 1) // RECORD_SIZE

    def put(self, records: Records) -> int:
        """Append records, the first of which may be partly sent; return the number of frames dropped."""
        self.data += records
        excess = len(self) - self.limit
        if excess <= 0:
            return 0
        half_sent = len(self.data) % RECORD_SIZE
        del self.data[half_sent : half_sent + excess * RECORD_SIZE]
        return excess

    def taken(self, size: int) -> None:
        """Remove the first `size` bytes, which have been sent."""
        del self.data[:size]

    def clear(self) -> int:
        """Clear the queue and return the number of frames that it held."""
        count = len(self)
        self.data.clear()
        return count


class WakeDescriptor:
    """Wake-up descriptor for ports without a socket: `set` makes it readable, `clear` unreadable; thread-safe."""

    def __init__(self) -> None:
        self._reader, self._writer = _open_wake()

    def fileno(self) -> int:
        """Return the descriptor to wait on; -1 once closed."""
        return self._reader

    def set(self) -> None:
        try:
            os.write(self._writer, _ONE)
        except OSError:  # full: it is readable already; closed: no reader
            return

    def clear(self) -> None:
        try:
            while len(os.read(self._reader, _MAX)) == _MAX:
                pass
        except OSError:  # nothing to read
            return

    def close(self) -> None:
        descriptors, self._reader, self._writer = {self._reader, self._writer} - {-1}, -1, -1
        for descriptor in descriptors:
            os.close(descriptor)


def _open_wake() -> tuple[int, int]:
    """Return descriptors for reading and writing: of an eventfd(2), which is faster, or of a pipe."""
    if sys.platform == "linux":
        event = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        return event, event
    reader, writer = os.pipe()
    os.set_blocking(reader, False)
    os.set_blocking(writer, False)
    return reader, writer
