"""Values of the object dictionary and their bytes on the wire (CiA 301, 7.1).

All numbers are little-endian. A value that its type cannot hold is refused, never cut. VISIBLE_STRING is taken as
ISO 8859-1, since drives put umlauts and degree signs where the standard allows ISO 646 only, and written in UTF-8
where it has other characters; the zero bytes some of
them pad with are no part of the string. The two times are 48-bit numbers: milliseconds in the low 32 bits, days above.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from canopen_control.od.model import Entry, Value


# The limits of an entry (LowLimit, HighLimit), and which of them count.
#
# CiA 301 gives some objects values that are no quantities: an identifier below flag bits (COB-IDs), a node id above a
# time (0x1016), a signature (0x1010, 0x1011). A limit that leaves no room for what every device has to take there is a
# mistake of the file, as 65535 for 0x1016 is: it is told by the check of the file, and nobody obeys it.


class _Required(NamedTuple):
    """What the value range of an object has to hold, by CiA 301."""

    low: int
    high: int
    why: str


_OFF = 1 << 31
_COB_ID = _Required(_OFF, _OFF, "bit 31 switches the object off")
_SIGNATURE = _Required(0x64616F6C, 0x65766173, "the signature is written there")
_OBJECTS = {
    0x1005: _Required(0x80, 0x80, "0x80 is the predefined identifier"),  # 7.5.2.5
    0x1010: _SIGNATURE,  # 7.5.2.13
    0x1011: _SIGNATURE,  # 7.5.2.14
    0x1014: _COB_ID,  # 7.5.2.17
    0x1016: _Required(0, 127 << 16 | 1, "bits 16 to 23 are the node id"),  # 7.5.2.19
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
    """Return what is wrong with the limits of a communication object, empty where CiA 301 allows them."""
    required = _required(entry)
    if required is None:
        return ""
    if entry.high is not None and entry.high < required.high:
        return f"HighLimit {entry.high} forbids what CiA 301 wants there ({required.why}); ignored"
    if entry.low is not None and entry.low > required.low:
        return f"LowLimit {entry.low} forbids what CiA 301 wants there ({required.why}); ignored"
    return ""


def above_limit(entry: Entry, value: float) -> bool:
    """Whether a value is above a HighLimit that counts."""
    return entry.high is not None and value > entry.high and not forbidden_limit(entry)


def below_limit(entry: Entry, value: float) -> bool:
    """Whether a value is below a LowLimit that counts."""
    return entry.low is not None and value < entry.low and not forbidden_limit(entry)


def outside_limits(entry: Entry, value: float) -> bool:
    """Whether a value is outside limits that count."""
    return above_limit(entry, value) or below_limit(entry, value)


REALS = {DataType.REAL32: struct.Struct("<f"), DataType.REAL64: struct.Struct("<d")}
_TEXT = {DataType.VISIBLE_STRING: "latin-1", DataType.UNICODE_STRING: "utf-16-le"}


def encode(value: Value, data_type: DataType) -> bytes:
    """Return the bytes of `value`; ValueError where the type cannot hold it."""
    if data_type in _TEXT:
        return _encode_text(value, data_type)
    if data_type in REALS:
        return _encode_real(value, data_type)
    if data_type.is_integer:
        return _encode_integer(value, data_type)
    if isinstance(value, bytes | bytearray | memoryview):
        return bytes(value)
    raise ValueError(f"{value!r} is no {data_type.name}: bytes are wanted")


def decode(data: bytes, data_type: DataType) -> Value:
    """Return the value of `data`; ValueError where the length is not the type's."""
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


def fitted(data: bytes, data_type: DataType, *, told: bool = True) -> bytes | None:
    """Return what an upload brought as the bytes of its type; None where they are no value of it.

    Fewer bytes are never made up for. More are cut where they say nothing: zeros behind a number (all ones behind a
    negative one), as from devices that answer everything in four bytes, or any where the server did not tell how many
    count (`told`).
    """
    if (bits := data_type.bits) is None:
        return data
    size = (bits + 7) // 8
    if len(data) <= size:
        return data if len(data) == size else None
    filling = 0xFF if data_type.signed and data[size - 1] & 0x80 else 0
    if not told or (data_type.is_integer and all(byte == filling for byte in data[size:])):
        return data[:size]
    return None


def zero_of(data_type: DataType) -> Value:
    """Return the zero of the type: 0, 0.0, an empty string or no bytes."""
    if data_type in _TEXT:
        return ""
    if data_type in REALS:
        return 0.0
    return 0 if data_type.is_integer else b""


def default_of(entry: Entry) -> Value:
    """Return what a node holds there after power-on: ParameterValue, else DefaultValue, else the type's zero."""
    value = entry.value
    return zero_of(entry.data_type) if value is None else value


def _encode_text(value: Value, data_type: DataType) -> bytes:
    if not isinstance(value, str):
        raise ValueError(f"{value!r} is no {data_type.name}: a string is wanted")
    try:
        return value.encode(_TEXT[data_type])
    except UnicodeEncodeError:
        pass
    try:
        return value.encode("utf-8")  # what devices with such texts have; the standard knows ISO 646 only
    except UnicodeEncodeError:
        raise ValueError(f"{value!r} has characters that {data_type.name} cannot hold") from None


def _decode_text(data: bytes, data_type: DataType) -> str:
    try:
        return bytes(data).decode(_TEXT[data_type]).rstrip("\0")
    except UnicodeDecodeError:
        raise ValueError(f"{bytes(data).hex()} is no {data_type.name}: not UTF-16") from None


def _encode_real(value: Value, data_type: DataType) -> bytes:
    if not isinstance(value, int | float):
        raise ValueError(f"{value!r} is no {data_type.name}: a number is wanted")
    try:
        return REALS[data_type].pack(value)
    except (OverflowError, struct.error):
        raise ValueError(f"{value!r} is too large for {data_type.name}") from None


def _encode_integer(value: Value, data_type: DataType) -> bytes:
    if not isinstance(value, int):
        raise ValueError(f"{value!r} is no {data_type.name}: a whole number is wanted")
    low, high = data_type.minimum, data_type.maximum
    if not low <= value <= high:
        raise ValueError(f"{value} is no {data_type.name}: it holds {low} to {high}")
    return value.to_bytes(((data_type.bits or 0) + 7) // 8, "little", signed=data_type.signed)
