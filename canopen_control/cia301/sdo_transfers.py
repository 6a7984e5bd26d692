"""Segmented and block SDO transfers, client and server (CiA 301, 7.2.4.3).

A transfer begins after the initiate request and its answer. Each direction is implemented once: a receiver or a sender
is the base class of the client's and of the server's transfer. `receive` processes a frame of the other side, appends
frames to `out`, and returns PROGRESS, DONE, IGNORED or the abort code to send; the owner of the transfer sends the
abort and ends the transfer.

Segments (7.2.4.3.4 and 7.2.4.3.7) have a toggle bit that starts at 0 and alternates. The bus may deliver a frame twice
in succession: a client ignores one copy of the previous frame, a server a copy that comes before it has answered. A
server aborts a toggle bit that is repeated later.

The segments of a sub-block (7.2.4.3.10 and 7.2.4.3.14) are numbered from 1 and not confirmed one by one. The receiver
acknowledges a sub-block with the number of the last segment in order; the sender continues after this segment with a
new sub-block, numbered from 1 again. If the end of a sub-block is lost, the receiver acknowledges after a silence, and
then waits for segment 1. The CRC (7.2.4.3.16) is checked if both sides support it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

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
    DOWNLOAD_SEGMENT_ANSWER,
    IGNORED,
    LAST_FLAG,
    MAX_BLOCK_SIZE,
    PROGRESS,
    SEGMENT,
    SEGMENT_DATA,
    SUB_COMMAND_MASK,
    TOGGLE,
    UPLOAD_SEGMENT,
    crc16,
    segment_frame,
    segment_frames,
    segments_in_order,
)
from canopen_control.frame import CanFrame

if TYPE_CHECKING:
    from collections.abc import Sequence


_MAX_SILENT_ACKNOWLEDGEMENTS: Final = 3  # in a row, without a segment after them
_MAX_EMPTY_SUB_BLOCKS: Final = 16  # in a row, of which no segment arrived in order

_REQUESTS: Final = tuple(bytes((UPLOAD_SEGMENT | toggle,)) + bytes(7) for toggle in (0, TOGGLE))
_CONFIRMATIONS: Final = tuple(bytes((DOWNLOAD_SEGMENT_ANSWER | toggle,)) + bytes(7) for toggle in (0, TOGGLE))
_START: Final = bytes((BLOCK_START, 0, 0, 0, 0, 0, 0, 0))


def _frame(cob_id: int, frames: Sequence[bytes], toggle: int) -> CanFrame:
    return CanFrame(cob_id, frames[1 if toggle else 0])


class SegmentReceiver:
    """Receiver of segments; `size` is the announced size in bytes or None, `limit` the maximum size accepted."""

    def __init__(self, cob_id: int, size: int | None, limit: int) -> None:
        self._cob_id, self._size, self._limit = cob_id, size, limit
        self._buffer = bytearray()
        self._toggle = 0
        self._previous = b""

    @property
    def result(self) -> bytes:
        """Bytes received so far, without padding."""
        return bytes(self._buffer)

    @property
    def progress(self) -> tuple[int, int | None]:
        return len(self._buffer), self._size

    def _append(self, data: bytes) -> int:
        self._previous = data
        self._toggle ^= TOGGLE
        self._buffer += data[1 : 8 - (data[0] >> 1 & 7)]
        last = bool(data[0] & 1)
        code = self._length_error(len(self._buffer), last)
        return DONE if last and code == PROGRESS else code

    def _length_error(self, length: int, last: bool) -> int:
        """Return PROGRESS, or the abort code for a wrong length; `length` is final if `last`."""
        size = self._size
        # CiA 301, table 22: 0x05040005, out of memory
        if length > self._limit:
            return AbortCode.OUT_OF_MEMORY
        # CiA 301, table 22: 0x06070012 too long, 0x06070013 too short for the announced size
        if size is not None and length > size:
            return AbortCode.LENGTH_TOO_HIGH
        if last and size is not None and length < size:
            return AbortCode.LENGTH_TOO_LOW
        return PROGRESS


class BlockReceiver(SegmentReceiver):
    """Receiver of sub-blocks of `block_size` segments, with or without a CRC at the end."""

    def __init__(self, cob_id: int, size: int | None, limit: int, crc: bool, block_size: int) -> None:
        super().__init__(cob_id, size, limit)
        self._crc, self._block_size = crc, block_size
        self._in_order = 0  # number of the last segment in order
        self._resync = False  # acknowledged after a silence: the rest of the old sub-block is ignored
        self._complete = False  # the last segment was received
        self._stuck = 0  # sub-blocks or silences since the last segment in order

    def receive_records(self, records: bytes, start: int, cob_id: int, out: list[CanFrame]) -> int:
        """Receive the consecutive segments beginning at byte `start` of `records` at once; return their number.

        Segments that must be acknowledged or make the object too large are left to `receive`.
        """
        if out or self._complete:
            return 0
        largest = self._limit if self._size is None else min(self._limit, self._size)
        room = (max(largest, 1) + SEGMENT_DATA - 1 - len(self._buffer)) // SEGMENT_DATA
        most = min(room, self._block_size - 1 - self._in_order)
        data = segments_in_order(records, start, cob_id, self._in_order + 1, most)
        if data:
            self._buffer += data
            self._in_order += len(data) // SEGMENT_DATA
            self._previous = bytes((self._in_order,)) + data[-SEGMENT_DATA:]
            self._resync, self._stuck = False, 0
        return len(data) // SEGMENT_DATA

    def acknowledge_on_silence(self, out: list[CanFrame]) -> bool:
        """Acknowledge the segments received so far, as if the sub-block had ended; return False if that cannot help.

        An acknowledgement without a new segment is repeated only with a CRC: two of these may cross, and then nothing
        else detects a gap.
        """
        if self._complete or out:
            return False
        if not self._in_order:
            self._stuck += 1
            if not (self._crc and self._resync and self._stuck <= _MAX_SILENT_ACKNOWLEDGEMENTS):
                return False
        self._acknowledge(out)
        self._resync = True
        return True

    def _receive_segment(self, data: bytes, out: list[CanFrame]) -> int:
        # CiA 301, 7.2.4.3.10 and 7.2.4.3.14: sequence numbers from 1; the last one in order is acknowledged
        if data[0] & ~LAST_FLAG != self._in_order + 1:
            return self._out_of_order(data, out)
        self._previous, self._resync, self._stuck = data, False, 0
        self._in_order += 1
        self._buffer += data[1:]
        self._complete = data[0] & LAST_FLAG != 0
        # Only the last segment has padding, and only the segment of an empty object consists of padding alone.
        at_least = len(self._buffer) - SEGMENT_DATA + (len(self._buffer) > SEGMENT_DATA)
        if (code := self._length_error(at_least, last=False)) != PROGRESS:
            return code
        if self._complete or self._in_order == self._block_size:
            self._acknowledge(out)
        return PROGRESS

    def _out_of_order(self, data: bytes, out: list[CanFrame]) -> int:
        if self._resync or data == self._previous:
            return IGNORED
        if data[0] & LAST_FLAG or data[0] == self._block_size:
            self._stuck += 1
            # CiA 301, table 22: 0x05040003, invalid sequence number
            if self._stuck > _MAX_EMPTY_SUB_BLOCKS:
                return AbortCode.INVALID_SEQUENCE_NUMBER
            self._acknowledge(out)
        return PROGRESS

    def _acknowledge(self, out: list[CanFrame]) -> None:
        ack = bytes((BLOCK_ACK, self._in_order, self._block_size, 0, 0, 0, 0, 0))
        out.append(CanFrame(self._cob_id, ack))
        self._in_order = 0

    def _end(self, data: bytes) -> int:
        """Remove the padding and check CRC and length; return DONE or an abort code."""
        unused = data[0] >> 2 & 7
        del self._buffer[len(self._buffer) - unused :]
        # CiA 301, 7.2.4.3.16: the CRC covers the bytes of the object only
        if self._crc and int.from_bytes(data[1:3], "little") != crc16(self._buffer):
            return AbortCode.CRC_ERROR
        code = self._length_error(len(self._buffer), last=True)
        return DONE if code == PROGRESS else code


class BlockSender:
    """Sender of sub-blocks, whose size the receiver sets in each acknowledgement."""

    result: Final = b""

    def __init__(self, cob_id: int, data: bytes, crc: bool, block_size: int) -> None:
        self._cob_id, self._data, self._crc, self._block_size = cob_id, data, crc, block_size
        self._total = max(1, -(-len(data) // SEGMENT_DATA))  # segments; an empty object has one segment
        self._first = 0  # index of the first segment of the current sub-block
        self._sent = 0  # number of segments in it
        self._stuck = 0  # acknowledgements in a row of 0 segments
        self._expected = BLOCK_ACK  # command specifier of the next frame of the receiver

    @property
    def progress(self) -> tuple[int, int | None]:
        return min(self._first * SEGMENT_DATA, len(self._data)), len(self._data)

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        """Process the receiver's next expected frame; ignore frames with any other command specifier."""
        if out or data[0] != self._expected:
            return IGNORED
        if self._expected == BLOCK_END_ANSWER:
            return DONE
        if self._expected == BLOCK_ACK and (code := self._acknowledged(data[1], data[2])) != PROGRESS:
            return code
        self._send(out)
        return PROGRESS

    def acknowledge_on_silence(self, out: list[CanFrame]) -> bool:  # noqa: ARG002 - interface of all transfers
        """Return False; a sender acknowledges nothing."""
        return False

    def _acknowledged(self, number: int, block_size: int) -> int:
        if not 1 <= block_size <= MAX_BLOCK_SIZE:  # CiA 301, 7.2.4.3.10 and 7.2.4.3.14: 1 to 127
            return AbortCode.INVALID_BLOCK_SIZE
        self._stuck = 0 if number else self._stuck + 1
        # CiA 301, table 22: 0x05040003, an acknowledged segment that was not sent
        if number > self._sent or self._stuck > _MAX_EMPTY_SUB_BLOCKS:
            return AbortCode.INVALID_SEQUENCE_NUMBER
        self._first += number
        self._block_size = block_size
        return PROGRESS

    def _send(self, out: list[CanFrame]) -> None:
        """Send the next sub-block, or the end with the CRC after the last sub-block."""
        if self._first < self._total:
            self._expected = BLOCK_ACK
            self._sent = min(self._block_size, self._total - self._first)
            out += segment_frames(self._cob_id, self._data, self._first, self._sent)
            return
        self._expected = BLOCK_END_ANSWER
        unused = self._total * SEGMENT_DATA - len(self._data)
        crc = crc16(self._data) if self._crc else 0
        out.append(CanFrame(self._cob_id, BLOCK_END_FRAME.pack(BLOCK_END | unused << 2, crc)))


