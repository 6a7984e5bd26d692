"""The TIME object (CiA 301, 7.2.6 and 7.5.2.18): milliseconds after midnight and days since 1984-01-01.

Only arithmetic: which clock is told, and which one is set, is the owner's affair.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from canopen_control.cia301.cob_id import can_id_of
from canopen_control.cia301.outbox import Outbox
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import CanFrame

__all__ = ["TimeConsumer", "TimeOfDay", "parse_cob_id_time", "parse_time", "time_frame"]

TIME_COB_ID = 0x100
CONSUMER_BIT = 1 << 31  # of 0x1012
PRODUCER_BIT = 1 << 30
MS_PER_DAY = 86_400_000
EPOCH_MS = 441_763_200_000  # 1984-01-01 in Unix milliseconds
_WIRE = struct.Struct("<IH")


class TimeOfDay(NamedTuple):
    """`ms` after midnight, 0 to 86399999; `days` since 1984-01-01."""

    days: int
    ms: int

    @classmethod
    def from_unix_ms(cls, unix_ms: int) -> TimeOfDay:
        """Make the time of a Unix time; LocalProtocolError before 1984 and after 65535 days (year 2163)."""
        days, ms = divmod(unix_ms - EPOCH_MS, MS_PER_DAY)
        if not 0 <= days <= 0xFFFF:
            msg = f"Unix time {unix_ms} ms is outside of TIME OF DAY, 1984 to 2163"
            raise LocalProtocolError(msg)
        return cls(days, ms)

    def unix_ms(self) -> int:
        """Return the Unix time in milliseconds."""
        return EPOCH_MS + self.days * MS_PER_DAY + self.ms

    def encode(self) -> bytes:
        """Return the 6 bytes on the wire."""
        return _WIRE.pack(self.ms, self.days)


def time_frame(time: TimeOfDay, cob_id: int = TIME_COB_ID) -> CanFrame:
    """Make the TIME message."""
    return CanFrame(cob_id, time.encode())


def parse_time(data: bytes) -> TimeOfDay | None:
    """Return the time of 6 bytes, None for another length; the upper four bits of the milliseconds are reserved."""
    if len(data) != _WIRE.size:
        return None
    ms, days = _WIRE.unpack(data)
    return TimeOfDay(days, ms & 0x0FFFFFFF)


def parse_cob_id_time(value: int) -> tuple[int, bool, bool]:
    """Return can_id, whether the node consumes TIME, whether it produces it, of a 0x1012 value."""
    return can_id_of(value), bool(value & CONSUMER_BIT), bool(value & PRODUCER_BIT)


class TimeEvent(NamedTuple):
    """The network's time, and when it came."""

    time: TimeOfDay
    now: int


class TimeConsumer:
    """Hears TIME; `malformed` counts messages that are not 6 bytes or no time of a day."""

    def __init__(self, cob_id: int = TIME_COB_ID) -> None:
        self.cob_id = cob_id
        self.malformed = 0
        self._events: Outbox[TimeEvent] = Outbox(16)

    def receive(self, frame: CanFrame, now: int) -> None:
        """Take the TIME message; other frames are ignored."""
        if frame.can_id != self.cob_id:
            return
        time = parse_time(frame.data)
        if time is None or time.ms >= MS_PER_DAY:
            self.malformed += 1
        else:
            self._events.put(TimeEvent(time, now))

    def tick(self, now: int) -> None:
        """Do nothing: this core has no timers."""

    def next_deadline(self) -> None:
        """Return None: this core has no timers."""

    def frames(self) -> list[CanFrame]:
        """Return nothing: a consumer does not send."""
        return []

    def events(self) -> list[TimeEvent]:
        """Drain the times heard."""
        return self._events.drain()
