"""The interpolated position mode IP (7): set-points of 0x60C1, one at a time or from the buffer 0x60C4 (CiA 402-2, 12).

Without a buffer it is CSP with another set-point object and an enable bit. A dictionary that has 0x60C4 offers the
buffer: writing 1 to 0x60C4:06 opens it, 0 closes and clears it, which is what it is after power-on. An open buffer
takes a record with every RPDO that brings 0x60C1, and with every SDO write to its last subindex; the drive takes one
from it every interpolation period (0x60C2) from the moment that interpolation is enabled. A record too many is refused.
Where it runs dry the axis does what its model does of a missing set-point, and goes on with the next record at once.
Only the linear sub mode 0 (0x60C0) and a first-in first-out buffer (0x60C4:03 = 0) are there; of a record the position
counts, its first subindex.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cia402 import objects as o
from canopen_control.cia402.options import Reaction
from canopen_control.virtual.cyclic_modes import CyclicPosition
from canopen_control.virtual.mode_base import BIT_12, NEW_SET_POINT, REACHED

if TYPE_CHECKING:
    from canopen_control.od.model import Entry, Value
    from canopen_control.virtual.mode_base import Axis
    from canopen_control.virtual.object_store import ObjectStore

__all__ = ["InterpolatedPosition", "SetPointBuffer"]

MAXIMUM, SIZE, ORGANISATION, POSITION, _RECORD_SIZE, CLEAR = range(1, 7)  # subindices of 0x60C4
_MOST: Final = 1024  # records, whatever a file says
_FIFO, _LINEAR = 0, 0


class SetPointBuffer:
    """0x60C4 of one axis: the positions that wait, in user counts."""

    def __init__(self, axis: Axis) -> None:
        self._objects = axis.objects
        self._waiting: deque[float] = deque()
        store, shift = axis.objects.store, axis.objects.offset
        self.last_subindex = max(store.od.subindices(o.INTERPOLATION_DATA + shift), default=0)
        self._attach(store, shift)

    def _attach(self, store: ObjectStore, shift: int) -> None:
        buffer = o.INTERPOLATION_BUFFER + shift
        store.guard([o.INTERPOLATION_SUB_MODE + shift], _only_linear)
        store.guard([buffer], self._check)
        store.guard([o.INTERPOLATION_DATA + shift], self._check_room)
        store.on_write([buffer], self._written)
        store.on_read(buffer, POSITION, lambda: len(self._waiting))

    @property
    def open(self) -> bool:
        """Whether records go through the buffer."""
        return self._objects.number(o.INTERPOLATION_BUFFER, CLEAR) == 1

    @property
    def size(self) -> int:
        """How many records it holds: 0x60C4:02 as far as 0x60C4:01 allows, and where that is 0 the latter."""
        most = min(self._objects.number(o.INTERPOLATION_BUFFER, MAXIMUM), _MOST)
        return min(self._objects.number(o.INTERPOLATION_BUFFER, SIZE) or most, most)

    def put(self, place: float) -> None:
        """Take a record; one too many was refused before it came here."""
        if len(self._waiting) < self.size:
            self._waiting.append(place)

    def __len__(self) -> int:
        return len(self._waiting)

    def get(self) -> float | None:
        """Return the oldest record and drop it, None where it is empty."""
        return self._waiting.popleft() if self._waiting else None

    def clear(self) -> None:
        """Drop all records."""
        self._waiting.clear()

    def _check(self, entry: Entry, value: Value) -> Value:
        number = value if isinstance(value, int) else 0
        if entry.subindex == SIZE and number > self._objects.number(o.INTERPOLATION_BUFFER, MAXIMUM):
            raise SdoServerAbort(AbortCode.VALUE_TOO_HIGH)
        if (entry.subindex == ORGANISATION and number != _FIFO) or (entry.subindex == CLEAR and number > 1):
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        return value

    def _check_room(self, entry: Entry, value: Value) -> Value:
        if entry.subindex == self.last_subindex and self.open and len(self._waiting) >= self.size:
            raise SdoServerAbort(AbortCode.OUT_OF_MEMORY)
        return value

    def _written(self, entry: Entry, value: Value) -> None:
        if entry.subindex == CLEAR and value == 0:
            self.clear()


def _only_linear(_entry: Entry, value: Value) -> Value:
    if value != _LINEAR:
        raise SdoServerAbort(AbortCode.INVALID_VALUE)
    return value


class InterpolatedPosition(CyclicPosition):
    """IP: as CSP with the linear sub mode, from 0x60C1:1 or the buffer, while bit 4 is set."""

    set_point = o.INTERPOLATION_DATA

    def __init__(self, axis: Axis) -> None:
        self.buffer = SetPointBuffer(axis)
        super().__init__(axis)

    def reset(self) -> None:
        """Forget the last target and what waits."""
        super().reset()
        self.buffer.clear()
        self._dry_ns: int | None = None  # when a record was due and none was there

    @property
    def _enabled(self) -> bool:
        return bool(self.power.controlword & NEW_SET_POINT)

    def update(self, now: int) -> None:
        """Take the set-point while interpolation is enabled; the first of the buffer, which then goes on by itself."""
        if not self._enabled:
            return
        if not self.buffer.open:
            super().update(now)
        elif len(self.buffer) and "interpolate" not in self.mover.timers:
            self._next(now)

    def missed(self) -> None:
        """Count a SYNC without a set-point, unless the buffer has one."""
        if not self.buffer.open:
            super().missed()

    def take(self, now: int) -> None:
        """Take the record that an RPDO brought."""
        if not self.buffer.open:
            super().take(now)
        else:
            self.record_written(now)

    def record_written(self, now: int) -> None:
        """Take a record into the buffer, where it is open."""
        if self.buffer.open:
            self.buffer.put(self.target())
            self.update(now)

    def _next(self, now: int) -> None:
        """Go to the next position of the buffer, once in an interpolation period."""
        if not (self.power.live and self._in_use and self._enabled and self.buffer.open):
            return
        place = self.buffer.get()
        if place is None:
            self._dry_ns = now if self.streaming else None
            return
        if self._dry_ns is not None:
            self.meter.missed += round((now - self._dry_ns) / self.period_ns)
            self._dry_ns = None
        self._arrived += 1
        self.meter.take(place, now)
        self.feed()
        self._inputs = None
        self.go(place, now)
        self.supervise(now)
        self.mover.at("interpolate", now + self.period_ns, self._next)

    def target(self) -> float:
        """Return the data record."""
        return float(self.objects.number(o.INTERPOLATION_DATA, 1))

    def control(self, word: int, previous: int, now: int) -> None:
        """Stop when interpolation is switched off."""
        if previous & ~word & NEW_SET_POINT:
            self._inputs = None
            self.mover.cancel("interpolate")
            self.stop(now, Reaction.SLOW_DOWN_RAMP)

    def bits(self) -> int:
        """Return bit 12 while interpolation is active, bit 10 at the set-point."""
        reached = self.mover.demand.end_ns <= self.mover.time
        return (BIT_12 if self._enabled and self.power.live else 0) | (REACHED if reached else 0)