# -- client


class SegmentedUpload(SegmentReceiver):
    """Upload of an object by a client, segment by segment (CiA 301, 7.2.4.3.7)."""

    def __init__(self, cob_id: int, size: int | None, limit: int, out: list[CanFrame]) -> None:
        super().__init__(cob_id, size, limit)
        self.toggle_suspect = False  # a copy was ignored, and no segment has followed
        out.append(_frame(cob_id, _REQUESTS, 0))

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        if data[0] & COMMAND_MASK != SEGMENT or out:  # an answer cannot precede its request
            return IGNORED
        if data[0] & TOGGLE != self._toggle:
            # CiA 301, table 22: 0x05030000, toggle bit not alternated; a copy of the last answer is ignored
            if data != self._previous or self.toggle_suspect:
                return AbortCode.TOGGLE_NOT_ALTERNATED
            self.toggle_suspect = True
            return IGNORED
        self.toggle_suspect = False
        outcome = self._append(data)
        if outcome != PROGRESS:
            return outcome
        if data[0] & 0x0E == 0x0E:  # empty segments without an end would never complete the transfer
            return AbortCode.GENERAL_ERROR
        out.append(_frame(self._cob_id, _REQUESTS, self._toggle))
        return PROGRESS

    def acknowledge_on_silence(self, out: list[CanFrame]) -> bool:  # noqa: ARG002
        """Return False; a lost segment cannot be requested again."""
        return False


