"""Values as people write and read them: text to bytes by data type and back.

A whole number is decimal, 0x, 0o or 0b, never cut: what the type cannot hold is refused. For a
signed type a 0x number of the type's full width is two's complement, as data sheets print it. Shown is the value of the
type, its bytes in hexadecimal, and the text where it is one; without a type both readings of a number are shown.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError
from canopen_control.od.codec import decode, encode
from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from canopen_control.od.model import Value

__all__ = ["TYPE_NAMES", "parse_type", "parse_value", "printable", "show"]

_ALIASES: dict[str, DataType] = {
    "bool": DataType.BOOLEAN,
    **{f"i{bits}": DataType[f"INTEGER{bits}"] for bits in (8, 16, 24, 32, 40, 48, 56, 64)},
    **{f"u{bits}": DataType[f"UNSIGNED{bits}"] for bits in (8, 16, 24, 32, 40, 48, 56, 64)},
    "f32": DataType.REAL32,
    "f64": DataType.REAL64,
    "text": DataType.VISIBLE_STRING,
    "unicode": DataType.UNICODE_STRING,
    "bytes": DataType.OCTET_STRING,
    "domain": DataType.DOMAIN,
    "time": DataType.TIME_OF_DAY,
    "interval": DataType.TIME_DIFFERENCE,
}
TYPE_NAMES = ", ".join(_ALIASES)
_WORDS = {"true": 1, "false": 0}
_TEXTS = (DataType.VISIBLE_STRING, DataType.UNICODE_STRING)
_NUMBER_BYTES = 8  # up to which bytes without a type are read as a number
_TEXT_BYTES = 3  # from which they are shown as a text too, where they are one
_SHOWN_BYTES = 64


def parse_type(text: str) -> DataType:
    """Return the type of `i32`, `INTEGER32` and so on; ConfigError with those there are."""
    found = _ALIASES.get(text.casefold()) or DataType.__members__.get(text.upper())
    if found is None:
        raise ConfigError(
            f"no data type {text!r}; there are: {TYPE_NAMES}, and the names of CiA 301 such as UNSIGNED32"
        )
    return found


def parse_value(text: str, data_type: DataType) -> bytes:
    """Return the bytes of `text`; ConfigError where the type cannot hold it."""
    try:
        return encode(_value(text, data_type), data_type)
    except ValueError as error:
        raise ConfigError(f"value {error}") from None


def _value(text: str, data_type: DataType) -> Value:
    if data_type in _TEXTS:
        return text
    if data_type.is_real:
        return _real(text, data_type)
    if data_type.is_integer:
        return _whole(text, data_type)
    try:
        return bytes.fromhex(text.removeprefix("0x"))
    except ValueError:
        raise ValueError(f"{text!r} is no {data_type.name}: write bytes in hexadecimal, as in DEADBEEF") from None


def _real(text: str, data_type: DataType) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{text!r} is no {data_type.name}: a number is wanted") from None


def _whole(text: str, data_type: DataType) -> int:
    if data_type is DataType.BOOLEAN and text.casefold() in _WORDS:
        return _WORDS[text.casefold()]
    try:
        value = int(text, 0)
    except ValueError:
        raise ValueError(f"{text!r} is no {data_type.name}: a whole number is wanted, decimal or 0x") from None
    bits = data_type.bits or 0
    if data_type.signed and text.lower().startswith("0x") and data_type.maximum < value < 1 << bits:
        value -= 1 << bits
    return value


def show(data: bytes, data_type: DataType | None) -> str:
    """Return the value for people: decimal and hexadecimal, quoted text, or bytes."""
    if data_type is None:
        return _show_untyped(data)
    value = decode(data, data_type)
    if isinstance(value, str):
        return f'"{printable(value)}" ({_count(data)})'
    if isinstance(value, bytes):
        return _show_bytes(data)
    return f"{value} (0x{_hex_number(data)})" if data_type is not DataType.BOOLEAN else f"{bool(value)} ({value})"


def _show_untyped(data: bytes) -> str:
    if not 0 < len(data) <= _NUMBER_BYTES:
        return _show_bytes(data)
    unsigned, signed = (int.from_bytes(data, "little", signed=each) for each in (False, True))
    other = "" if signed == unsigned else f", signed {signed}"
    text = _text_of(data)
    return f"{unsigned} (0x{_hex_number(data)}{other}" + (f', text "{text}")' if text else ")")


def _show_bytes(data: bytes) -> str:
    if not data:
        return "empty (0 bytes)"
    cut = " ..." if len(data) > _SHOWN_BYTES else ""
    text = _text_of(data)
    return f'"{text}" ({_count(data)})' if text else f"{data[:_SHOWN_BYTES].hex(' ')}{cut} ({_count(data)})"


def _text_of(data: bytes) -> str:
    """Return the bytes as a text if they are one, else ""; zeros at the end are padding."""
    body = data.rstrip(b"\0")
    if len(body) < _TEXT_BYTES or len(data) > _SHOWN_BYTES * 4 or not all(32 <= byte < 127 for byte in body):
        return ""
    return body.decode("ascii")


def printable(text: str) -> str:
    """Return `text` with what a terminal would obey written as an escape."""
    return "".join(letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in text)


def _hex_number(data: bytes) -> str:
    return data[::-1].hex().upper()


def _count(data: bytes) -> str:
    return f"{len(data)} byte" if len(data) == 1 else f"{len(data)} bytes"
