"""The frame layouts of SDO, shared by client and server (CiA 301, 7.2.4.3).

Every SDO frame has eight bytes, unused ones zero. Byte 0 is the command specifier, bytes 1 to 3 of an initiate and of
an abort are the multiplexer (index little-endian, subindex). Nothing in this file decides: client and server each have
their own state machines, so that each checks the other.
"""

from __future__ import annotations

import binascii
import struct
from typing import Final

from canopen_control.frame import Service, cob_id

__all__ = [
    "ABORT",
    "ANSWER_BASE",
    "BLOCK_ACK",
    "BLOCK_DOWNLOAD",
    "BLOCK_DOWNLOAD_ANSWER",
    "BLOCK_END",
    "BLOCK_END_ANSWER",
    "BLOCK_END_ANSWER_FRAME",
    "BLOCK_END_FRAME",
    "BLOCK_START",
    "BLOCK_UPLOAD",
    "BLOCK_UPLOAD_ANSWER",
    "COMMAND_MASK",
    "CRC_FLAG",
    "DONE",
    "DOWNLOAD",
    "DOWNLOAD_ANSWER",
    "DOWNLOAD_SEGMENT_ANSWER",
    "EXPEDITED_CODES",
    "EXPEDITED_LENGTHS",
    "IGNORED",
    "INITIATE",
    "INITIATE_BYTES",
    "INITIATE_NUMBER",
    "LAST_FLAG",
    "MAX_BLOCK_SIZE",
    "MAX_NUDGES",
    "MAX_STUCK",
    "MAX_TRANSFER_SIZE",
    "NO_MUX",
    "PROGRESS",
    "REQUEST_BASE",
    "SEGMENT",
    "SEGMENT_DATA",
    "SIZED_FLAG",
    "SUB_COMMAND_MASK",
    "TOGGLE",
    "UPLOAD",
    "UPLOAD_SEGMENT",
    "UPLOAD_SIZED",
    "UPLOAD_UNSIZED",
    "crc16",
]

REQUEST_BASE: Final = cob_id(Service.SDO_CLIENT)  # plus node id
ANSWER_BASE: Final = cob_id(Service.SDO_SERVER)

COMMAND_MASK: Final = 0xE0  # ccs and scs: the three upper bits
DOWNLOAD: Final = 0x20  # client: initiate download; plus n, e, s
DOWNLOAD_ANSWER: Final = 0x60
DOWNLOAD_SEGMENT_ANSWER: Final = 0x20
UPLOAD: Final = 0x40  # client: initiate upload; server: its answer, plus n, e, s
UPLOAD_SIZED: Final = 0x41
UPLOAD_UNSIZED: Final = 0x40
UPLOAD_SEGMENT: Final = 0x60
SEGMENT: Final = 0x00  # the frame that carries a segment's data, either way
TOGGLE: Final = 0x10
ABORT: Final = 0x80

BLOCK_DOWNLOAD: Final = 0xC0  # client: plus CRC_FLAG, SIZED_FLAG
BLOCK_DOWNLOAD_ANSWER: Final = 0xA0
BLOCK_UPLOAD: Final = 0xA0  # client: plus CRC_FLAG
BLOCK_UPLOAD_ANSWER: Final = 0xC0
BLOCK_START: Final = 0xA3  # client: now send the first sub-block
BLOCK_ACK: Final = 0xA2  # last segment received in order, size of the next sub-block
BLOCK_END: Final = 0xC1  # plus unused bytes of the last segment << 2, then the CRC
BLOCK_END_ANSWER: Final = 0xA1
SUB_COMMAND_MASK: Final = 0xE3
CRC_FLAG: Final = 0x04
SIZED_FLAG: Final = 0x02
LAST_FLAG: Final = 0x80  # in byte 0 of a block's segment, above its sequence number
MAX_BLOCK_SIZE: Final = 127

SEGMENT_DATA: Final = 7  # bytes of the object in one segment
MAX_TRANSFER_SIZE: Final = 1 << 20  # default limit of both sides: what no drive's object reaches
NO_MUX: Final = b"\0\0\0"  # the multiplexer of an abort that belongs to no known transfer

EXPEDITED_LENGTHS: Final = {0x42: 4, 0x43: 4, 0x47: 3, 0x4B: 2, 0x4F: 1}  # upload answer: bytes of data
EXPEDITED_CODES: Final = (0, 0x0F, 0x0B, 0x07, 0x03)  # by length: n, e and s, to add to DOWNLOAD or UPLOAD

INITIATE: Final = struct.Struct("<BHB4x")
INITIATE_BYTES: Final = struct.Struct("<BHB4s")
INITIATE_NUMBER: Final = struct.Struct("<BHBI")  # a size, or an abort code
BLOCK_END_FRAME: Final = struct.Struct("<BH5x")
BLOCK_END_ANSWER_FRAME: Final = bytes((BLOCK_END_ANSWER, 0, 0, 0, 0, 0, 0, 0))
MAX_NUDGES: Final = 3  # acknowledgements on silence, in a row, of which nothing came
MAX_STUCK: Final = 16  # sub-blocks in a row of which nothing arrived

# What a transfer makes of a frame; a positive number is the abort code to send.
PROGRESS: Final = 0
DONE: Final = -1
IGNORED: Final = -2


def crc16(data: bytes | bytearray) -> int:
    """Return the block transfer's CRC: x^16 + x^12 + x^5 + 1, start 0, over the object's bytes alone (7.2.4.3.16)."""
    return binascii.crc_hqx(data, 0)