class SegmentedDownload:
    """Download of an object by a client, segment by segment (CiA 301, 7.2.4.3.4)."""

    result: Final = b""

    def __init__(self, cob_id: int, data: bytes, out: list[CanFrame]) -> None:
        self._cob_id, self._data = cob_id, data
        self._offset = 0
        self._toggle = 0
        self.toggle_suspect = False  # a copy was ignored, and no confirmation has followed
        out.append(segment_frame(cob_id, data, 0, 0))

    @property
    def progress(self) -> tuple[int, int | None]:
        return min(self._offset, len(self._data)), len(self._data)

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        # CiA 301, 7.2.4.3.4: scs 1, the answer to a download segment
        if data[0] & COMMAND_MASK != DOWNLOAD_SEGMENT_ANSWER or out:
            return IGNORED
        # CiA 301, 7.2.4.3.4: the toggle bit alternates; one copy of the last confirmation is ignored
        if data[0] & TOGGLE != self._toggle:
            if self._offset == 0 or self.toggle_suspect:
                return AbortCode.TOGGLE_NOT_ALTERNATED
            self.toggle_suspect = True
            return IGNORED
        self.toggle_suspect = False
        self._offset += SEGMENT_DATA
        if self._offset >= len(self._data):
            return DONE
        self._toggle ^= TOGGLE
        out.append(segment_frame(self._cob_id, self._data, self._offset, self._toggle))
        return PROGRESS

    def acknowledge_on_silence(self, out: list[CanFrame]) -> bool:  # noqa: ARG002
        """Return False; a client must not send a segment twice."""
        return False


