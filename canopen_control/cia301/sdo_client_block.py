"""The client's half of block transfers (CiA 301, 7.2.4.3.9 to 7.2.4.3.15).

The law: segments of a sub-block are numbered from 1 and are not answered one by one. Whoever receives acknowledges a
sub-block with the number of the last segment that came in order; whoever sends goes on behind it with a new sub-block,
numbered from 1 again. An acknowledgement of 0 repeats the sub-block. If the end of a sub-block is lost, the receiver
acknowledges what it has once the line is silent, and from then on waits for a segment 1. The CRC, over the object's
bytes alone, counts if both sides offered it.
"""

from __future__ import annotations

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_codec import (
    BLOCK_ACK,
    BLOCK_END,
    BLOCK_END_ANSWER,
    BLOCK_END_ANSWER_FRAME,
    BLOCK_END_FRAME,
    BLOCK_START,
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
    segment_frames,
    segments_in_order,
)
from canopen_control.frame import CanFrame

_START = bytes((BLOCK_START, 0, 0, 0, 0, 0, 0, 0))


class BlockUpload:
    """Reads an object in sub-blocks; `size` is what the server announced, None if it did not."""

    __slots__ = (
        "_before",
        "_block_size",
        "_buffer",
        "_crc",
        "_ending",
        "_expected",
        "_limit",
        "_request_id",
        "_resync",
        "_size",
        "_stuck",
    )

    suspect = False

    def __init__(
        self, request_id: int, size: int | None, limit: int, crc: bool, block_size: int, out: list[CanFrame]
    ) -> None:
        self._request_id, self._size, self._limit = request_id, size, limit
        self._crc, self._block_size = crc, block_size
        self._buffer = bytearray()
        self._expected = 1  # number of the next segment in order
        self._before = b""
        self._resync = False  # acknowledged on silence: what is still under way from before does not count
        self._ending = False  # all segments are here
        self._stuck = 0
        out.append(CanFrame(request_id, _START))

    @property
    def result(self) -> bytes:
        """The object's bytes."""
        return bytes(self._buffer)

    @property
    def progress(self) -> tuple[int, int | None]:
        """Bytes that are over, and how many there are, None where the server has not said."""
        return len(self._buffer), self._size

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        """Take one frame of the server."""
        if out:  # our acknowledgement has not left: a copy of what it acknowledges
            return IGNORED
        if self._ending:
            return self._end(data, out)
        number = data[0] & ~LAST_FLAG
        if number != self._expected:
            return self._out_of_order(data, out)
        self._before, self._resync, self._stuck = data, False, 0
        self._buffer += data[1:]
        self._expected += 1
        self._ending = data[0] & LAST_FLAG != 0
        if self._ending or number == self._block_size:
            self._acknowledge(out)
        return self._length_error(len(self._buffer) - SEGMENT_DATA + 1)

    def receive_records(self, records: bytes, start: int, cob_id: int, out: list[CanFrame]) -> int:
        """Take the run of the server's segments at byte `start` and return its length, 0 if there is none.

        It ends before the segment that is acknowledged, and before one that would make the object too large.
        """
        if out or self._ending:
            return 0
        largest = self._limit if self._size is None else min(self._size, self._limit)
        room = (max(largest, 1) + SEGMENT_DATA - 1 - len(self._buffer)) // SEGMENT_DATA
        most = min(room, self._block_size - self._expected)
        data = segments_in_order(records, start, cob_id, self._expected, most)
        if not data:
            return 0
        count = len(data) // SEGMENT_DATA
        self._buffer += data
        self._expected += count
        self._before = bytes((self._expected - 1,)) + data[-SEGMENT_DATA:]
        self._resync, self._stuck = False, 0
        return count

    def nudge(self, out: list[CanFrame]) -> bool:
        """Acknowledge what came, because the end of the sub-block seems lost; False if there is nothing to say."""
        if self._ending or (self._expected == 1 and not self._may_repeat()):
            return False
        self._acknowledge(out)
        self._resync = True
        return True

    def _may_repeat(self) -> bool:
        """Whether to say once more that nothing came: two of these may cross, and then only the CRC notices."""
        self._stuck += 1
        return self._crc and self._resync and self._stuck <= MAX_NUDGES

    def _out_of_order(self, data: bytes, out: list[CanFrame]) -> int:
        if self._resync or data == self._before:
            return IGNORED
        if data[0] & LAST_FLAG or data[0] == self._block_size:
            self._stuck += 1
            if self._stuck > MAX_STUCK:
                return AbortCode.INVALID_SEQUENCE_NUMBER
            self._acknowledge(out)
            return PROGRESS
        return IGNORED

    def _acknowledge(self, out: list[CanFrame]) -> None:
        ack = bytes((BLOCK_ACK, self._expected - 1, self._block_size, 0, 0, 0, 0, 0))
        out.append(CanFrame(self._request_id, ack))
        self._expected = 1

    def _end(self, data: bytes, out: list[CanFrame]) -> int:
        if data[0] & SUB_COMMAND_MASK != BLOCK_END:
            return IGNORED
        unused = data[0] >> 2 & 7
        del self._buffer[len(self._buffer) - unused :]
        if self._crc and int.from_bytes(data[1:3], "little") != crc16(self._buffer):
            return AbortCode.CRC_ERROR
        if self._size is not None and len(self._buffer) < self._size:
            return AbortCode.LENGTH_TOO_LOW
        if (code := self._length_error(len(self._buffer))) != PROGRESS:
            return code
        out.append(CanFrame(self._request_id, BLOCK_END_ANSWER_FRAME))
        return DONE

    def _length_error(self, length: int) -> int:
        """Judge `length`, what the object has at least."""
        if self._size is not None and length > max(self._size, 1):  # even an empty object takes one segment
            return AbortCode.LENGTH_TOO_HIGH
        return AbortCode.OUT_OF_MEMORY if length > max(self._limit, 1) else PROGRESS


