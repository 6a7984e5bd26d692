"""How long a classic CAN frame takes on the wire, to the bit (ISO 11898-1, 10.4 and 10.5).

Start of frame, identifier, control, data and CRC are stuffed: after five equal bits comes one of the other kind. CRC
delimiter, acknowledge, end of frame and the three bits of intermission are not.
"""

from __future__ import annotations

from functools import lru_cache

from canopen_control.frame import EXTENDED_FLAG, REMOTE_FLAG

__all__ = ["NS_PER_S", "duration_ns", "frame_bits", "worst_case_bits"]

NS_PER_S = 1_000_000_000
_CRC_POLYNOMIAL = 0x4599
_UNSTUFFED_TAIL = 1 + 2 + 7 + 3  # CRC delimiter, acknowledge slot and delimiter, end of frame, intermission


def _crc15(bits: str) -> int:
    crc = 0
    for bit in bits:
        feedback = (crc >> 14) ^ (bit == "1")
        crc = (crc << 1) & 0x7FFF
        if feedback:
            crc ^= _CRC_POLYNOMIAL
    return crc


def _header(can_id: int) -> str:
    remote = "1" if can_id & REMOTE_FLAG else "0"
    if can_id & EXTENDED_FLAG:
        identifier = f"{can_id & 0x1FFFFFFF:029b}"
        return f"0{identifier[:11]}11{identifier[11:]}{remote}00"  # SRR and IDE recessive; r1, r0
    return f"0{can_id & 0x7FF:011b}{remote}00"  # IDE, r0


def _stuff_bits(bits: str) -> int:
    count, run, last = 0, 0, ""
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            count += 1
            run, last = 1, "0" if bit == "1" else "1"
    return count


@lru_cache(maxsize=4096)
def frame_bits(can_id: int, data: bytes) -> int:
    """Return the bits from start of frame to the end of intermission, stuffing included."""
    content = _header(can_id) + f"{len(data):04b}"
    if data and not can_id & REMOTE_FLAG:
        content += f"{int.from_bytes(data, 'big'):0{8 * len(data)}b}"
    content += f"{_crc15(content):015b}"
    return len(content) + _stuff_bits(content) + _UNSTUFFED_TAIL


def worst_case_bits(length: int, *, extended: bool = False) -> int:
    """Return the most bits that a data frame with `length` bytes can take."""
    stuffed = (54 if extended else 34) + 8 * length
    return stuffed + (stuffed - 1) // 4 + _UNSTUFFED_TAIL


def duration_ns(bits: int, bitrate: int) -> int:
    """Return the time of `bits` at `bitrate` bit/s, rounded up to a nanosecond."""
    return -(-bits * NS_PER_S // bitrate)
