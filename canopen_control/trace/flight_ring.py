"""What a flight recorder keeps in memory: the newest frames, and the newest lines, each within a bound.

The law of this file: an addition costs the same however much is kept, and nothing is looked into. Frames stay the
16-byte records that came from the port, each with its own time. Memory is bounded twice, by age and by bytes, whichever
is less; when bytes are the bound, the window is shorter, and `begin` says so.
"""

from __future__ import annotations

import bisect
import heapq
import operator
from array import array
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.frame import RECORD_SIZE

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

__all__ = ["FrameRing", "KeptFrame", "LineRing"]

_SEGMENT_NS = 1_000_000_000
_SEGMENTS_OF_LIMIT = 8  # a segment holds at most this part of the limit, so that forgetting goes in small steps


class KeptFrame(NamedTuple):
    """One record: `time` in monotonic ns, the number of the bus."""

    time: int
    bus: int
    record: bytes


class _Segment:
    """A second of frames of one bus, end to end in `data`; `times` holds one number for each."""

    __slots__ = ("begin", "bus", "data", "times")

    def __init__(self, bus: int, begin: int) -> None:
        self.bus, self.begin = bus, begin
        self.data = bytearray()
        self.times = array("q")


class FrameRing:
    """The frames of the last `window_ns`, at most about `limit` bytes of them; forgets by the second."""

    def __init__(self, window_ns: int, limit: int) -> None:
        self._window_ns, self._limit = window_ns, limit
        self._segments: deque[_Segment] = deque()
        self._newest: dict[int, _Segment] = {}  # by bus: those that grow
        self._size = 0  # of all segments that do not grow any more

    def add(self, bus: int, records: bytes, times: Sequence[int]) -> None:
        """Keep the records of one reading, and when each came, in order and none before those of this bus before."""
        segment, now = self._newest.get(bus), times[-1]
        if segment is None or now - segment.begin >= _SEGMENT_NS or self._is_long(segment):
            segment = self._begin_segment(bus, times[0], now)
        segment.times.extend(times)
        segment.data += records

    @property
    def size(self) -> int:
        """The bytes that are kept, times included."""
        return self._size + sum(map(_size_of, self._newest.values()))

    def frames(self, since: int) -> Iterator[KeptFrame]:
        """Yield what came at `since` or later, in the order of time."""
        buses = {segment.bus for segment in self._segments}
        return heapq.merge(*(self._frames_of(bus, since) for bus in sorted(buses)), key=operator.itemgetter(0))

    def _frames_of(self, bus: int, since: int) -> Iterator[KeptFrame]:
        for segment in self._segments:
            if segment.bus == bus:
                for number in range(bisect.bisect_left(segment.times, since), len(segment.times)):
                    at = number * RECORD_SIZE
                    yield KeptFrame(segment.times[number], bus, bytes(segment.data[at : at + RECORD_SIZE]))

    def _is_long(self, segment: _Segment) -> bool:
        return len(segment.data) * _SEGMENTS_OF_LIMIT > self._limit

    def _begin_segment(self, bus: int, begin: int, now: int) -> _Segment:
        segments = self._segments
        if (full := self._newest.get(bus)) is not None:
            self._size += _size_of(full)
        newest = self._newest[bus] = _Segment(bus, begin)
        segments.append(newest)
        self._forget(now)
        return newest

    def _forget(self, now: int) -> None:
        """Drop the oldest segments as long as they are before the window, or too much; the newest stays."""
        while len(self._segments) > 1 and (
            self._segments[0].times[-1] < now - self._window_ns or self._size > self._limit
        ):
            oldest = self._segments.popleft()
            if self._newest[oldest.bus] is oldest:  # of a bus that is silent
                del self._newest[oldest.bus]
            else:
                self._size -= _size_of(oldest)


def _size_of(segment: _Segment) -> int:
    return len(segment.data) + segment.times.itemsize * len(segment.times)


class LineRing:
    """Lines of text as bytes with their times; `window_ns` None keeps them however old. Forgets one by one."""

    def __init__(self, window_ns: int | None, limit: int) -> None:
        self._window_ns, self._limit = window_ns, limit
        self._lines: deque[tuple[int, bytes]] = deque()
        self.size = 0

    def add(self, line: bytes, now: int) -> None:
        """Keep a line."""
        lines = self._lines
        lines.append((now, line))
        self.size += len(line)
        while self.size > self._limit or (self._window_ns is not None and lines[0][0] < now - self._window_ns):
            self.size -= len(lines.popleft()[1])

    def lines(self, since: int = 0) -> Iterator[bytes]:
        """Yield what was added at `since` or later, oldest first."""
        for time, line in self._lines:
            if time >= since:
                yield line
