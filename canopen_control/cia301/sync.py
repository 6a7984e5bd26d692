"""SYNC object, producer and consumer, and TIME object (CiA 301, 7.2.5, 7.2.6, 7.5.2.5 to 7.5.2.7, 7.5.2.22).

Without a counter (0x1019 = 0) a SYNC has no data. With an overflow value n of 2 to 240 it has one byte that
counts from 1 to n and starts again at 1. A SYNC of the wrong length is reported for EMCY 0x8240 and still counts as a
SYNC without counter, as in other stacks, because its timing is valid.
"""

from __future__ import annotations

import enum
import struct
from typing import NamedTuple

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.heartbeat import next_on_grid
from canopen_control.cia301.outbox import Outbox
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import EXTENDED_BIT, CanFrame, can_id_of, is_restricted

_WIRE = struct.Struct("<IH")


class TimeOfDay(NamedTuple):
    """Time of the TIME object: `ms` after midnight, 0 to 86399999; `days` since 1984-01-01 (CiA 301, 7.2.6).

    TIME messages are only decoded; neither the master nor the virtual devices produce or consume them.
    """

    days: int
    ms: int


def parse_time(data: bytes) -> TimeOfDay | None:
    """Return the time in the 6 bytes of a TIME message (the upper four bits are reserved); None for another length."""
    # CiA 301, 7.2.6: TIME_OF_DAY, 6 bytes
    if len(data) != _WIRE.size:
        return None
    ms, days = _WIRE.unpack(data)
    return TimeOfDay(days, ms & 0x0FFFFFFF)


SYNC_COB_ID = 0x080
PRODUCER_BIT = 1 << 30  # bit in 0x1005


def parse_cob_id_sync(value: int) -> tuple[int, bool]:
    """Return the CAN identifier (with the 29-bit flag) and the producer bit of a value of 0x1005."""
    return can_id_of(value), bool(value & PRODUCER_BIT)


def is_valid_overflow(overflow: int) -> bool:
    """Whether the value is valid for 0x1019: 0 (no counter) or 2 to 240 (CiA 301, 7.5.2.22)."""
    return overflow == 0 or 2 <= overflow <= 240


def check_overflow(overflow: int, period_us: int) -> AbortCode | None:
    """Return the abort code for a write to 0x1019 while 0x1006 is `period_us`, or None if the write is valid."""
    # CiA 301, 7.5.2.22: the overflow value must not change while 0x1006 is not 0
    if period_us:
        return AbortCode.DEVICE_STATE
    return None if is_valid_overflow(overflow) else AbortCode.INVALID_VALUE


def check_cob_id_sync(value: int, present: int, *, can_produce: bool = True) -> AbortCode | None:
    """Return the abort code for a write to 0x1005 whose current value is `present`, or None if the write is valid."""
    # CiA 301, 7.5.2.5: bit 30, the device generates SYNC
    if value & PRODUCER_BIT and not can_produce:
        return AbortCode.INVALID_VALUE
    # CiA 301, 7.3.5: restricted identifiers
    if not value & EXTENDED_BIT and is_restricted(value & 0x7FF):
        return AbortCode.INVALID_VALUE
    # CiA 301, 7.5.2.5: the identifier must not change while the device generates SYNC
    changed = (value ^ present) & (PRODUCER_BIT - 1)
    if changed and value & PRODUCER_BIT and present & PRODUCER_BIT:
        return AbortCode.INVALID_VALUE
    return None


class SyncProducer:
    """Producer of SYNC frames: `frame` returns the next SYNC; after `start` a timer sends SYNC every `period_ns`.

    The frames are created once, so that the cycle allocates nothing. A reserved overflow value raises
    LocalProtocolError.
    """

    def __init__(self, cob_id: int = SYNC_COB_ID, overflow: int = 0, *, period_ns: int = 0) -> None:
        if not is_valid_overflow(overflow):
            msg = f"SYNC counter overflow {overflow}: 0x1019 holds 0 or 2 to 240"
            raise LocalProtocolError(msg)
        self.cob_id = cob_id
        self.overflow = overflow
        self.period_ns = period_ns
        self.counter = 0  # counter of the last SYNC; 0: none sent, or no counter
        payloads = [bytes((count,)) for count in range(1, overflow + 1)] or [b""]
        self._ring = [CanFrame(cob_id, payload) for payload in payloads]
        self._next = 0
        self._deadline_ns: int | None = None
        self._frames: Outbox[CanFrame] = Outbox()

    def frame(self) -> CanFrame:
        """Return the next SYNC and advance the counter."""
        sync = self._ring[self._next]
        self._next += 1
        if self.overflow:
            self.counter = self._next
        if self._next == len(self._ring):
            self._next = 0
        return sync

    def reset(self) -> None:
        """Reset the counter: the next SYNC has the counter 1 (after reset communication and on leaving STOPPED)."""
        self._next = self.counter = 0

    def start(self, now: int) -> None:
        """Start the timer: the first SYNC is due at `now`."""
        self._deadline_ns = now

    def stop(self) -> None:
        """Stop the timer."""
        self._deadline_ns = None

    def receive(self, frame: CanFrame, now: int) -> None:
        """Ignore the frame; a SYNC producer receives nothing."""

    def tick(self, now: int) -> None:
        """Send a SYNC when due; missed periods are skipped and do not shift later SYNCs."""
        if self.period_ns and self._deadline_ns is not None and now >= self._deadline_ns:
            self._frames.put(self.frame())
            self._deadline_ns = next_on_grid(self._deadline_ns, self.period_ns, now)

    def next_deadline(self) -> int | None:
        return self._deadline_ns if self.period_ns else None

    def frames(self) -> list[CanFrame]:
        return self._frames.drain()

    def events(self) -> list[object]:
        return []


