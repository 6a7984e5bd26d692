"""The client's half of segmented transfers (CiA 301, 7.2.4.3.4 and 7.2.4.3.7).

The law: the toggle bit starts at 0 and alternates with every segment. The bus may deliver a frame twice, directly one
after the other; a copy of the answer before is ignored once, a second one is a toggle error. A transfer says what it
makes of a frame with PROGRESS, DONE, IGNORED or the abort code to send; the client decides what follows from that.
"""

from __future__ import annotations

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_codec import (
    COMMAND_MASK,
    DONE,
    DOWNLOAD_SEGMENT_ANSWER,
    IGNORED,
    PROGRESS,
    SEGMENT,
    SEGMENT_DATA,
    TOGGLE,
    UPLOAD_SEGMENT,
)
from canopen_control.frame import CanFrame

__all__ = ["SegmentedDownload", "SegmentedUpload"]

_NEXT_SEGMENT = {toggle: bytes((UPLOAD_SEGMENT | toggle,)) + bytes(7) for toggle in (0, TOGGLE)}
_NO_ANSWER = b""


class SegmentedUpload:
    """Reads an object segment by segment; `size` is what the server announced, None if it did not."""

    __slots__ = ("_before", "_buffer", "_limit", "_request_id", "_size", "_toggle", "suspect")

    def __init__(self, request_id: int, size: int | None, limit: int, out: list[CanFrame]) -> None:
        self._request_id, self._size, self._limit = request_id, size, limit
        self._buffer = bytearray()
        self._toggle = 0
        self._before = _NO_ANSWER
        self.suspect = False  # a copy was ignored and nothing came since
        out.append(CanFrame(request_id, _NEXT_SEGMENT[0]))

    @property
    def result(self) -> bytes:
        """The object's bytes, as far as they came."""
        return bytes(self._buffer)

    @property
    def progress(self) -> tuple[int, int | None]:
        """Bytes that are over, and how many there are, None where the server has not said."""
        return len(self._buffer), self._size

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        """Take one answer of the server."""
        command = data[0]
        if command & COMMAND_MASK != SEGMENT or out:  # an answer cannot overtake its request
            return IGNORED
        if command & TOGGLE != self._toggle:
            return self._wrong_toggle(data)
        self._before, self.suspect = data, False
        self._toggle ^= TOGGLE
        self._buffer += data[1 : 8 - (command >> 1 & 7)]
        last = command & 1
        if (code := self._length_error(bool(last), empty=command & 0x0E == 0x0E)) != PROGRESS:
            return code
        if last:
            return DONE
        out.append(CanFrame(self._request_id, _NEXT_SEGMENT[self._toggle]))
        return PROGRESS

    def nudge(self, out: list[CanFrame]) -> bool:  # noqa: ARG002 - the interface of all transfers
        """Return False: a lost segment cannot be asked for again."""
        return False

    def _wrong_toggle(self, data: bytes) -> int:
        if data != self._before or self.suspect:
            return AbortCode.TOGGLE_NOT_ALTERNATED
        self.suspect = True
        return IGNORED

    def _length_error(self, last: bool, empty: bool) -> int:
        length, size = len(self._buffer), self._size
        if length > self._limit:
            return AbortCode.OUT_OF_MEMORY
        if size is not None and length > size:
            return AbortCode.LENGTH_TOO_HIGH
        if last and size is not None and length < size:
            return AbortCode.LENGTH_TOO_LOW
        if empty and not last:  # would go on for ever without moving anything
            return AbortCode.GENERAL_ERROR
        return PROGRESS


class SegmentedDownload:
    """Writes an object segment by segment."""

    __slots__ = ("_data", "_offset", "_request_id", "_toggle", "suspect")

    result = b""

    def __init__(self, request_id: int, data: bytes, out: list[CanFrame]) -> None:
        self._request_id, self._data = request_id, data
        self._offset = 0
        self._toggle = 0
        self.suspect = False
        self._send(out)

    @property
    def progress(self) -> tuple[int, int | None]:
        """Bytes that are over, and how many there are, None where the server has not said."""
        return min(self._offset, len(self._data)), len(self._data)

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        """Take one answer of the server."""
        command = data[0]
        if command & COMMAND_MASK != DOWNLOAD_SEGMENT_ANSWER or out:
            return IGNORED
        if command & TOGGLE != self._toggle:
            return self._wrong_toggle()
        self.suspect = False
        self._offset += SEGMENT_DATA
        if self._offset >= len(self._data):
            return DONE
        self._toggle ^= TOGGLE
        self._send(out)
        return PROGRESS

    def nudge(self, out: list[CanFrame]) -> bool:  # noqa: ARG002 - the interface of all transfers
        """Return False: a segment may not be sent twice."""
        return False

    def _wrong_toggle(self) -> int:
        if self._offset == 0 or self.suspect:
            return AbortCode.TOGGLE_NOT_ALTERNATED
        self.suspect = True
        return IGNORED

    def _send(self, out: list[CanFrame]) -> None:
        chunk = self._data[self._offset : self._offset + SEGMENT_DATA]
        last = self._offset + SEGMENT_DATA >= len(self._data)
        command = SEGMENT | self._toggle | (SEGMENT_DATA - len(chunk)) << 1 | last
        out.append(CanFrame(self._request_id, bytes((command,)) + chunk.ljust(SEGMENT_DATA, b"\0")))
