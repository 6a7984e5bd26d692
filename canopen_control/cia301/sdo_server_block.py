"""The server's half of block transfers (CiA 301, 7.2.4.3.9 to 7.2.4.3.15).

The law: a sub-block's segments are numbered from 1; the receiver acknowledges the last one that came in order, at the
end of the sub-block or, once, when the line has been silent in its middle; the sender goes on behind it with a new
sub-block. While segments are awaited every frame but an abort is one, whatever its first byte looks like. CRC and
length are checked before the store sees the object.
"""

from __future__ import annotations

import enum

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_codec import (
    ABORT,
    BLOCK_ACK,
    BLOCK_END,
    BLOCK_END_ANSWER,
    BLOCK_END_ANSWER_FRAME,
    BLOCK_END_FRAME,
    BLOCK_START,
    BLOCK_UPLOAD,
    COMMAND_MASK,
    DONE,
    IGNORED,
    LAST_FLAG,
    MAX_BLOCK_SIZE,
    MAX_NUDGES,
    MAX_STUCK,
    PROGRESS,
    SEGMENT_DATA,
    SUB_COMMAND_MASK,
    crc16,
)
from canopen_control.cia301.sdo_records import segment_frames, segments_in_order
from canopen_control.frame import CanFrame

__all__ = ["BlockDownload", "BlockUpload"]


class _Phase(enum.Enum):
    """What an upload waits for; the value is the command specifier of it."""

    START = BLOCK_START
    ACK = BLOCK_ACK
    END = BLOCK_END_ANSWER


