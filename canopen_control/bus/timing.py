"""How long a classic CAN frame takes on the wire, to the bit (ISO 11898-1, 10.4 and 10.5).

Start of frame, identifier, control, data and CRC are stuffed: after five equal bits comes one of the other kind. CRC
delimiter, acknowledge, end of frame and the three bits of intermission are not.
"""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Final

from canopen_control.frame import EXTENDED_FLAG, REMOTE_FLAG

__all__ = ["NS_PER_S", "duration_ns", "frame_bits", "worst_case_bits"]

NS_PER_S = 1_000_000_000
_CRC_POLYNOMIAL = 0x4599
_CRC_BITS: Final = 15
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
def _stuffed(state: int, content: int, bits: int) -> tuple[int, int]:
    """Return how many bits so many bits are stuffed with, and the state after them; it is 2 * equal bits + last bit."""
    run, last, count = state >> 1, state & 1, 0
    for at in range(bits - 1, -1, -1):
        bit = content >> at & 1
        run = run + 1 if bit == last else 1
        last = bit
        if run == _STUFF_AFTER:
            count += 1
            run, last = 1, 1 - bit
    return count, run << 1 | last


@cache
def _stuffed_bytes() -> list[int]:
    """Return what a byte does in each state, at state << 8 | byte: how many bits are stuffed << 4 | the state after."""
    table = []
    for at in range(2 * _STUFF_AFTER << 8):
        upper, state = _stuffed(at >> 8, at >> 4 & 15, 4)
        lower, state = _stuffed(state, at & 15, 4)
        table.append(upper + lower << 4 | state)
    return table


@lru_cache(maxsize=4096)
def _head(can_id: int, length: int) -> tuple[int, int, int, int]:
    """Return what comes before the data: its bits, its CRC, how many bits are stuffed into it, and the state then."""
    content, bits = _header(can_id)
    content, bits = content << 4 | length, bits + 4
    count, state = _stuffed(0, content, bits)
    return bits, _crc15(content, bits), count, state


def frame_bits(can_id: int, data: bytes) -> int:
    """Return the bits from start of frame to the end of intermission, stuffing included."""
    bits, crc, count, state = _head(can_id, len(data))
    stuffed = _stuffed_bytes()
    if not can_id & REMOTE_FLAG:
        bits += 8 * len(data)
        for byte in data:
            crc = crc << 8 & 0x7FFF ^ _CRC[crc >> 7 ^ byte]
            entry = stuffed[state << 8 | byte]
            count += entry >> 4
            state = entry & 15
    more, state = _stuffed(state, crc >> 8, _CRC_BITS - 8)
    return bits + _CRC_BITS + count + more + (stuffed[state << 8 | crc & 0xFF] >> 4) + _UNSTUFFED_TAIL


def worst_case_bits(length: int, *, extended: bool = False) -> int:
    """Return the most bits that a data frame with `length` bytes can take."""
    stuffed = (54 if extended else 34) + 8 * length
    return stuffed + (stuffed - 1) // 4 + _UNSTUFFED_TAIL


def duration_ns(bits: int, bitrate: int) -> int:
    """Return the time of `bits` at `bitrate` bit/s, rounded up to a nanosecond."""
    return -(-bits * NS_PER_S // bitrate)