class BlockDownload:
    """Writes an object in sub-blocks, of the size that the server asks for."""

    __slots__ = ("_block_size", "_crc", "_data", "_done", "_ending", "_request_id", "_sent", "_stuck", "_total")

    result = b""
    suspect = False

    def __init__(self, request_id: int, data: bytes, crc: bool, block_size: int, out: list[CanFrame]) -> None:
        self._request_id, self._data, self._crc, self._block_size = request_id, data, crc, block_size
        self._total = max(1, -(-len(data) // SEGMENT_DATA))  # segments; an empty object takes one
        self._done = 0  # segments acknowledged
        self._sent = 0  # segments of the sub-block under way
        self._ending = False
        self._stuck = 0
        self._send(out)

    @property
    def progress(self) -> tuple[int, int | None]:
        """Bytes that are over, and how many there are, None where the server has not said."""
        return min(self._done * SEGMENT_DATA, len(self._data)), len(self._data)

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        """Take one answer of the server."""
        if out or data[0] != (BLOCK_END_ANSWER if self._ending else BLOCK_ACK):
            return IGNORED
        return DONE if self._ending else self._acknowledged(data[1], data[2], out)

    def nudge(self, out: list[CanFrame]) -> bool:  # noqa: ARG002 - the interface of all transfers
        """Return False: what is lost is the server's to ask for."""
        return False

    def _acknowledged(self, number: int, block_size: int, out: list[CanFrame]) -> int:
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            return AbortCode.INVALID_BLOCK_SIZE
        self._stuck = 0 if number else self._stuck + 1
        if number > self._sent or self._stuck > MAX_STUCK:
            return AbortCode.INVALID_SEQUENCE_NUMBER
        self._done += number
        self._block_size = block_size
        if self._done < self._total:
            self._send(out)
            return PROGRESS
        self._ending = True
        unused = self._total * SEGMENT_DATA - len(self._data)
        crc = crc16(self._data) if self._crc else 0
        out.append(CanFrame(self._request_id, BLOCK_END_FRAME.pack(BLOCK_END | unused << 2, crc)))
        return PROGRESS

    def _send(self, out: list[CanFrame]) -> None:
        """Send the next sub-block, whole."""
        self._sent = min(self._block_size, self._total - self._done)
        out += segment_frames(self._request_id, self._data, self._done, self._sent)