class BlockUpload(BlockReceiver):
    """Upload of an object by a client in sub-blocks (CiA 301, 7.2.4.3.14 and 7.2.4.3.15)."""

    toggle_suspect: Final = False

    def __init__(
        self, cob_id: int, size: int | None, limit: int, crc: bool, block_size: int, out: list[CanFrame]
    ) -> None:
        super().__init__(cob_id, size, limit, crc, block_size)
        out.append(CanFrame(cob_id, _START))

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        if out:  # the acknowledgement was not sent yet: a copy of the last segment
            return IGNORED
        if not self._complete:
            return self._receive_segment(data, out)
        # CiA 301, 7.2.4.3.15: ends a block upload with its CRC and the unused bytes
        if data[0] & SUB_COMMAND_MASK != BLOCK_END or data == self._previous:
            return IGNORED
        outcome = self._end(data)
        if outcome == DONE:
            out.append(CanFrame(self._cob_id, BLOCK_END_ANSWER_FRAME))
        return outcome


class BlockDownload(BlockSender):
    """Download of an object by a client in sub-blocks (CiA 301, 7.2.4.3.10 and 7.2.4.3.11)."""

    toggle_suspect: Final = False

    def __init__(self, cob_id: int, data: bytes, crc: bool, block_size: int, out: list[CanFrame]) -> None:
        super().__init__(cob_id, data, crc, block_size)
        self._send(out)


# -- server: `takes` selects the requests of the transfer, `confirm` ends a download that the store has accepted


