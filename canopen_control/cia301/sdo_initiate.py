"""How an SDO transfer begins on the client's side: its first frame, and what the answer must at least be.

The law: what fits four bytes goes with the initiate (expedited), everything else in segments or blocks. Some servers
cut their frames behind the last used byte, although CiA 301 wants eight: that is made good where no byte is missing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_codec import (
    ABORT,
    BLOCK_DOWNLOAD,
    BLOCK_UPLOAD,
    CRC_FLAG,
    DOWNLOAD,
    DOWNLOAD_ANSWER,
    EXPEDITED_CODES,
    EXPEDITED_LENGTHS,
    INITIATE,
    INITIATE_BYTES,
    INITIATE_NUMBER,
    SIZED_FLAG,
    UPLOAD,
)

if TYPE_CHECKING:
    from canopen_control.cia301.sdo_request import SdoOptions, SdoRequest

__all__ = [
    "AWAIT_BLOCK_DOWNLOAD",
    "AWAIT_BLOCK_UPLOAD",
    "AWAIT_DOWNLOAD",
    "AWAIT_NOTHING",
    "AWAIT_PROBE",
    "AWAIT_UPLOAD",
    "BLOCK_ERRORS",
    "BLOCK_KINDS",
    "completed",
    "fitted",
    "initiate",
]

# What a client waits for; plain numbers, because the hot path compares them.
AWAIT_NOTHING: Final = 0
AWAIT_UPLOAD: Final = 1
AWAIT_DOWNLOAD: Final = 2
AWAIT_BLOCK_UPLOAD: Final = 3
AWAIT_BLOCK_DOWNLOAD: Final = 4
AWAIT_PROBE: Final = 5

BLOCK_KINDS: Final = frozenset((AWAIT_BLOCK_UPLOAD, AWAIT_BLOCK_DOWNLOAD))
BLOCK_ERRORS: Final = frozenset(  # what segments may still do: without CRC a lost segment shows in the length
    (
        AbortCode.UNKNOWN_COMMAND,
        AbortCode.INVALID_BLOCK_SIZE,
        AbortCode.INVALID_SEQUENCE_NUMBER,
        AbortCode.CRC_ERROR,
        AbortCode.LENGTH_TOO_HIGH,
        AbortCode.LENGTH_TOO_LOW,
    ),
)


def initiate(request: SdoRequest, options: SdoOptions, block: bool) -> tuple[int, bytes]:
    """Return what to wait for, and the first frame."""
    if block:
        return _initiate_block(request, options)
    index, subindex, data = request.index, request.subindex, request.data
    if not request.is_write:
        return AWAIT_UPLOAD, INITIATE.pack(UPLOAD, index, subindex)
    length, sized = len(data), options.announce_size
    if 1 <= length <= 4:
        command = DOWNLOAD | (EXPEDITED_CODES[length] if sized else SIZED_FLAG)
        return AWAIT_DOWNLOAD, INITIATE_BYTES.pack(command, index, subindex, data)
    return AWAIT_DOWNLOAD, INITIATE_NUMBER.pack(DOWNLOAD | sized, index, subindex, length if sized else 0)


def _initiate_block(request: SdoRequest, options: SdoOptions) -> tuple[int, bytes]:
    crc = CRC_FLAG if options.crc else 0
    index, subindex = request.index, request.subindex
    if not request.is_write:
        parameters = bytes((options.block_size, options.switch_threshold))
        return AWAIT_BLOCK_UPLOAD, INITIATE_BYTES.pack(BLOCK_UPLOAD | crc, index, subindex, parameters)
    sized, length = (SIZED_FLAG, len(request.data)) if options.announce_size else (0, 0)
    return AWAIT_BLOCK_DOWNLOAD, INITIATE_NUMBER.pack(BLOCK_DOWNLOAD | crc | sized, index, subindex, length)


def completed(data: bytes) -> bytes:
    """Fill up a frame that was cut behind its last used byte; empty if it lacks a byte that counts."""
    if len(data) < 4 or len(data) > 8:
        return b""
    used = {ABORT: 8, DOWNLOAD_ANSWER: 4}.get(data[0], 4 + EXPEDITED_LENGTHS.get(data[0], 4))
    return data.ljust(8, b"\0") if len(data) >= used else b""


def fitted(data: bytes, size: int, sized: bool, lenient: bool) -> tuple[bytes, int]:
    """Return what was read as the `size` bytes it should have, and 0; or else an abort code."""
    if len(data) == size:
        return data, 0
    if len(data) < size:
        return data.ljust(size, b"\0"), 0 if lenient else AbortCode.LENGTH_TOO_LOW
    return data[:size], AbortCode.LENGTH_TOO_HIGH if sized else 0
