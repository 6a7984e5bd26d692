"""The COB-ID entries of the object dictionary: an identifier below, bits that say what is done with it above."""

from __future__ import annotations

from canopen_control.frame import EXTENDED_FLAG

__all__ = ["EXTENDED_BIT", "can_id_of"]

EXTENDED_BIT = 1 << 29  # the identifier has 29 bits; in a frame's identifier another bit says so


def can_id_of(entry: int) -> int:
    """Return the identifier of an entry as frames have it, with the flag of a 29-bit one."""
    return entry & 0x1FFFFFFF | EXTENDED_FLAG if entry & EXTENDED_BIT else entry & 0x7FF
