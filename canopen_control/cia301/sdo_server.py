"""The SDO server of a device: every transfer kind, on an object store that decides (CiA 301, 7.2.4).

The law:
- One transfer at a time. A new initiate ends the old transfer without a word; what fits no transfer is answered with
  0x05040001, with the multiplexer 0x0000:00 if there is none to name.
- The store decides whether an object exists, may be read or written now, and takes the value; its abort code goes out.
- A client has one request outstanding. A copy of a request whose answer has not left, and the copy of the segment that
  completed a transfer, are the bus's duplicates and are not answered again.
- Nothing on the wire raises or grows: frames of a wrong length are counted, an object larger than `max_size` is refused
  with 0x05040005, a transfer that stands still for `timeout_ns` is aborted.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.cia301.abort import AbortCode, abort_text
from canopen_control.cia301.sdo_codec import (
    ABORT,
    ANSWER_BASE,
    BLOCK_ACK,
    BLOCK_DOWNLOAD_ANSWER,
    BLOCK_END,
    BLOCK_END_ANSWER,
    BLOCK_END_ANSWER_FRAME,
    BLOCK_END_FRAME,
    BLOCK_START,
    BLOCK_UPLOAD,
    BLOCK_UPLOAD_ANSWER,
    COMMAND_MASK,
    CRC_FLAG,
    DONE,
    DOWNLOAD_ANSWER,
    DOWNLOAD_SEGMENT_ANSWER,
    EXPEDITED_CODES,
    IGNORED,
    INITIATE,
    INITIATE_BYTES,
    INITIATE_NUMBER,
    LAST_FLAG,
    MAX_BLOCK_SIZE,
    MAX_NUDGES,
    MAX_STUCK,
    MAX_TRANSFER_SIZE,
    PROGRESS,
    REQUEST_BASE,
    SEGMENT,
    SEGMENT_DATA,
    SIZED_FLAG,
    SUB_COMMAND_MASK,
    TOGGLE,
    UPLOAD,
    UPLOAD_SEGMENT,
    UPLOAD_SIZED,
    crc16,
    segment_frames,
    segments_in_order,
)
from canopen_control.errors import CanopenError
from canopen_control.frame import CanFrame

if TYPE_CHECKING:
    from collections.abc import Callable


# The server's half of block transfers (CiA 301, 7.2.4.3.9 to 7.2.4.3.15).
#
# The law: a sub-block's segments are numbered from 1; the receiver acknowledges the last one that came in order, at the
# end of the sub-block or, once, when the line has been silent in its middle; the sender goes on behind it with a new
# sub-block. While segments are awaited every frame but an abort is one, whatever its first byte looks like. CRC and
# length are checked before the store sees the object.


class _Phase(enum.Enum):
    """What an upload waits for; the value is the command specifier of it."""

    START = BLOCK_START
    ACK = BLOCK_ACK
    END = BLOCK_END_ANSWER


class ServedBlockUpload:
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


class ServedBlockDownload:
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


# The server's half of segmented transfers (CiA 301, 7.2.4.3.4 and 7.2.4.3.7).
#
# The law: toggles start at 0 and alternate. The copy of the segment before, which the bus may deliver, is ignored; any
# other frame with the wrong toggle is an error. A transfer says what it makes of a frame with PROGRESS, DONE, IGNORED
# or the abort code to send; a download confirms its last segment only when the store has taken the object.


_CONFIRMATIONS = {toggle: bytes((DOWNLOAD_SEGMENT_ANSWER | toggle,)) + bytes(7) for toggle in (0, TOGGLE)}


class ServedUpload:
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


class ServedDownload:
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


class SdoServerAbort(CanopenError):
    """Raised by a store: the transfer ends with this abort code."""

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(f"abort 0x{code:08X} ({abort_text(code)})")


class ServedObjects(Protocol):
    """What the server serves; each method may raise SdoServerAbort."""

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an object."""

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Take the bytes of an object; length, limits, access and state are checked here."""

    def size_of(self, index: int, subindex: int) -> int | None:
        """Return how many bytes an object takes, None if any number.

        Asked before a download in several frames, so that one that cannot succeed ends with its first frame.
        """


class StoreFailure:
    """The store raised what it should not have; the client got 0x08000000."""

    __slots__ = ("error", "index", "subindex")

    def __init__(self, index: int, subindex: int, error: Exception) -> None:
        self.index, self.subindex, self.error = index, subindex, error


class _Transfer(Protocol):
    """What follows an initiate that was not expedited."""

    index: int
    subindex: int
    is_download: bool

    @property
    def result(self) -> bytes: ...
    def takes(self, command: int) -> bool: ...
    def receive(self, data: bytes, out: list[CanFrame]) -> int: ...
    def confirm(self, out: list[CanFrame]) -> None: ...
    def nudge(self, out: list[CanFrame]) -> bool: ...


class SdoServer:
    """One SDO channel of a device, served from `store`; see the law of this file.

    `block` False makes it a server without block transfer. `block_size` is the sub-block it asks clients for.
    `timeout_ns` ends a transfer that stands still, `silence_ns` asks for the rest of a sub-block whose end was lost.
    """

    def __init__(
        self,
        node_id: int,
        store: ServedObjects,
        *,
        block: bool = True,
        crc: bool = True,
        block_size: int = MAX_BLOCK_SIZE,
        max_size: int = MAX_TRANSFER_SIZE,
        timeout_ns: int = 3_000_000_000,
        silence_ns: int = 150_000_000,
        request_cob_id: int | None = None,
        answer_cob_id: int | None = None,
    ) -> None:
        self.node_id, self.store = node_id, store
        self.block, self.crc, self.block_size = block, crc, block_size
        self.max_size, self.timeout_ns, self.silence_ns = max_size, timeout_ns, silence_ns
        self.request_cob_id = REQUEST_BASE + node_id if request_cob_id is None else request_cob_id
        self.answer_cob_id = ANSWER_BASE + node_id if answer_cob_id is None else answer_cob_id
        self.served = 0  # transfers that succeeded
        self.aborted = 0  # aborts sent
        self.ignored = 0  # frames that were malformed or copies
        self._out: list[CanFrame] = []
        self._failures: list[StoreFailure] = []
        self._transfer: _Transfer | None = None
        self._deadline: int | None = None
        self._idle_at = 0  # when the transfer has stood still for too long
        self._last = b""  # the request answered by what is in `_out`, or the one that completed a transfer

    # -- the sans-IO verbs

    def receive(self, frame: CanFrame, now: int) -> None:
        """Take a request; frames of other COB-IDs are not ours."""
        can_id, data = frame
        if can_id != self.request_cob_id:
            return
        if len(data) != 8:
            self.ignored += 1
        elif self._transfer is not None and self._transfer.takes(data[0]):
            self._on_transfer(self._transfer, data, now)
        elif self._out and (data == self._last or len(self._out) >= _MAX_WAITING):
            self.ignored += 1
        else:
            _ON_COMMAND[data[0] >> 5](self, data, now)

    def receive_records(self, records: bytes, start: int, now: int) -> int:
        """Take what of the records from byte `start` on may be taken at once, as if each had been received.

        Return how many records that were. 0 is no refusal: the first of them is for `receive`.
        """
        if not isinstance(transfer := self._transfer, ServedBlockDownload):
            return 0
        if count := transfer.receive_records(records, start, self.request_cob_id, self._out):
            self._alive(now)
        return count

    def tick(self, now: int) -> None:
        """Let time pass: ask for what was lost, or end a transfer that stands still."""
        if self._deadline is None or now < self._deadline or (transfer := self._transfer) is None:
            return
        if now >= self._idle_at:
            self._end()
            self._abort(transfer.index, transfer.subindex, AbortCode.TIMED_OUT)
        else:
            nudged = transfer.nudge(self._out)
            self._deadline = min(now + self.silence_ns, self._idle_at) if nudged else self._idle_at

    def next_deadline(self) -> int | None:
        """Return when `tick` is due."""
        return self._deadline

    def frames(self) -> list[CanFrame]:
        """Return what to send, in order."""
        if not (out := self._out):
            return []  # never our own list: callers extend what they get
        self._out = []
        return out

    def events(self) -> list[StoreFailure]:
        """Return the defects of the store since the last call."""
        if not (failures := self._failures):
            return []
        self._failures = []
        return failures

    def reset(self) -> None:
        """Drop the transfer under way and what was to be sent: the device resets its communication."""
        self._end()
        self._out.clear()
        self._last = b""

    # -- requests outside a transfer

    def _on_upload(self, data: bytes, now: int) -> None:
        _, index, subindex = INITIATE.unpack(data)
        if self._transfer is not None:
            self._end()
        self._last = data
        if (value := self._read(index, subindex)) is not None:
            self._answer_upload(index, subindex, value, now)

    def _answer_upload(self, index: int, subindex: int, value: bytes, now: int) -> None:
        length = len(value)
        if 1 <= length <= 4:
            answer = INITIATE_BYTES.pack(UPLOAD | EXPEDITED_CODES[length], index, subindex, value)
            self.served += 1
        else:
            answer = INITIATE_NUMBER.pack(UPLOAD_SIZED, index, subindex, length)
            self._start(ServedUpload(self.answer_cob_id, index, subindex, value), now)
        self._out.append(CanFrame(self.answer_cob_id, answer))

    def _on_download(self, data: bytes, now: int) -> None:
        command, index, subindex, value = INITIATE_BYTES.unpack(data)
        self._end()
        self._last = data
        if command & 0x02:  # expedited
            if command & 0x01:
                value = value[: 4 - (command >> 2 & 3)]
            elif (size := self._size(index, subindex)) is None:
                return
            else:
                value = value[:size] if 0 <= size < 4 else value
            if self._write(index, subindex, value):
                self._confirm_download(index, subindex)
                self.served += 1
        else:
            announced = int.from_bytes(value, "little") if command & 0x01 else None
            if self._accepts(index, subindex, announced):
                self._confirm_download(index, subindex)
                self._start(ServedDownload(self.answer_cob_id, index, subindex, announced, self.max_size), now)

    def _confirm_download(self, index: int, subindex: int) -> None:
        self._out.append(CanFrame(self.answer_cob_id, INITIATE.pack(DOWNLOAD_ANSWER, index, subindex)))

    def _on_block_upload(self, data: bytes, now: int) -> None:
        if not self.block or data[0] & 0x03:  # no initiate
            self._on_stray(data, now)
            return
        command, index, subindex, (block_size, threshold, *_) = INITIATE_BYTES.unpack(data)
        self._end()
        self._last = data
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            self._abort(index, subindex, AbortCode.INVALID_BLOCK_SIZE)
        elif (value := self._read(index, subindex)) is None:
            return
        elif threshold and len(value) <= threshold:  # 0 forbids the switch
            self._answer_upload(index, subindex, value, now)
        else:
            crc = command & CRC_FLAG if self.crc else 0
            answer = INITIATE_NUMBER.pack(BLOCK_UPLOAD_ANSWER | SIZED_FLAG | crc, index, subindex, len(value))
            self._out.append(CanFrame(self.answer_cob_id, answer))
            self._start(ServedBlockUpload(self.answer_cob_id, index, subindex, value, bool(crc), block_size), now)

    def _on_block_download(self, data: bytes, now: int) -> None:
        if not self.block or data[0] & 0x01:  # no initiate
            self._on_stray(data, now)
            return
        command, index, subindex, size = INITIATE_NUMBER.unpack(data)
        self._end()
        self._last = data
        announced = size if command & SIZED_FLAG else None
        if not self._accepts(index, subindex, announced):
            return
        crc = command & CRC_FLAG if self.crc else 0
        answer = INITIATE_BYTES.pack(BLOCK_DOWNLOAD_ANSWER | crc, index, subindex, bytes((self.block_size,)))
        self._out.append(CanFrame(self.answer_cob_id, answer))
        identity = (self.answer_cob_id, index, subindex)
        self._start(ServedBlockDownload(*identity, announced, self.max_size, bool(crc), self.block_size), now)

    def _on_abort(self, data: bytes, now: int) -> None:
        if data[0] != ABORT:
            self._on_stray(data, now)
            return
        self._end()
        self._last = b""

    def _on_stray(self, data: bytes, now: int) -> None:  # noqa: ARG002 - one signature for the whole table
        """Answer what belongs to no transfer, unless it is a copy of what did."""
        if self._out or data == self._last:
            self.ignored += 1
            return
        index, subindex = (self._transfer.index, self._transfer.subindex) if self._transfer else (0, 0)
        self._end()
        self._abort(index, subindex, AbortCode.UNKNOWN_COMMAND)

    # -- transfers

    def _start(self, transfer: _Transfer, now: int) -> None:
        self._transfer = transfer
        self._alive(now)

    def _alive(self, now: int) -> None:
        self._idle_at = now + self.timeout_ns
        self._deadline = now + min(self.silence_ns, self.timeout_ns)

    def _end(self) -> None:
        self._transfer = self._deadline = None

    def _on_transfer(self, transfer: _Transfer, data: bytes, now: int) -> None:
        outcome = transfer.receive(data, self._out)
        if outcome == PROGRESS:
            self._alive(now)
        elif outcome == IGNORED:
            self.ignored += 1
        elif outcome == DONE:
            self._last = data
            self._end()
            if not transfer.is_download or self._write(transfer.index, transfer.subindex, transfer.result):
                transfer.confirm(self._out)
                self.served += 1
        else:
            self._end()
            self._abort(transfer.index, transfer.subindex, outcome)

    # -- the store

    def _accepts(self, index: int, subindex: int, announced: int | None) -> bool:
        """Whether a download of several frames may begin."""
        if (size := self._size(index, subindex)) is None:
            return False
        code = 0
        if announced is not None and announced > self.max_size:
            code = AbortCode.OUT_OF_MEMORY
        elif announced is not None and size >= 0 and announced != size:
            code = AbortCode.LENGTH_TOO_HIGH if announced > size else AbortCode.LENGTH_TOO_LOW
        if code:
            self._abort(index, subindex, code)
        return not code

    def _size(self, index: int, subindex: int) -> int | None:
        """Return the length of an object, -1 for any, None if the store aborted."""
        try:
            size = self.store.size_of(index, subindex)
        except Exception as error:  # noqa: BLE001 - a defect of the store must not stop the device
            self._store_raised(index, subindex, error)
            return None
        return -1 if size is None else size

    def _read(self, index: int, subindex: int) -> bytes | None:
        try:
            return bytes(self.store.upload(index, subindex))  # what is sent must not change under way
        except Exception as error:  # noqa: BLE001 - a defect of the store must not stop the device
            self._store_raised(index, subindex, error)
            return None

    def _write(self, index: int, subindex: int, data: bytes) -> bool:
        try:
            self.store.download(index, subindex, data)
        except Exception as error:  # noqa: BLE001 - a defect of the store must not stop the device
            self._store_raised(index, subindex, error)
            return False
        return True

    def _store_raised(self, index: int, subindex: int, error: Exception) -> None:
        if isinstance(error, SdoServerAbort):
            self._abort(index, subindex, error.code)
            return
        if len(self._failures) < _MAX_FAILURES:
            self._failures.append(StoreFailure(index, subindex, error))
        self._abort(index, subindex, AbortCode.GENERAL_ERROR)

    def _abort(self, index: int, subindex: int, code: int) -> None:
        self.aborted += 1
        self._out.append(CanFrame(self.answer_cob_id, INITIATE_NUMBER.pack(ABORT, index, subindex, code & 0xFFFFFFFF)))


_MAX_FAILURES: Final = 64  # kept for whoever asks; the first ones tell the story
_MAX_WAITING: Final = 256  # answers that nobody fetches; more than a sub-block

# By the three upper bits of the command specifier.
_ON_COMMAND: Final[tuple[Callable[[SdoServer, bytes, int], None], ...]] = (
    SdoServer._on_stray,  # noqa: SLF001 - the table of this very class; 0: download segment
    SdoServer._on_download,  # noqa: SLF001
    SdoServer._on_upload,  # noqa: SLF001
    SdoServer._on_stray,  # noqa: SLF001 - 3: upload segment
    SdoServer._on_abort,  # noqa: SLF001
    SdoServer._on_block_upload,  # noqa: SLF001
    SdoServer._on_block_download,  # noqa: SLF001
    SdoServer._on_stray,  # noqa: SLF001 - 7: reserved
)
