"""Objects of a node as ROS messages carry them: addresses as text, values as numbers, text or bytes, without ROS.

The law of the file (CiA 301): numbers are little endian and as wide as their data type. ros2_canopen carries every
value as an unsigned number of 32 bits, negative ones as two's complement and REAL32 as its bits.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Final

__all__ = ["Address", "Value", "as_uint32", "decode", "encode", "of_datatype", "of_uint32", "parse_address"]

Value = int | float | str | bytes | bool
#: by their names in `sdo --type`
_FORMATS: Final = {
    "bool": "<?", "i8": "<b", "i16": "<h", "i32": "<i", "i64": "<q", "u8": "<B", "u16": "<H", "u32": "<I", "u64": "<Q",
    "f32": "<f", "f64": "<d",
}  # fmt: skip
_TEXTS: Final = ("str", "bytes")
#: the data types of COReadID and COWriteID (CiA 301, table 44), with their size in bytes
_SIZES: Final = {2: 1, 3: 2, 4: 4, 5: 1, 6: 2, 7: 4}
_ADDRESS: Final = re.compile(r"(?:0x)?([0-9A-Fa-f]{4})(?::([0-9A-Fa-f]{1,2}))?(?:[ /](\w+))?")


@dataclass(frozen=True, slots=True)
class Address:
    """An object, and the data type it is to be read as; "" where the length decides."""

    index: int
    subindex: int
    kind: str

    def __str__(self) -> str:
        return f"0x{self.index:04X}:{self.subindex:02X}"


def parse_address(text: str) -> Address:
    """Return the address of "0x6041", "6041:00" or "0x1008:00 str"; ValueError with a sentence."""
    match = _ADDRESS.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"{text!r} is no object; write INDEX[:SUB] [TYPE] in hexadecimal, such as 0x6083:00 u32")
    index, subindex, kind = match[1], match[2] or "0", match[3] or ""
    if kind not in ("", *_FORMATS, *_TEXTS):
        raise ValueError(f"{text!r}: no type {kind!r}; there are: {', '.join((*_FORMATS, *_TEXTS))}")
    return Address(int(index, 16), int(subindex, 16), kind)


def decode(data: bytes, kind: str) -> Value:
    """Return what the bytes of an object hold; ValueError when they are too few or too many for the type."""
    if kind == "str":
        return data.rstrip(b"\0").decode("utf-8", "replace")
    if kind in _FORMATS:
        layout = struct.Struct(_FORMATS[kind])
        if len(data) != layout.size:
            raise ValueError(f"it has {len(data)} bytes, {kind} has {layout.size}")
        value: Value = layout.unpack(data)[0]
        return value
    return int.from_bytes(data, "little") if not kind and len(data) in (1, 2, 4, 8) else data


def encode(value: Value, kind: str, length: int) -> bytes:
    """Return the bytes of a value; without a type a number has `length` bytes. ValueError when it does not fit."""
    try:
        if isinstance(value, bytes):
            return value
        if isinstance(value, str):
            return value.encode()
        if kind in _FORMATS:
            return struct.pack(_FORMATS[kind], value)
        if isinstance(value, float):
            return struct.pack("<f" if length == 4 else "<d", value)
        return int(value).to_bytes(length, "little", signed=value < 0)
    except (struct.error, OverflowError) as error:
        raise ValueError(f"{value!r} does not fit into {kind or f'{length} bytes'}: {error}") from None


def of_datatype(datatype: int) -> int:
    """Return the size in bytes of a data type of COReadID; ValueError for one that it does not have."""
    if datatype not in _SIZES:
        raise ValueError(f"no data type {datatype}; there are: INT8 2, INT16 3, INT32 4, UINT8 5, UINT16 6, UINT32 7")
    return _SIZES[datatype]


def as_uint32(data: bytes) -> int:
    """Return an object's bytes as ros2_canopen's `data`; ValueError when they are too many."""
    if len(data) > 4:
        raise ValueError(f"it has {len(data)} bytes, `data` of the service has 4; use get_objects")
    return int.from_bytes(data, "little")


def of_uint32(data: int, length: int) -> bytes:
    """Return `data` of a service as an object of that length; ValueError when it does not fit."""
    signed = data - (1 << 32) if data >= 1 << 31 else data
    if not 1 <= length <= 4:
        raise ValueError(f"the object has {length} bytes, `data` of the service has 4; use set_objects")
    if data >= 1 << 8 * length and not -(1 << 8 * length - 1) <= signed < 0:
        raise ValueError(f"{data} does not fit into {length} bytes")
    return (data & ((1 << 8 * length) - 1)).to_bytes(length, "little")