class BlockUpload:
    """Sends an object in sub-blocks, of the size that the client asks for."""

    __slots__ = (
        "_answer_id",
        "_block_size",
        "_crc",
        "_data",
        "_first",
        "_phase",
        "_sent",
        "_stuck",
        "_total",
        "index",
        "subindex",
    )

    is_download = False
    result = b""

    def __init__(self, answer_id: int, index: int, subindex: int, data: bytes, crc: bool, block_size: int) -> None:
        self._answer_id, self.index, self.subindex = answer_id, index, subindex
        self._data, self._crc, self._block_size = data, crc, block_size
        self._total = max(1, (len(data) + SEGMENT_DATA - 1) // SEGMENT_DATA)
        self._first = 0  # segment with which the sub-block under way begins
        self._sent = 0  # segments in it
        self._stuck = 0
        self._phase = _Phase.START

    def takes(self, command: int) -> bool:
        """Whether a request with this command specifier belongs to the transfer."""
        return command & COMMAND_MASK == BLOCK_UPLOAD and command & 0x03 != 0

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        """Take one request; what another phase expects is a copy, or late."""
        if out or data[0] != self._phase.value:
            return IGNORED
        if self._phase is _Phase.END:
            return DONE
        if self._phase is _Phase.ACK and (code := self._acknowledged(data[1], data[2])) != PROGRESS:
            return code
        if self._first < self._total:
            self._phase = _Phase.ACK
            self._send(out)
        else:
            self._phase = _Phase.END
            unused = self._total * SEGMENT_DATA - len(self._data)
            crc = crc16(self._data) if self._crc else 0
            out.append(CanFrame(self._answer_id, BLOCK_END_FRAME.pack(BLOCK_END | unused << 2, crc)))
        return PROGRESS

    def confirm(self, out: list[CanFrame]) -> None:
        """Send nothing: the client had the last word."""

    def nudge(self, out: list[CanFrame]) -> bool:  # noqa: ARG002 - the interface of all transfers
        """Return False: what is lost is the client's to ask for."""
        return False

    def _acknowledged(self, number: int, block_size: int) -> int:
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            return AbortCode.INVALID_BLOCK_SIZE
        self._stuck = 0 if number else self._stuck + 1
        if number > self._sent or self._stuck > MAX_STUCK:
            return AbortCode.INVALID_SEQUENCE_NUMBER
        self._first += number
        self._block_size = block_size
        return PROGRESS

    def _send(self, out: list[CanFrame]) -> None:
        self._sent = min(self._block_size, self._total - self._first)
        out += segment_frames(self._answer_id, self._data, self._first, self._sent)


class BlockDownload:
    """Receives an object in sub-blocks; `size` is what the client announced, None if it did not."""

    __slots__ = (
        "_answer_id",
        "_before",
        "_block_size",
        "_buffer",
        "_complete",
        "_crc",
        "_in_order",
        "_limit",
        "_resync",
        "_size",
        "_stuck",
        "index",
        "subindex",
    )

    is_download = True

    def __init__(
        self, answer_id: int, index: int, subindex: int, size: int | None, limit: int, crc: bool, block_size: int
    ) -> None:
        self._answer_id, self.index, self.subindex = answer_id, index, subindex
        self._size, self._limit, self._crc, self._block_size = size, limit, crc, block_size
        self._buffer = bytearray()
        self._in_order = 0  # number of the last segment in order
        self._before = b""
        self._resync = False  # acknowledged on silence: what is still under way from before does not count
        self._complete = False
        self._stuck = 0

    @property
    def result(self) -> bytes:
        """The bytes received, without the padding of the last segment."""
        return bytes(self._buffer)

    def takes(self, command: int) -> bool:
        """Whether a request with this command specifier belongs to the transfer."""
        if self._complete:
            return command & SUB_COMMAND_MASK == BLOCK_END or command == self._before[0]
        return command != ABORT

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        """Take one segment, or the end."""
        if out or (data == self._before and self._in_order != data[0] - 1):
            return IGNORED
        if self._complete:
            return self._end(data) if data[0] & SUB_COMMAND_MASK == BLOCK_END else AbortCode.UNKNOWN_COMMAND
        if data[0] & ~LAST_FLAG == self._in_order + 1:
            return self._in_order_segment(data, out)
        if self._resync:
            return IGNORED
        if data[0] & LAST_FLAG or data[0] == self._block_size:
            self._stuck += 1
            if self._stuck > MAX_STUCK:
                return AbortCode.INVALID_SEQUENCE_NUMBER
            self._acknowledge(out)
        return PROGRESS

    def receive_records(self, records: bytes, start: int, cob_id: int, out: list[CanFrame]) -> int:
        """Take the run of the client's segments at byte `start` and return its length, 0 if there is none.

        The segment that is acknowledged is not in it, nor one with which the object becomes too large.
        """
        if out or self._complete:
            return 0
        bounds = (self._limit,) if self._size is None else (self._limit, self._size)
        fitting = (max(min(bounds), 1) - len(self._buffer) + SEGMENT_DATA - 1) // SEGMENT_DATA
        unanswered = self._block_size - 1 - self._in_order
        data = segments_in_order(records, start, cob_id, self._in_order + 1, min(fitting, unanswered))
        if data:
            self._buffer += data
            self._in_order += len(data) // SEGMENT_DATA
            self._before = bytes((self._in_order,)) + data[-SEGMENT_DATA:]
            self._resync, self._stuck = False, 0
        return len(data) // SEGMENT_DATA

    def confirm(self, out: list[CanFrame]) -> None:
        """Confirm the end: the store has taken the object."""
        out.append(CanFrame(self._answer_id, BLOCK_END_ANSWER_FRAME))

    def nudge(self, out: list[CanFrame]) -> bool:
        """Acknowledge what came, because the end of the sub-block seems lost; False if there is nothing to say."""
        if self._complete or out or (not self._in_order and not self._may_repeat()):
            return False
        self._acknowledge(out)
        self._resync = True
        return True

    def _may_repeat(self) -> bool:
        """Whether to say once more that nothing came: two of these may cross, and then only the CRC notices."""
        self._stuck += 1
        return self._crc and self._resync and self._stuck <= MAX_NUDGES

    def _in_order_segment(self, data: bytes, out: list[CanFrame]) -> int:
        self._before, self._resync, self._stuck = data, False, 0
        self._in_order += 1
        self._buffer += data[1:]
        self._complete = data[0] & LAST_FLAG != 0
        at_least = len(self._buffer) - SEGMENT_DATA + 1
        if at_least > max(self._limit, 1):  # even an empty object takes one segment
            return AbortCode.OUT_OF_MEMORY
        if self._size is not None and at_least > max(self._size, 1):
            return AbortCode.LENGTH_TOO_HIGH
        if self._complete or self._in_order == self._block_size:
            self._acknowledge(out)
        return PROGRESS

    def _acknowledge(self, out: list[CanFrame]) -> None:
        ack = bytes((BLOCK_ACK, self._in_order, self._block_size, 0, 0, 0, 0, 0))
        out.append(CanFrame(self._answer_id, ack))
        self._in_order = 0

    def _end(self, data: bytes) -> int:
        unused = data[0] >> 2 & 7
        del self._buffer[len(self._buffer) - unused :]
        if self._crc and int.from_bytes(data[1:3], "little") != crc16(self._buffer):
            return AbortCode.CRC_ERROR
        length = len(self._buffer)
        if self._size is not None and length != self._size:
            return AbortCode.LENGTH_TOO_HIGH if length > self._size else AbortCode.LENGTH_TOO_LOW
        return AbortCode.OUT_OF_MEMORY if length > self._limit else DONE
