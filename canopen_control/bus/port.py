"""The port: what every CAN channel offers to its owner.

Rule 1: frames cross it as whole 16-byte records (`canopen_control.frame`), many at once. Rule 2: no verb waits; the
owner's reactor does, on `fileno()`, and on its writability while `wants_write`. Rule 3: what does not fit is dropped,
counted in `stats` and told as an event; nothing is lost silently. Rule 4: the only errors are `BusClosed`, and
`LocalProtocolError` for what is no record.
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
"""Frames, 16 bytes each, one after the other."""


class BusEventKind(enum.Enum):
    """What may happen to a channel; the controller's states are those of ISO 11898-1."""

    BUS_OFF = "bus-off"
    ERROR_PASSIVE = "error-passive"
    ERROR_ACTIVE = "error-active"
    DOWN = "down"
    UP = "up"
    OVERRUN = "overrun"
    CLOSED = "closed"


@dataclass(frozen=True, slots=True)
class BusEvent:
    """Something happened to the channel; `text` is one sentence for people."""

    kind: BusEventKind
    text: str


@dataclass(slots=True)
class PortStats:
    """Counters of a port since it was opened, in frames; `queued` is how many wait for the kernel now.

    `rx` includes error frames, which `errors` counts too. `tx` is what `send` was given. `lost` counts both directions.
    """

    rx: int = 0
    tx: int = 0
    lost: int = 0
    errors: int = 0
    queued: int = 0


class Port(Protocol):
    """One opened CAN channel, of whatever kind. A sender never receives its own frames."""

    @property
    def channel(self) -> str:
        """The channel as the user wrote it, such as ``local:robby``."""

    @property
    def stats(self) -> PortStats:
        """The live counters."""

    @property
    def wants_write(self) -> bool:
        """Whether frames wait for the kernel: call `flush` when the file descriptor is writable."""

    def fileno(self) -> int:
        """Return the descriptor that is readable when `receive` or `events` may return something."""

    def receive(self) -> bytes:
        """Return the whole records that wait, or ``b""``; raise `BusClosed` when the channel is gone."""

    def send(self, records: Records) -> None:
        """Send whole records, in order; what the kernel does not take now is queued, the oldest dropped when full.

        Raise `BusClosed` when the channel is gone.
        """

    def flush(self) -> None:
        """Hand queued records to the kernel as far as it takes them; raise `BusClosed` when the channel is gone."""

    def events(self) -> list[BusEvent]:
        """Return what happened since the last call."""

    def close(self) -> None:
        """Leave the channel; a second call does nothing."""


def whole_records(records: Records) -> int:
    """Return how many records there are; raise `LocalProtocolError` if the last one is cut."""
    size = len(records)
    if size % RECORD_SIZE:
        raise LocalProtocolError(f"{size} bytes are no whole number of {RECORD_SIZE}-byte records")
    return size // RECORD_SIZE


# What ports are built of: a log of events, a queue for what the kernel does not take, a descriptor that wakes.


EVENT_LIMIT: Final = 1000
_ONE: Final = (1).to_bytes(8, sys.byteorder)  # what an eventfd counts by
_MOST: Final = 4096
SEND_LIMIT: Final = 4096
"""Frames that may wait: most of a second at 1 Mbit/s; what is older would only confuse."""


class BusEventLog:
    """What happened to a port and was not fetched yet: bounded, since an owner may never ask; the oldest go first."""

    __slots__ = ("_events",)

    def __init__(self) -> None:
        self._events: deque[BusEvent] = deque(maxlen=EVENT_LIMIT)

    def add(self, kind: BusEventKind, text: str) -> None:
        """Note an event."""
        self._events.append(BusEvent(kind, text))

    def extend(self, events: Iterable[BusEvent]) -> None:
        """Note several."""
        self._events.extend(events)

    def drain(self) -> list[BusEvent]:
        """Return them, oldest first, and forget them."""
        if not self._events:
            return []
        events = list(self._events)
        self._events.clear()
        return events


class SendQueue:
    """Frames that wait to be sent: bounded, the oldest dropped first, and a half-sent one never cut.

    `data` begins with the rest of a half-sent record, if there is one.
    """

    __slots__ = ("data", "limit")

    def __init__(self, limit: int = SEND_LIMIT) -> None:
        self.data = bytearray()
        self.limit = limit

    def __len__(self) -> int:
        """Frames that wait, a half-sent one included."""
        return (len(self.data) + RECORD_SIZE - 1) // RECORD_SIZE

    def put(self, records: Records) -> int:
        """Append the rest of some records (only the first may be half sent); return how many were dropped for it."""
        self.data += records
        excess = len(self) - self.limit
        if excess <= 0:
            return 0
        half_sent = len(self.data) % RECORD_SIZE
        del self.data[half_sent : half_sent + excess * RECORD_SIZE]
        return excess

    def taken(self, size: int) -> None:
        """Forget the first `size` bytes: the kernel has them."""
        del self.data[:size]

    def clear(self) -> int:
        """Forget everything; return how many frames that were."""
        count = len(self)
        self.data.clear()
        return count


class WakeDescriptor:
    """A descriptor for ports that have none: `set` makes it readable, `clear` ends that. Any thread may."""

    def __init__(self) -> None:
        self._reader, self._writer = _open_wake()

    def fileno(self) -> int:
        """Return the descriptor to wait on, -1 once closed."""
        return self._reader

    def set(self) -> None:
        """Make the descriptor readable."""
        try:
            os.write(self._writer, _ONE)
        except OSError:  # full: it is readable already; closed: nobody waits
            return

    def clear(self) -> None:
        """Make the descriptor unreadable."""
        try:
            while len(os.read(self._reader, _MOST)) == _MOST:
                pass
        except OSError:  # nothing there
            return

    def close(self) -> None:
        """Give the descriptors back."""
        descriptors, self._reader, self._writer = {self._reader, self._writer} - {-1}, -1, -1
        for each in descriptors:
            os.close(each)


def _open_wake() -> tuple[int, int]:
    """Return descriptors to read from and to write to: eventfd(2), which takes a third of the time, or a pipe."""
    if sys.platform == "linux":
        event = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        return event, event
    reader, writer = os.pipe()
    os.set_blocking(reader, False)
    os.set_blocking(writer, False)
    return reader, writer
