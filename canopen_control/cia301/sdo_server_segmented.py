"""The server's half of segmented transfers (CiA 301, 7.2.4.3.4 and 7.2.4.3.7).

The law: toggles start at 0 and alternate. The copy of the segment before, which the bus may deliver, is ignored; any
other frame with the wrong toggle is an error. A transfer says what it makes of a frame with PROGRESS, DONE, IGNORED or
the abort code to send; a download confirms its last segment only when the store has taken the object.
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

_CONFIRMATIONS = {toggle: bytes((DOWNLOAD_SEGMENT_ANSWER | toggle,)) + bytes(7) for toggle in (0, TOGGLE)}


class SegmentedUpload:
    """Sends an object segment by segment, as the client asks for them."""

    __slots__ = ("_answer_id", "_data", "_offset", "_toggle", "index", "subindex")

    is_download = False
    result = b""

    def __init__(self, answer_id: int, index: int, subindex: int, data: bytes) -> None:
        self._answer_id, self.index, self.subindex = answer_id, index, subindex
        self._data = data
        self._offset = 0
        self._toggle = 0

    def takes(self, command: int) -> bool:
        """Whether a request with this command specifier belongs to the transfer."""
        return command & COMMAND_MASK == UPLOAD_SEGMENT

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        """Answer one request for a segment."""
        toggle = data[0] & TOGGLE
        if out or toggle != self._toggle:
            # All requests of one toggle look alike: behind the first one it can only be the copy of the last.
            return IGNORED if out or self._offset else AbortCode.TOGGLE_NOT_ALTERNATED
        chunk = self._data[self._offset : self._offset + SEGMENT_DATA]
        self._offset += SEGMENT_DATA
        self._toggle ^= TOGGLE
        last = self._offset >= len(self._data)
        command = SEGMENT | toggle | (SEGMENT_DATA - len(chunk)) << 1 | last
        out.append(CanFrame(self._answer_id, bytes((command,)) + chunk.ljust(SEGMENT_DATA, b"\0")))
        return DONE if last else PROGRESS

    def confirm(self, out: list[CanFrame]) -> None:
        """Send nothing: the last segment was the last word."""

    def nudge(self, out: list[CanFrame]) -> bool:  # noqa: ARG002 - the interface of all transfers
        """Return False: the client asks, the server waits."""
        return False


class SegmentedDownload:
    """Receives an object segment by segment; `size` is what the client announced, None if it did not."""

    __slots__ = ("_answer_id", "_before", "_buffer", "_confirmation", "_limit", "_size", "_toggle", "index", "subindex")

    is_download = True

    def __init__(self, answer_id: int, index: int, subindex: int, size: int | None, limit: int) -> None:
        self._answer_id, self.index, self.subindex = answer_id, index, subindex
        self._size, self._limit = size, limit
        self._buffer = bytearray()
        self._toggle = 0
        self._before = b""
        self._confirmation = CanFrame(answer_id, _CONFIRMATIONS[0])

    @property
    def result(self) -> bytes:
        """The bytes received."""
        return bytes(self._buffer)

    def takes(self, command: int) -> bool:
        """Whether a request with this command specifier belongs to the transfer."""
        return command & COMMAND_MASK == SEGMENT

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        """Take one segment."""
        command = data[0]
        if out or data == self._before:
            return IGNORED
        if command & TOGGLE != self._toggle:
            return AbortCode.TOGGLE_NOT_ALTERNATED
        self._before = data
        self._confirmation = CanFrame(self._answer_id, _CONFIRMATIONS[self._toggle])
        self._toggle ^= TOGGLE
        self._buffer += data[1 : 8 - (command >> 1 & 7)]
        if (code := self._length_error(last=bool(command & 1))) != PROGRESS:
            return code
        if command & 1:
            return DONE
        out.append(self._confirmation)
        return PROGRESS

    def confirm(self, out: list[CanFrame]) -> None:
        """Confirm the last segment."""
        out.append(self._confirmation)

    def nudge(self, out: list[CanFrame]) -> bool:  # noqa: ARG002 - the interface of all transfers
        """Return False: a lost segment cannot be asked for again."""
        return False

    def _length_error(self, last: bool) -> int:
        length, size = len(self._buffer), self._size
        if length > self._limit:
            return AbortCode.OUT_OF_MEMORY
        if size is not None and length > size:
            return AbortCode.LENGTH_TOO_HIGH
        if last and size is not None and length < size:
            return AbortCode.LENGTH_TOO_LOW
        return PROGRESS
