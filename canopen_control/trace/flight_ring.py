"""What a flight recorder keeps in memory: the newest frames, and the newest lines, each within a bound.

The law of this file: an addition costs the same however much is kept, and nothing is looked into. Frames stay the
16-byte records that came from the port; what came in one reading has one time. Memory is bounded twice, by age and by
bytes, whichever is less; when bytes are the bound, the window is shorter, and `begin` says so.
"""

from __future__ import annotations

from array import array
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["Batch", "FrameRing", "LineRing"]

_SEGMENT_NS = 1_000_000_000
_SEGMENTS_OF_LIMIT = 8  # a segment holds at most this part of the limit, so that forgetting goes in small steps
_MARK = 3  # numbers of one reading in `marks`


class Batch(NamedTuple):
    """What came in one reading: `time` in monotonic ns, the number of the bus, whole records."""

    time: int
    bus: int
    records: bytes


class _Segment:
    """A second of frames, end to end in `data`; `marks` holds time, bus and length in bytes of each reading."""

    __slots__ = ("begin", "data", "marks")

    def __init__(self, begin: int) -> None:
        self.begin = begin
        self.data = bytearray()
        self.marks = array("q")


class FrameRing:
    """The frames of the last `window_ns`, at most about `limit` bytes of them; forgets by the second."""

    def __init__(self, window_ns: int, limit: int) -> None:
        self._window_ns, self._limit = window_ns, limit
        self._segments: deque[_Segment] = deque()
        self._size = 0  # of all segments but the newest

    def add(self, bus: int, records: bytes, now: int) -> None:
        """Keep the records of one reading."""
        segments = self._segments
        if not segments or now - segments[-1].begin >= _SEGMENT_NS or self._is_long(segments[-1]):
            self._begin_segment(now)
        newest = segments[-1]
        newest.marks.extend((now, bus, len(records)))
        newest.data += records

    @property
    def size(self) -> int:
        """The bytes that are kept, times included."""
        return self._size + (_size_of(self._segments[-1]) if self._segments else 0)

    def batches(self, since: int) -> Iterator[Batch]:
        """Yield what came at `since` or later, oldest first."""
        for segment in self._segments:
            position, marks = 0, segment.marks
            for each in range(0, len(marks), _MARK):
                time, bus, length = marks[each : each + _MARK]
                if time >= since:
                    yield Batch(time, bus, bytes(segment.data[position : position + length]))
                position += length

    def _is_long(self, segment: _Segment) -> bool:
        return len(segment.data) * _SEGMENTS_OF_LIMIT > self._limit

    def _begin_segment(self, now: int) -> None:
        segments = self._segments
        if segments:
            self._size += _size_of(segments[-1])
        segments.append(_Segment(now))
        # A segment may go when the next one begins before the window; the newest always stays.
        while len(segments) > 1 and (segments[1].begin <= now - self._window_ns or self._size > self._limit):
            self._size -= _size_of(segments.popleft())


def _size_of(segment: _Segment) -> int:
    return len(segment.data) + segment.marks.itemsize * len(segment.marks)


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
