"""Takes many segments of a block transfer at once, for client and server (CiA 301, 7.2.4.3.9).

The law: nothing here decides. A run is what of the waiting records is, one after the other and without exception, the
next segments in order, none of them the last of the object; whatever else there may be goes frame by frame to whoever
does decide. A run is compared with what it must be as one long number, so that the lowest bit that differs tells where
it ends, and its bytes move by strides: what a segment costs does not depend on Python's speed.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.sdo_codec import LAST_FLAG, MAX_BLOCK_SIZE, SEGMENT_DATA
from canopen_control.frame import RECORD, RECORD_SIZE, CanFrame

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["SHORTEST_RUN", "deliver", "segment_frames", "segments_in_order"]

SHORTEST_RUN: Final = 4  # fewer segments are as fast one by one
_ID_SIZE: Final = 4  # bytes of a record's can_id
_NUMBER_AT: Final = 8  # byte of a record that is the first of its data
_FRAME_DATA: Final = struct.Struct("8s")
_NUMBERS: Final = bytes(range(1, MAX_BLOCK_SIZE + 1))

# A sub-block's records as one little-endian number; those of `_EACH` are 1 in every record's first byte.
_BITS: Final = 8 * RECORD_SIZE
_EACH: Final = sum(1 << _BITS * n for n in range(MAX_BLOCK_SIZE))
_NUMBERED: Final = sum(number << _BITS * n + 8 * _NUMBER_AT for n, number in enumerate(_NUMBERS))
_COMPARED: Final = int.from_bytes(b"\xff\xff\xff\xff\xff\0\0\0\xff", "little") * _EACH  # can_id, length, number


def segments_in_order(records: bytes, start: int, cob_id: int, number: int, most: int) -> bytearray:
    """Return the data of the run that begins at byte `start`: seven bytes for each of its records, at most `most`.

    `number` is that of the segment awaited; it and the `most` - 1 behind it are at most 127. Empty is no run.
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


def segment_frames(cob_id: int, data: bytes, first: int, count: int) -> list[CanFrame]:
    """Make a sub-block: the `count` segments of `data` from segment `first` on, flagged if they end the object."""
    end = (first + count) * SEGMENT_DATA
    chunk = data[first * SEGMENT_DATA : end].ljust(count * SEGMENT_DATA, b"\0")
    payload = bytearray(8 * count)
    payload[::8] = _NUMBERS[:count]
    for byte in range(SEGMENT_DATA):
        payload[byte + 1 :: 8] = chunk[byte::SEGMENT_DATA]
    if end >= len(data):
        payload[-8] |= LAST_FLAG
    return [CanFrame(cob_id, each) for (each,) in _FRAME_DATA.iter_unpack(payload)]


def deliver(
    records: bytes,
    now: int,
    receive_records: Callable[[bytes, int, int], int],
    receive: Callable[[CanFrame, int], None],
) -> None:
    """Hand whole records over, in order: to `receive_records` the runs it takes, to `receive` frame by frame the rest.

    `receive_records(records, start, now)` returns how many records it took from byte `start` on, 0 for none.
    It is asked where a run may be: enough records are left, and the first two have one identifier.
    """
    start, end = 0, len(records)
    if end == RECORD_SIZE:
        can_id, length, data = RECORD.unpack(records)
        receive(CanFrame(can_id, data[:length]), now)
        return
    least = end - SHORTEST_RUN * RECORD_SIZE  # behind it there is no room for a run
    while start < end:
        second = start + RECORD_SIZE
        alike = start <= least and records[start : start + _ID_SIZE] == records[second : second + _ID_SIZE]
        taken = receive_records(records, start, now) if alike else 0
        if not taken:
            can_id, length, data = RECORD.unpack_from(records, start)
            receive(CanFrame(can_id, data[:length]), now)
            taken = 1
        start += taken * RECORD_SIZE
