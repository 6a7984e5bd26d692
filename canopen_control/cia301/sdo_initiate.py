"""The first frame of an SDO transfer, and answers that servers cut short (CiA 301, 7.2.4.3).

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

__all__ = ["BLOCK_ERRORS", "completed", "initiate", "initiate_block"]

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


def initiate(request: SdoRequest, options: SdoOptions) -> bytes:
    """Return the first frame of an expedited or segmented transfer."""
    index, subindex, data = request.index, request.subindex, request.data
    if not request.is_write:
        return INITIATE.pack(UPLOAD, index, subindex)
    length, sized = len(data), options.announce_size
    if 1 <= length <= 4:
        command = DOWNLOAD | (EXPEDITED_CODES[length] if sized else SIZED_FLAG)
        return INITIATE_BYTES.pack(command, index, subindex, data)
    return INITIATE_NUMBER.pack(DOWNLOAD | sized, index, subindex, length if sized else 0)


def initiate_block(request: SdoRequest, options: SdoOptions) -> bytes:
    """Return the first frame of a block transfer."""
    crc = CRC_FLAG if options.crc else 0
    index, subindex = request.index, request.subindex
    if not request.is_write:
        parameters = bytes((options.block_size, options.switch_threshold))
        return INITIATE_BYTES.pack(BLOCK_UPLOAD | crc, index, subindex, parameters)
    sized, length = (SIZED_FLAG, len(request.data)) if options.announce_size else (0, 0)
    return INITIATE_NUMBER.pack(BLOCK_DOWNLOAD | crc | sized, index, subindex, length)


def completed(data: bytes) -> bytes:
    """Fill up a frame that was cut behind its last used byte; empty if it lacks a byte that counts."""
    if len(data) < 4 or len(data) > 8:
        return b""
    used = {ABORT: 8, DOWNLOAD_ANSWER: 4}.get(data[0], 4 + EXPEDITED_LENGTHS.get(data[0], 4))
    return data.ljust(8, b"\0") if len(data) >= used else b""
