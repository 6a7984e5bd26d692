"""The TIME object (CiA 301, 7.2.6 and 7.5.2.18): milliseconds after midnight and days since 1984-01-01.

It is read where a bus is listened to; neither master nor virtual devices send or take it.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

__all__ = ["TimeOfDay", "parse_time"]

_WIRE = struct.Struct("<IH")


class TimeOfDay(NamedTuple):
    """`ms` after midnight, 0 to 86399999; `days` since 1984-01-01."""

    days: int
    ms: int


def parse_time(data: bytes) -> TimeOfDay | None:
    """Return the time of 6 bytes, None for another length; the upper four bits of the milliseconds are reserved."""
    if len(data) != _WIRE.size:
        return None
    ms, days = _WIRE.unpack(data)
    return TimeOfDay(days, ms & 0x0FFFFFFF)
