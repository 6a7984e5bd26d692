"""How long a classic CAN frame takes on the wire, to the bit (ISO 11898-1, 10.4 and 10.5).

Start of frame, identifier, control, data and CRC are stuffed: after five equal bits comes one of the other kind. CRC
delimiter, acknowledge, end of frame and the three bits of intermission are not.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from canopen_control.frame import EXTENDED_FLAG, REMOTE_FLAG

__all__ = ["NS_PER_S", "duration_ns", "frame_bits", "worst_case_bits"]

NS_PER_S = 1_000_000_000
_CRC_POLYNOMIAL = 0x4599
_STUFF_AFTER: Final = 5
_UNSTUFFED_TAIL = 1 + 2 + 7 + 3  # CRC delimiter, acknowledge slot and delimiter, end of frame, intermission


def _crc_table() -> list[int]:
    """Return what eight bits that leave the register add to it."""
    table = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = crc << 1 ^ (_CRC_POLYNOMIAL if crc & 0x4000 else 0)
        table.append(crc & 0x7FFF)
    return table


_CRC: Final = _crc_table()


def _crc15(content: int, bits: int) -> int:
    """Return the CRC of so many bits, zeros before them, which change nothing: the register begins with zeros."""
    crc = 0
    for byte in content.to_bytes((bits + 7) // 8, "big"):
        crc = crc << 8 & 0x7FFF ^ _CRC[crc >> 7 ^ byte]
    return crc


def _header(can_id: int) -> tuple[int, int]:
    """Return the bits up to the length, and how many they are."""
    remote = 1 if can_id & REMOTE_FLAG else 0
    if can_id & EXTENDED_FLAG:
        identifier = can_id & 0x1FFFFFFF
        return (identifier >> 18) << 23 | 0b11 << 21 | (identifier & 0x3FFFF) << 3 | remote << 2, 35  # SRR, IDE; r1, r0
    return (can_id & 0x7FF) << 3 | remote << 2, 15  # IDE, r0


@lru_cache(maxsize=4096)
def _stuffed_byte(state: int, byte: int) -> tuple[int, int]:
    """Return how many bits eight bits are stuffed with, and the state after them; it is 2 * equal bits + last bit."""
    run, last, count = state >> 1, state & 1, 0
    for at in range(7, -1, -1):
        bit = byte >> at & 1
        run = run + 1 if bit == last else 1
        last = bit
        if run == _STUFF_AFTER:
            count += 1
            run, last = 1, 1 - bit
    return count, run << 1 | last


def _stuff_bits(content: int, bits: int) -> int:
    """Return how many bits are stuffed into so many bits, the last of which end a byte."""
    lead = bits % 8
    count, run, last = 0, 0, 0
    for at in range(bits - 1, bits - 1 - lead, -1):
        bit = content >> at & 1
        run = run + 1 if bit == last else 1
        last = bit
        if run == _STUFF_AFTER:
            count += 1
            run, last = 1, 1 - bit
    state = run << 1 | last
    for byte in (content & (1 << bits - lead) - 1).to_bytes((bits - lead) // 8, "big"):
        more, state = _stuffed_byte(state, byte)
        count += more
    return count


@lru_cache(maxsize=4096)
def frame_bits(can_id: int, data: bytes) -> int:
    """Return the bits from start of frame to the end of intermission, stuffing included."""
    content, bits = _header(can_id)
    content, bits = content << 4 | len(data), bits + 4
    if data and not can_id & REMOTE_FLAG:
        content, bits = content << 8 * len(data) | int.from_bytes(data, "big"), bits + 8 * len(data)
    content, bits = content << 15 | _crc15(content, bits), bits + 15
    return bits + _stuff_bits(content, bits) + _UNSTUFFED_TAIL


def worst_case_bits(length: int, *, extended: bool = False) -> int:
    """Return the most bits that a data frame with `length` bytes can take."""
    stuffed = (54 if extended else 34) + 8 * length
    return stuffed + (stuffed - 1) // 4 + _UNSTUFFED_TAIL


def duration_ns(bits: int, bitrate: int) -> int:
    """Return the time of `bits` at `bitrate` bit/s, rounded up to a nanosecond."""
    return -(-bits * NS_PER_S // bitrate)