class ServedUpload:
    """Upload of an object from a server, segment by segment (CiA 301, 7.2.4.3.7)."""

    is_download: Final = False
    result: Final = b""

    def __init__(self, cob_id: int, index: int, subindex: int, data: bytes) -> None:
        self._cob_id, self.index, self.subindex = cob_id, index, subindex
        self._data = data
        self._offset = 0
        self._toggle = 0

    def takes(self, command: int) -> bool:
        return command & COMMAND_MASK == UPLOAD_SEGMENT

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        toggle = data[0] & TOGGLE
        if out:
            return IGNORED  # a copy by the bus: the client cannot have the answer yet
        if toggle != self._toggle:  # CiA 301, 7.2.4.3.7: it alternates
            return AbortCode.TOGGLE_NOT_ALTERNATED
        out.append(segment_frame(self._cob_id, self._data, self._offset, toggle))
        self._offset += SEGMENT_DATA
        self._toggle ^= TOGGLE
        return DONE if self._offset >= len(self._data) else PROGRESS

    def confirm(self, out: list[CanFrame]) -> None:
        """Do nothing; the last segment ends the transfer."""

    def acknowledge_on_silence(self, out: list[CanFrame]) -> bool:  # noqa: ARG002
        """Return False; the client requests segments."""
        return False


class ServedDownload(SegmentReceiver):
    """Download of an object to a server, segment by segment (CiA 301, 7.2.4.3.4)."""

    is_download: Final = True

    def __init__(self, cob_id: int, index: int, subindex: int, size: int | None, limit: int) -> None:
        super().__init__(cob_id, size, limit)
        self.index, self.subindex = index, subindex

    def takes(self, command: int) -> bool:
        return command & COMMAND_MASK == SEGMENT

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        if out:
            return IGNORED  # a copy by the bus: the client cannot have the answer yet
        if data[0] & TOGGLE != self._toggle:  # CiA 301, 7.2.4.3.4: it alternates
            return AbortCode.TOGGLE_NOT_ALTERNATED
        outcome = self._append(data)
        if outcome == PROGRESS:
            self.confirm(out)
        return outcome

    def confirm(self, out: list[CanFrame]) -> None:
        out.append(_frame(self._cob_id, _CONFIRMATIONS, self._toggle ^ TOGGLE))

    def acknowledge_on_silence(self, out: list[CanFrame]) -> bool:  # noqa: ARG002
        """Return False; a lost segment cannot be requested again."""
        return False


class ServedBlockUpload(BlockSender):
    """Upload of an object from a server in sub-blocks (CiA 301, 7.2.4.3.14 and 7.2.4.3.15)."""

    is_download: Final = False

    def __init__(self, cob_id: int, index: int, subindex: int, data: bytes, crc: bool, block_size: int) -> None:
        super().__init__(cob_id, data, crc, block_size)
        self.index, self.subindex = index, subindex
        self._expected = BLOCK_START

    def takes(self, command: int) -> bool:
        return command & COMMAND_MASK == BLOCK_UPLOAD and command & 0x03 != 0

    def confirm(self, out: list[CanFrame]) -> None:
        """Do nothing; the client's response ends the transfer."""


class ServedBlockDownload(BlockReceiver):
    """Download of an object to a server in sub-blocks (CiA 301, 7.2.4.3.10 and 7.2.4.3.11)."""

    is_download: Final = True

    def __init__(
        self, cob_id: int, index: int, subindex: int, size: int | None, limit: int, crc: bool, block_size: int
    ) -> None:
        super().__init__(cob_id, size, limit, crc, block_size)
        self.index, self.subindex = index, subindex

    def takes(self, command: int) -> bool:
        """Whether a frame with this first byte belongs to the transfer: any but 0x80 (abort) may begin a segment."""
        if self._complete:
            return command & SUB_COMMAND_MASK == BLOCK_END or command == self._previous[0]
        return command != ABORT

    def receive(self, data: bytes, out: list[CanFrame]) -> int:
        if out or (self._complete and data == self._previous):
            return IGNORED
        if not self._complete:
            return self._receive_segment(data, out)
        return self._end(data) if data[0] & SUB_COMMAND_MASK == BLOCK_END else AbortCode.UNKNOWN_COMMAND

    def confirm(self, out: list[CanFrame]) -> None:
        out.append(CanFrame(self._cob_id, BLOCK_END_ANSWER_FRAME))
