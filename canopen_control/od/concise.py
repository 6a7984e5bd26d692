"""Concise DCF: what a master downloads into a node, as one byte string (CiA 302-3; object 0x1F22).

A 32-bit count, then for each download index (16 bit), subindex (8 bit), size (32 bit) and the data; all little-endian,
in the order of the downloads.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.od.codec import encode

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.od.model import ObjectDictionary

__all__ = ["ConciseEntry", "concise_of", "decode_concise", "encode_concise"]

_COUNT = struct.Struct("<I")
_HEAD = struct.Struct("<HBI")
_REFUSES_DOWNLOAD = 1  # bit of ObjFlags


class ConciseEntry(NamedTuple):
    """One download."""

    index: int  # type: ignore[assignment] # hides tuple.index, which nobody needs of an address
    subindex: int
    data: bytes


def encode_concise(entries: Iterable[tuple[int, int, bytes]]) -> bytes:
    """Return the concise DCF of these downloads; ValueError for an address that has no place in it."""
    parts = []
    for index, subindex, data in entries:
        if not (0 <= index <= 0xFFFF and 0 <= subindex <= 0xFF):
            raise ValueError(f"0x{index:X}:{subindex:X} is no address of an object dictionary")
        parts.append(_HEAD.pack(index, subindex, len(data)) + data)
    return _COUNT.pack(len(parts)) + b"".join(parts)


def decode_concise(data: bytes) -> list[ConciseEntry]:
    """Return the downloads of a concise DCF; ValueError where it is cut short or has bytes too many."""
    if len(data) < _COUNT.size:
        raise ValueError(f"a concise DCF begins with a 32-bit count, and there are {len(data)} bytes")
    (count,) = _COUNT.unpack_from(data)
    entries: list[ConciseEntry] = []
    offset = _COUNT.size
    while len(entries) < count:
        start = offset + _HEAD.size
        if start > len(data):
            raise ValueError(f"the concise DCF ends after {len(entries)} of {count} entries")
        index, subindex, size = _HEAD.unpack_from(data, offset)
        offset = start + size
        if offset > len(data):
            raise ValueError(f"0x{index:04X}:{subindex:02X} has {len(data) - start} of its {size} bytes")
        entries.append(ConciseEntry(index, subindex, data[start:offset]))
    if offset != len(data):
        raise ValueError(f"the concise DCF has {len(data) - offset} bytes after its {count} entries")
    return entries


def concise_of(od: ObjectDictionary) -> list[ConciseEntry]:
    """Return the downloads that the ParameterValues of a DCF stand for, by rising address.

    Entries that cannot be written, and those whose ObjFlags refuse a download, are left out. The order is not yet the
    one that PDO parameters need (COB-ID invalid, mapping, COB-ID valid).
    """
    wanted = (
        entry
        for entry in od
        if entry.parameter_value is not None and entry.writable and not entry.obj_flags & _REFUSES_DOWNLOAD
    )
    return [
        ConciseEntry(entry.index, entry.subindex, encode(entry.parameter_value, entry.data_type))
        for entry in sorted(wanted, key=lambda entry: entry.address)
        if entry.parameter_value is not None
    ]
