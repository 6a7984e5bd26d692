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

from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.cia301.abort import AbortCode, abort_text
from canopen_control.cia301.sdo_codec import (
    ABORT,
    ANSWER_BASE,
    BLOCK_DOWNLOAD_ANSWER,
    BLOCK_UPLOAD_ANSWER,
    CRC_FLAG,
    DONE,
    DOWNLOAD_ANSWER,
    EXPEDITED_CODES,
    IGNORED,
    INITIATE,
    INITIATE_BYTES,
    INITIATE_NUMBER,
    MAX_BLOCK_SIZE,
    MAX_TRANSFER_SIZE,
    PROGRESS,
    REQUEST_BASE,
    SIZED_FLAG,
    UPLOAD,
    UPLOAD_SIZED,
)
from canopen_control.cia301.sdo_server_block import BlockDownload, BlockUpload
from canopen_control.cia301.sdo_server_segmented import SegmentedDownload, SegmentedUpload
from canopen_control.errors import CanopenError
from canopen_control.frame import CanFrame

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ObjectStore", "SdoServer", "SdoServerAbort", "StoreFailure"]


class SdoServerAbort(CanopenError):
    """Raised by a store: the transfer ends with this abort code."""

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(f"abort 0x{code:08X} ({abort_text(code)})")


class ObjectStore(Protocol):
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
        store: ObjectStore,
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
        if not isinstance(transfer := self._transfer, BlockDownload):
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
            self._start(SegmentedUpload(self.answer_cob_id, index, subindex, value), now)
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
                self._start(SegmentedDownload(self.answer_cob_id, index, subindex, announced, self.max_size), now)

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
            self._start(BlockUpload(self.answer_cob_id, index, subindex, value, bool(crc), block_size), now)

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
        self._start(BlockDownload(*identity, announced, self.max_size, bool(crc), self.block_size), now)

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
