"""Frame layouts of SDO, shared by client and server (CiA 301, 7.2.4.3).

Every SDO frame has eight bytes; unused bytes are zero. Byte 0 is the command specifier, bytes 1 to 3 of an initiate
request or an abort are the multiplexer (index little-endian, subindex). Client and server share only these layouts and
the transfer of segments; their state machines are separate, so that tests of one against the other are meaningful.
"""

from __future__ import annotations

import binascii
import struct
from typing import TYPE_CHECKING, Final

from canopen_control.frame import RECORD, RECORD_SIZE, CanFrame, Service, cob_id, make_frame

if TYPE_CHECKING:
    from collections.abc import Callable


REQUEST_BASE: Final = cob_id(Service.SDO_CLIENT)  # plus node-ID
ANSWER_BASE: Final = cob_id(Service.SDO_SERVER)

COMMAND_MASK: Final = 0xE0  # ccs and scs: the three upper bits
DOWNLOAD: Final = 0x20  # client: initiate download; plus n, e, s
DOWNLOAD_ANSWER: Final = 0x60
DOWNLOAD_SEGMENT_ANSWER: Final = 0x20
UPLOAD: Final = 0x40  # client: initiate upload; server: its answer, plus n, e, s
UPLOAD_SIZED: Final = 0x41
UPLOAD_UNSIZED: Final = 0x40
UPLOAD_SEGMENT: Final = 0x60
SEGMENT: Final = 0x00  # frame with a segment, in both directions
TOGGLE: Final = 0x10
ABORT: Final = 0x80

BLOCK_DOWNLOAD: Final = 0xC0  # client: plus CRC_FLAG, SIZED_FLAG
BLOCK_DOWNLOAD_ANSWER: Final = 0xA0
BLOCK_UPLOAD: Final = 0xA0  # client: plus CRC_FLAG
BLOCK_UPLOAD_ANSWER: Final = 0xC0
BLOCK_START: Final = 0xA3  # client: send the first sub-block
BLOCK_ACK: Final = 0xA2  # number of the last segment in order, size of the next sub-block
BLOCK_END: Final = 0xC1  # plus unused bytes of the last segment << 2, then the CRC
BLOCK_END_ANSWER: Final = 0xA1
SUB_COMMAND_MASK: Final = 0xE3
CRC_FLAG: Final = 0x04
SIZED_FLAG: Final = 0x02
LAST_FLAG: Final = 0x80  # in byte 0 of a block's segment, above its sequence number
MAX_BLOCK_SIZE: Final = 127

SEGMENT_DATA: Final = 7  # bytes of the object in one segment
MAX_TRANSFER_SIZE: Final = 1 << 20  # default limit of both sides, larger than any object of a drive
NO_MUX: Final = b"\0\0\0"  # multiplexer of an abort outside of a transfer

EXPEDITED_LENGTHS: Final = {0x42: 4, 0x43: 4, 0x47: 3, 0x4B: 2, 0x4F: 1}  # upload answer: number of data bytes
EXPEDITED_CODES: Final = (0, 0x0F, 0x0B, 0x07, 0x03)  # bits n, e and s by data length, added to DOWNLOAD or UPLOAD

INITIATE: Final = struct.Struct("<BHB4x")
INITIATE_BYTES: Final = struct.Struct("<BHB4s")
INITIATE_NUMBER: Final = struct.Struct("<BHBI")  # a size, or an abort code
BLOCK_END_FRAME: Final = struct.Struct("<BH5x")
BLOCK_END_ANSWER_FRAME: Final = bytes((BLOCK_END_ANSWER, 0, 0, 0, 0, 0, 0, 0))

# Results of a transfer for a frame; a positive number is the abort code to send.
PROGRESS: Final = 0
DONE: Final = -1
IGNORED: Final = -2


def crc16(data: bytes | bytearray) -> int:
    """Return the CRC of a block transfer: x^16 + x^12 + x^5 + 1, start 0, over the bytes of the object (7.2.4.3.16)."""
    return binascii.crc_hqx(data, 0)


# Many segments of a block transfer at once: the expected records of consecutive segments are compared with the received
# ones as one long integer, so that the lowest different bit gives their number, and the bytes are copied with strides.
# The cost per segment does not depend on Python's speed. All other frames are processed one by one.


SHORTEST_RUN: Final = 4  # fewer segments are processed as fast one by one
_ID_SIZE: Final = 4  # bytes of a record's can_id
_NUMBER_AT: Final = 8  # offset of the first data byte in a record
_FRAME_DATA: Final = struct.Struct("8s")
_NUMBERS: Final = bytes(range(1, MAX_BLOCK_SIZE + 1))

