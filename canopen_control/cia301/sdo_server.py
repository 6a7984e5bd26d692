"""SDO server of a device: expedited, segmented and block transfers of the objects of a store (CiA 301, 7.2.4).

Rules:
- There is one transfer at a time. A new initiate request ends the previous transfer silently. A frame outside of a
  transfer is answered with abort 0x05040001, with multiplexer 0x0000:00 if no transfer is active.
- The store checks existence, access and value of an object; its abort code is sent.
- A client has one request outstanding. A copy of a request whose answer was not sent yet, and a copy of the segment
  that completed a transfer, are duplicates by the bus and are not answered.
- Frames never raise or use unlimited memory: frames of a wrong length are counted, an object larger than `max_size` is
  refused with 0x05040005, and a transfer without progress for `timeout_ns` is aborted.
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
from canopen_control.cia301.sdo_transfers import (
    ServedBlockDownload,
    ServedBlockUpload,
    ServedDownload,
    ServedUpload,
)
from canopen_control.errors import CanopenError
from canopen_control.frame import CanFrame

if TYPE_CHECKING:
    from collections.abc import Callable


class SdoServerAbort(CanopenError):
    """Error with which an object store refuses an access; the transfer is aborted with `code`."""

    def __init__(self, code: int) -> None:
        self.code = code
        super().__init__(f"abort 0x{code:08X} ({abort_text(code)})")


class ServedObjects(Protocol):
    """Object store of an SDO server; each method may raise SdoServerAbort."""

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an object."""

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write the bytes of an object; the store checks length, limits, access and state."""

    def size_of(self, index: int, subindex: int) -> int | None:
        """Return the size of an object in bytes, or None if it is variable.

        Called before a download in several frames, so that a wrong size is refused at the initiate.
        """


class StoreFailure:
    """Unexpected exception of the object store; the client has received abort 0x08000000."""

    __slots__ = ("error", "index", "subindex")

    def __init__(self, index: int, subindex: int, error: Exception) -> None:
        self.index, self.subindex, self.error = index, subindex, error


class _Transfer(Protocol):
    """Segmented or block transfer after an initiate request; see `sdo_transfers`."""

    index: int
    subindex: int

    @property
    def is_download(self) -> bool: ...
    @property
    def result(self) -> bytes: ...
    def takes(self, command: int) -> bool: ...
    def receive(self, data: bytes, out: list[CanFrame]) -> int: ...
    def confirm(self, out: list[CanFrame]) -> None: ...
    def acknowledge_on_silence(self, out: list[CanFrame]) -> bool: ...


class SdoServer:
    """SDO server on one pair of COB-IDs; `store` contains the objects.

    `block` enables block transfer, with sub-blocks of `block_size` segments in downloads. `timeout_ns` ends a transfer
    without progress; after `silence_ns` a sub-block without its end is acknowledged.
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
        self.served = 0  # number of successful transfers
        self.aborted = 0  # number of aborts sent
        self.ignored = 0  # number of malformed and duplicate frames
        self._out: list[CanFrame] = []
        self._failures: list[StoreFailure] = []
        self._transfer: _Transfer | None = None
        self._deadline: int | None = None
        self._idle_at = 0  # time at which the transfer is aborted
        self._last = b""  # request whose answer is in `_out`, or which completed a transfer

    # -- sans-IO interface

    def receive(self, frame: CanFrame, now: int) -> None:
        can_id, data = frame
        if can_id != self.request_cob_id:
            return
        # CiA 301, 7.2.4.3: every SDO frame has 8 bytes
        if len(data) != 8:
            self.ignored += 1
        elif self._transfer is not None and self._transfer.takes(data[0]):
            self._on_transfer(self._transfer, data, now)
        elif self._out and (data == self._last or len(self._out) >= _MAX_WAITING):
            self.ignored += 1
        else:
            _ON_COMMAND[data[0] >> 5](self, data, now)

    def receive_records(self, records: bytes, start: int, now: int) -> int:
        """Process several frame records together, starting at byte `start`, as if each were passed to `receive`.

        Return the number of records processed; if it is 0, pass the first record to `receive`.
        """
        if not isinstance(transfer := self._transfer, ServedBlockDownload):
            return 0
        if count := transfer.receive_records(records, start, self.request_cob_id, self._out):
            self._alive(now)
        return count

    def tick(self, now: int) -> None:
        """Acknowledge an incomplete sub-block, or abort a transfer without progress."""
        if self._deadline is None or now < self._deadline or (transfer := self._transfer) is None:
            return
        if now >= self._idle_at:
            self._end()
            self._abort(transfer.index, transfer.subindex, AbortCode.TIMED_OUT)
        else:
            acknowledged = transfer.acknowledge_on_silence(self._out)
            self._deadline = min(now + self.silence_ns, self._idle_at) if acknowledged else self._idle_at

    def next_deadline(self) -> int | None:
        return self._deadline

    def frames(self) -> list[CanFrame]:
        if not (out := self._out):
            return []  # a new list, because callers extend the result
        self._out = []
        return out

    def events(self) -> list[StoreFailure]:
        if not (failures := self._failures):
            return []
        self._failures = []
        return failures

    def reset(self) -> None:
        """Discard the transfer and the frames to send (NMT reset communication)."""
        self._end()
        self._out.clear()
        self._last = b""

    # -- initiates

    def _on_upload(self, data: bytes, now: int) -> None:
        _, index, subindex = INITIATE.unpack(data)
        if self._transfer is not None:
            self._end()
        self._last = data
        if (value := self._read(index, subindex)) is not None:
            self._answer_upload(index, subindex, value, now)

    def _answer_upload(self, index: int, subindex: int, value: bytes, now: int) -> None:
        length = len(value)
        # CiA 301, 7.2.4.3.6: up to four bytes are in the answer (expedited)
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
        if command & 0x02:  # e bit: expedited (CiA 301, 7.2.4.3.3)
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
        if not self.block or data[0] & 0x03:  # not an initiate (CiA 301, 7.2.4.3.13)
            self._on_stray(data, now)
            return
        command, index, subindex, (block_size, threshold, *_) = INITIATE_BYTES.unpack(data)
        self._end()
        self._last = data
        # CiA 301, 7.2.4.3.13: 1 to 127 segments per sub-block
        if not 1 <= block_size <= MAX_BLOCK_SIZE:
            self._abort(index, subindex, AbortCode.INVALID_BLOCK_SIZE)
        elif (value := self._read(index, subindex)) is None:
            return
        elif threshold and len(value) <= threshold:  # 0 forbids the switch (CiA 301, 7.2.4.3.13)
            self._answer_upload(index, subindex, value, now)
        else:
            crc = command & CRC_FLAG if self.crc else 0
            answer = INITIATE_NUMBER.pack(BLOCK_UPLOAD_ANSWER | SIZED_FLAG | crc, index, subindex, len(value))
            self._out.append(CanFrame(self.answer_cob_id, answer))
            self._start(ServedBlockUpload(self.answer_cob_id, index, subindex, value, bool(crc), block_size), now)

    def _on_block_download(self, data: bytes, now: int) -> None:
        if not self.block or data[0] & 0x01:  # not an initiate (CiA 301, 7.2.4.3.9)
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
        """Abort with 0x05040001 after a frame outside the transfer, unless it is a copy (CiA 301, 7.2.4.3.17)."""
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

    # -- store

    def _accepts(self, index: int, subindex: int, announced: int | None) -> bool:
        """Whether a download of several frames may start; if not, send an abort."""
        if (size := self._size(index, subindex)) is None:
            return False
        code = 0
        if announced is not None and announced > self.max_size:
            code = AbortCode.OUT_OF_MEMORY
        # CiA 301, table 22: 0x06070012 too long, 0x06070013 too short
        elif announced is not None and size >= 0 and announced != size:
            code = AbortCode.LENGTH_TOO_HIGH if announced > size else AbortCode.LENGTH_TOO_LOW
        if code:
            self._abort(index, subindex, code)
        return not code

    def _size(self, index: int, subindex: int) -> int | None:
        """Return the size of an object: -1 if variable, None if the store aborted."""
        try:
            size = self.store.size_of(index, subindex)
        except Exception as error:  # noqa: BLE001 - a defect of the store must not stop the device
            self._store_raised(index, subindex, error)
            return None
        return -1 if size is None else size

    def _read(self, index: int, subindex: int) -> bytes | None:
        try:
            # a copy, because the data must not change during the transfer
            return bytes(self.store.upload(index, subindex))
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


_MAX_FAILURES: Final = 64  # further exceptions are not kept
_MAX_WAITING: Final = 256  # maximum number of waiting answers, more than a sub-block

# Handlers, indexed by the upper three bits of the command specifier.
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