class SyncEventKind(enum.Enum):
    """Kind of event that a SYNC consumer reports."""

    SYNC = "sync"
    LENGTH_ERROR = "length error"  # report EMCY 0x8240; a SYNC event follows
    MISSED = "missed"  # no SYNC within 1.5 periods
    RESOLVED = "resolved"  # the first SYNC after MISSED; a SYNC event follows


class SyncEvent(NamedTuple):
    """SYNC event `kind` at `now`; `counter` is None if the SYNC has no counter."""

    kind: SyncEventKind
    now: int
    counter: int | None = None


class SyncConsumer:
    """Consumer of SYNC, which monitors the period if `period_ns` (0x1006) is set.

    `count` counts the SYNCs received, `skipped` the SYNCs whose counter is not the expected one.
    """

    def __init__(self, cob_id: int = SYNC_COB_ID, overflow: int = 0, *, period_ns: int = 0) -> None:
        self.cob_id = cob_id
        self.overflow = overflow
        self.period_ns = period_ns
        self.count = self.skipped = 0
        self._counter: int | None = None
        self._deadline_ns: int | None = None
        self._missed = False
        self.event_queue: Outbox[SyncEvent] = Outbox()

    def reset(self) -> None:
        """Clear the counter and stop monitoring until the next SYNC (reset communication, entering STOPPED)."""
        self._counter = self._deadline_ns = None
        self._missed = False

    def receive(self, frame: CanFrame, now: int) -> None:
        if frame.can_id != self.cob_id:
            return
        counter = self._counter_of(frame.data, now) if frame.data or self.overflow else None
        if self._deadline_ns is not None:
            self.tick(now)  # a SYNC after its deadline resolves a timeout instead of hiding it
        if self._missed:
            self._missed = False
            self.event_queue.put(SyncEvent(SyncEventKind.RESOLVED, now))
        self.count += 1
        self._deadline_ns = now + self.period_ns * 3 // 2 if self.period_ns else None
        self.event_queue.put(SyncEvent(SyncEventKind.SYNC, now, counter))

    def receive_plain(self, now: int) -> bool:
        """Count a timely SYNC without data, but report no event; return False if `receive` must process it."""
        deadline = self._deadline_ns
        if self.overflow or self._missed or (deadline is not None and now >= deadline):
            return False
        self.count += 1
        self._deadline_ns = now + self.period_ns * 3 // 2 if self.period_ns else None
        return True

    def tick(self, now: int) -> None:
        """Report once that no SYNC has arrived within 1.5 periods."""
        # 1.5 communication cycle periods (0x1006), as in CANopenNode
        if self._deadline_ns is not None and now >= self._deadline_ns:
            self._deadline_ns, self._missed = None, True
            self.event_queue.put(SyncEvent(SyncEventKind.MISSED, now))

    def next_deadline(self) -> int | None:
        """Return the time at which the next SYNC is considered missed, or None if none is due."""
        return self._deadline_ns

    def frames(self) -> list[CanFrame]:
        return []

    def events(self) -> list[SyncEvent]:
        return self.event_queue.drain()

    def _counter_of(self, data: bytes, now: int) -> int | None:
        # CiA 301, 7.5.2.22: one byte with a counter, otherwise none
        if len(data) != (1 if self.overflow else 0):
            self.event_queue.put(SyncEvent(SyncEventKind.LENGTH_ERROR, now))
            self._counter = None
            return None
        if not self.overflow:
            return None
        if self._counter is not None and data[0] != self._counter % self.overflow + 1:
            self.skipped += 1
        self._counter = data[0]
        return data[0]