# Records of a sub-block as one little-endian number; `_EACH` is 1 in the first byte of every record.
_BITS: Final = 8 * RECORD_SIZE
_EACH: Final = sum(1 << _BITS * n for n in range(MAX_BLOCK_SIZE))
_NUMBERED: Final = sum(number << _BITS * n + 8 * _NUMBER_AT for n, number in enumerate(_NUMBERS))
_COMPARED: Final = int.from_bytes(b"\xff\xff\xff\xff\xff\0\0\0\xff", "little") * _EACH  # can_id, length, number


def segments_in_order(records: bytes, start: int, cob_id: int, number: int, most: int) -> bytearray:
    """Return the data of the consecutive segments beginning at byte `start`: seven bytes of each, at most `most`.

    `number` is the sequence number of the first segment; `number + most - 1` is at most 127. The result is empty if
    fewer than `SHORTEST_RUN` records are available, or the first two are not consecutive.
    """
    most = min(most, (len(records) - start) // RECORD_SIZE)
    data = bytearray()
    at = start + _NUMBER_AT
    if most < SHORTEST_RUN or records[at] != number or records[at + RECORD_SIZE] != number + 1:
        return data
    waiting = records[start : start + most * RECORD_SIZE]
    head = int.from_bytes(RECORD.pack(cob_id, 8, b""), "little")
    must_be = (head * _EACH + _NUMBERED) >> _BITS * (number - 1)
    differs = (int.from_bytes(waiting, "little") ^ must_be) & _COMPARED
    count = min(most, ((differs & -differs).bit_length() - 1) // _BITS) if differs else most
    data += bytes(SEGMENT_DATA * count)
    for byte in range(SEGMENT_DATA):
        data[byte::SEGMENT_DATA] = waiting[_NUMBER_AT + 1 + byte : count * RECORD_SIZE : RECORD_SIZE]
    return data


def segment_frame(cob_id: int, data: bytes, offset: int, toggle: int) -> CanFrame:
    """Return the segment of `data` beginning at `offset` (CiA 301, 7.2.4.3.4 and 7.2.4.3.7)."""
    chunk = data[offset : offset + SEGMENT_DATA]
    command = SEGMENT | toggle | (SEGMENT_DATA - len(chunk)) << 1 | (offset + SEGMENT_DATA >= len(data))
    return CanFrame(cob_id, bytes((command,)) + chunk.ljust(SEGMENT_DATA, b"\0"))


def segment_frames(cob_id: int, data: bytes, first: int, count: int) -> list[CanFrame]:
    """Return the frames of a sub-block: `count` segments of `data` from segment `first` on.

    The segment at the end of the object has the last flag.
    """
    end = (first + count) * SEGMENT_DATA
    chunk = data[first * SEGMENT_DATA : end].ljust(count * SEGMENT_DATA, b"\0")
    payload = bytearray(8 * count)
    payload[::8] = _NUMBERS[:count]
    for byte in range(SEGMENT_DATA):
        payload[byte + 1 :: 8] = chunk[byte::SEGMENT_DATA]
    if end >= len(data):
        payload[-8] |= LAST_FLAG
    return [CanFrame(cob_id, segment) for (segment,) in _FRAME_DATA.iter_unpack(payload)]


def deliver(
    records: bytes,
    now: int,
    receive_records: Callable[[bytes, int, int], int],
    receive: Callable[[CanFrame, int], None],
) -> None:
    """Deliver raw frame records in order: runs of segments to `receive_records`, single frames to `receive`.

    `receive_records(records, start, now)` returns the number of records it processed from byte `start` on. It is called
    only if enough records remain and the first two have the same identifier.
    """
    start, end = 0, len(records)
    if end == RECORD_SIZE:
        can_id, length, data = RECORD.unpack(records)
        receive(make_frame((can_id, data[:length])), now)
        return
    least = end - SHORTEST_RUN * RECORD_SIZE  # beyond this offset there are too few records for a run
    while start < end:
        second = start + RECORD_SIZE
        same_identifier = start <= least and records[start : start + _ID_SIZE] == records[second : second + _ID_SIZE]
        received = receive_records(records, start, now) if same_identifier else 0
        if not received:
            can_id, length, data = RECORD.unpack_from(records, start)
            receive(make_frame((can_id, data[:length])), now)
            received = 1
        start += received * RECORD_SIZE
