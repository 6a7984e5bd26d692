"""A stream of lines: its splitter, and what a line may cost.

A line ends with a newline; an answer is at most 1 MiB long, a request 64 KiB and of no more than 4096 values, since
whoever serves requests has other things to do.
"""

from __future__ import annotations

from typing import Final

MAX_LINE: Final = 1 << 20
MAX_REQUEST: Final = 1 << 16
MAX_VALUES: Final = 4096  # of a request: the time to decode one is in its values, not in its bytes
_COSTLY: Final = b",[{\\"  # one of these comes with each value, or letter, that takes time


def too_many_values(line: bytes) -> bool:
    """Whether a line of JSON has more than `MAX_VALUES` values, which shows without decoding it."""
    return sum(map(line.count, _COSTLY)) > MAX_VALUES


class LineBuffer:
    """Bytes in, lines out: a stream cut anywhere gives the same lines.

    `overflow` turns true when a line is longer than `limit` bytes; nothing comes out after that.
    """

    __slots__ = ("_data", "_limit", "_searched", "overflow")

    def __init__(self, limit: int = MAX_LINE) -> None:
        self._data = bytearray()
        self._searched = 0  # no newline before this position
        self._limit = limit
        self.overflow = False

    def feed(self, data: bytes) -> None:
        """Take the next piece of the stream."""
        if not self.overflow:
            self._data += data

    def next_line(self) -> bytes | None:
        """Return the next line without its end, or None when none is complete; empty lines are skipped."""
        if self.overflow:
            return None
        data = self._data
        if self._searched == 0 and data[:1].isspace():
            del data[: len(data) - len(data.lstrip())]  # at once, however many lines of nothing these are
        end = data.find(b"\n", self._searched)
        length = len(data) if end < 0 else end
        if length > self._limit:
            self.overflow = True
            data.clear()
            return None
        if end < 0:
            self._searched = length
            return None
        line = bytes(data[:end])
        del data[: end + 1]
        self._searched = 0
        return line
