"""Values of the object dictionary and their encoding as bytes (CiA 301, 7.1).

All numbers are little-endian. A value that does not fit its type is refused, never truncated. VISIBLE_STRING is decoded
as ISO 8859-1, since drives use umlauts and degree signs although the standard allows only ISO 646, and encoded as UTF-8
if other characters occur. Trailing zero bytes, with which some devices pad, are removed. The two time types are 48-bit
numbers: milliseconds in the low 32 bits, days above.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from canopen_control.od.model import Entry, Value


# Limits of an entry (LowLimit, HighLimit). Some values of CiA 301 are not quantities: an identifier below flag bits
# (COB-IDs), a node-ID above a time (0x1016), a signature (0x1010, 0x1011). A limit that excludes a value every device
# must accept there, such as 65535 for 0x1016, is an error of the file: the check of the file reports it, and it is not
# applied.


class _Required(NamedTuple):
    """Values that CiA 301 requires an object to accept."""

    low: int
    high: int
    why: str


_OFF = 1 << 31
_COB_ID = _Required(_OFF, _OFF, "bit 31 disables the service")
_SIGNATURE = _Required(0x64616F6C, 0x65766173, "the signature must be accepted")
_OBJECTS = {
    0x1005: _Required(0x80, 0x80, "0x80 is the predefined identifier"),  # 7.5.2.5
    0x1010: _SIGNATURE,  # 7.5.2.13
    0x1011: _SIGNATURE,  # 7.5.2.14
    0x1014: _COB_ID,  # 7.5.2.17
    0x1016: _Required(0, 127 << 16 | 1, "bits 16 to 23 are the node-ID"),  # 7.5.2.19
}
_PDO_RECORDS = (0x1400, 0x1800)  # 7.5.2.35 and 7.5.2.37, 512 each


def _required(entry: Entry) -> _Required | None:
    if entry.data_type is not DataType.UNSIGNED32:
        return None
    index, subindex = entry.address
    if subindex == 1 and any(first <= index < first + 512 for first in _PDO_RECORDS):
        return _COB_ID
    if index in (0x1010, 0x1011, 0x1016) and not subindex:
        return None
    return _OBJECTS.get(index)


def forbidden_limit(entry: Entry) -> str:
    """Return a message about a limit of a communication object that contradicts CiA 301, or ""."""
    required = _required(entry)
    if required is None:
        return ""
    if entry.high is not None and entry.high < required.high:
        return f"HighLimit {entry.high} excludes values that CiA 301 requires ({required.why}); limit ignored"
    if entry.low is not None and entry.low > required.low:
        return f"LowLimit {entry.low} excludes values that CiA 301 requires ({required.why}); limit ignored"
    return ""


def above_limit(entry: Entry, value: float) -> bool:
    """Whether a value is above the HighLimit of the entry; a limit that contradicts CiA 301 is ignored."""
    return entry.high is not None and value > entry.high and not forbidden_limit(entry)


def below_limit(entry: Entry, value: float) -> bool:
    """Whether a value is below the LowLimit of the entry; a limit that contradicts CiA 301 is ignored."""
    return entry.low is not None and value < entry.low and not forbidden_limit(entry)


def outside_limits(entry: Entry, value: float) -> bool:
    """Whether a value is outside the limits of the entry; a limit that contradicts CiA 301 is ignored."""
    return above_limit(entry, value) or below_limit(entry, value)


def accepts(entry: Entry | None, value: Value) -> bool:
    """Whether `value` may be written: the entry exists, is writable, and its type and limits permit the value."""
    if entry is None or not entry.writable:
        return False
    try:
        encode(value, entry.data_type)
    except ValueError:
        return False
    return not (isinstance(value, int | float) and outside_limits(entry, value))


REALS = {DataType.REAL32: struct.Struct("<f"), DataType.REAL64: struct.Struct("<d")}
_TEXT = {DataType.VISIBLE_STRING: "latin-1", DataType.UNICODE_STRING: "utf-16-le"}


def encode(value: Value, data_type: DataType) -> bytes:
    """Return the bytes of `value`; raise ValueError if `value` does not fit the type."""
    if data_type in _TEXT:
        return _encode_text(value, data_type)
    if data_type in REALS:
        return _encode_real(value, data_type)
    if data_type.is_integer:
        return _encode_integer(value, data_type)
    if isinstance(value, bytes | bytearray | memoryview):
        return bytes(value)
    raise ValueError(f"{value!r} is not a valid {data_type.name}: expected bytes")


def decode(data: bytes, data_type: DataType) -> Value:
    """Return the value encoded in `data`; raise ValueError for a wrong length or invalid UTF-16."""
    if data_type in _TEXT:
        return _decode_text(data, data_type)
    bits = data_type.bits
    if bits is None:
        return bytes(data)
    size = (bits + 7) // 8
    if len(data) != size:
        raise ValueError(f"{data_type.name} has {size} bytes, not {len(data)}")
    if (real := REALS.get(data_type)) is not None:
        number: float = real.unpack(data)[0]
        return number
    if data_type is DataType.BOOLEAN:
        return data[0] & 1
    return int.from_bytes(data, "little", signed=data_type.signed)


def fitted(data: bytes, data_type: DataType, *, length_known: bool = True) -> bytes | None:
    """Return the data of an upload, cut to the length of the type; None if it is invalid for the type.

    Missing bytes are never added. Excess bytes are cut if they carry no information: zeros after a number (0xFF after a
    negative one), as from devices that always answer with four bytes, or any bytes if the server did not announce the
    length (`length_known` False).
    """
    if (bits := data_type.bits) is None:
        return data
    size = (bits + 7) // 8
    if len(data) <= size:
        return data if len(data) == size else None
    filling = 0xFF if data_type.signed and data[size - 1] & 0x80 else 0
    if not length_known or (data_type.is_integer and all(byte == filling for byte in data[size:])):
        return data[:size]
    return None


def zero_of(data_type: DataType) -> Value:
    """Return the zero value of the type: 0, 0.0, an empty string or no bytes."""
    if data_type in _TEXT:
        return ""
    if data_type in REALS:
        return 0.0
    return 0 if data_type.is_integer else b""


def default_of(entry: Entry) -> Value:
    """Return the value after power-on: ParameterValue, else DefaultValue, else the zero value of the type."""
    value = entry.value
    return zero_of(entry.data_type) if value is None else value


def _encode_text(value: Value, data_type: DataType) -> bytes:
    if not isinstance(value, str):
        raise ValueError(f"{value!r} is not a valid {data_type.name}: expected a string")
    try:
        return value.encode(_TEXT[data_type])
    except UnicodeEncodeError:
        pass
    try:
        return value.encode("utf-8")  # as devices with such strings do; CiA 301 allows only ISO 646
    except UnicodeEncodeError:
        raise ValueError(f"{value!r} has characters that are invalid in {data_type.name}") from None


def _decode_text(data: bytes, data_type: DataType) -> str:
    try:
        return bytes(data).decode(_TEXT[data_type]).rstrip("\0")
    except UnicodeDecodeError:
        raise ValueError(f"{bytes(data).hex()} is not a valid {data_type.name}: not UTF-16") from None


def _encode_real(value: Value, data_type: DataType) -> bytes:
    if not isinstance(value, int | float):
        raise ValueError(f"{value!r} is not a valid {data_type.name}: expected a number")
    try:
        return REALS[data_type].pack(value)
    except (OverflowError, struct.error):
        raise ValueError(f"{value!r} is too large for {data_type.name}") from None


def _encode_integer(value: Value, data_type: DataType) -> bytes:
    if not isinstance(value, int):
        raise ValueError(f"{value!r} is not a valid {data_type.name}: expected a whole number")
    low, high = data_type.minimum, data_type.maximum
    if not low <= value <= high:
        raise ValueError(f"{value} is not a valid {data_type.name}: the range is {low} to {high}")
    return value.to_bytes(((data_type.bits or 0) + 7) // 8, "little", signed=data_type.signed)
