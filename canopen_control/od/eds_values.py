"""Parser of numbers and values in EDS and DCF files (CiA 306-1, 4.4).

Numbers are decimal, hexadecimal with 0x, or octal with a leading 0; $NODEID may be added. Other notations of vendors
are accepted with an issue if they are unambiguous. A hexadecimal INTEGERn is the two's complement of the value. A REAL
is written in decimal, or as its IEEE 754 bits in hexadecimal.
"""

from __future__ import annotations

import re
from functools import lru_cache
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.od.codec import REALS
from canopen_control.od.issues import Severity
from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from canopen_control.od.model import Value


_NUMBER = re.compile(r"([+-]?)(?:0[xX]([0-9A-Fa-f]+)|0([0-7]+)|([0-9]+))([uUlL]*)", re.ASCII)
_DECIMAL = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?", re.ASCII)
_HEX_SUFFIX = re.compile(r"([0-9][0-9A-Fa-f]*)[hH]", re.ASCII)
_WORDS = {"true": 1, "false": 0}
_NODE_ID = "$nodeid"
_MAX_DIGITS = 64  # the longest number has 20 digits; longer texts would only cost time in int()
_RANGES = {t: (t.minimum, t.maximum, 1 << (t.bits or 0)) for t in DataType if t.is_integer}


class ValueIssue(NamedTuple):
    """Unusual notation of a value that could still be parsed."""

    code: str
    severity: Severity
    text: str


class Parsed(NamedTuple):
    """Parsed value, or None if the text is empty; `relative` is True if the text contained $NODEID."""

    value: Value | None
    relative: bool = False
    issue: ValueIssue | None = None


class Number(NamedTuple):
    """Parsed integer; `is_hex` is True if the number may be in two's complement."""

    value: int
    is_hex: bool = False
    issue: ValueIssue | None = None


_COMMENT = ValueIssue("number-comment", Severity.WARNING, "the comment after # is ignored; CiA 306 allows only ;")
_SUFFIX = ValueIssue("number-suffix", Severity.WARNING, "the suffix is ignored")
_WORD = ValueIssue("number-word", Severity.NOTE, "TRUE is treated as 1, FALSE as 0")
_H = ValueIssue("number-suffix", Severity.WARNING, "the suffix h is treated as hexadecimal")
_FRACTION = ValueIssue("number-fraction", Severity.WARNING, "the fraction of zero is ignored")
_UTF8 = ValueIssue("text-utf8", Severity.NOTE, "characters outside ISO 8859-1 are encoded as UTF-8")
_DAYS = ValueIssue("time-form", Severity.NOTE, "two numbers are treated as days and milliseconds")
_TWO, _LATIN = 2, 0xFF
_TWOS = ValueIssue("number-sign", Severity.WARNING, "treated as two's complement")
_EXTENDED = ValueIssue("number-sign", Severity.WARNING, "treated as two's complement with more bits than the type")
_PARENTHESES = ValueIssue("number-form", Severity.WARNING, "the parentheses are ignored")
_WIDER = (32, 64)  # bits of the integers that tools print in hexadecimal


def parse_value(text: str, data_type: DataType, node_id: int | None = None) -> Parsed:
    """Parse `text` as a value of `data_type`; raise ValueError with the reason if invalid.

    $NODEID counts as 0 if `node_id` is None.
    """
    parse = _PARSERS.get(data_type)
    if parse is not None:
        return parse(text, data_type)
    return _whole(text, data_type, node_id)


def _whole(text: str, data_type: DataType, node_id: int | None) -> Parsed:
    if "$" in text:
        return _fitted(_relative(text, node_id), data_type, True, text)
    number = parse_number(text)
    low, high, _ = _RANGES[data_type]
    if low <= number.value <= high:
        return Parsed(number.value, False, number.issue)
    return _fitted(number, data_type, False, text)


def format_value(value: Value, data_type: DataType) -> str:
    """Return the text of a value in a form that `parse_value` reads as the same value."""
    if isinstance(value, bytes):
        return value.hex(" ").upper()
    if data_type in REALS and isinstance(value, int | float):
        return _format_real(float(value), data_type)
    if isinstance(value, int) and not data_type.signed and (data_type.bits or 0) > 8:
        return f"0x{value:0{(data_type.bits or 0) // 4}X}"
    return str(value)


def real_bits(value: float, data_type: DataType) -> str:
    """Return the bits of a REAL32 or REAL64 in hexadecimal, the only notation that every reader accepts.

    Lely's dcfgen refuses a file that has a REAL with a decimal point.
    """
    layout = REALS[data_type]
    return f"0x{int.from_bytes(layout.pack(value), 'little'):0{2 * layout.size}X}"


def parse_number(text: str) -> Number:
    """Parse an integer in EDS notation; raise ValueError if it is not a number.

    Short texts are cached, since the same few values recur in most files.
    """
    return _parse_short(text) if len(text) <= _MAX_DIGITS else _parse_any(text)


def _parse_any(text: str) -> Number:
    issue: ValueIssue | None = None
    for mark in ";#":
        if mark in text:
            text = text.partition(mark)[0]
            issue = _COMMENT if mark == "#" else issue
    text = text.strip()
    if len(text) > _MAX_DIGITS:
        raise ValueError("not a number")
    match = _NUMBER.fullmatch(text)
    if match is None:
        return _odd_number(text, issue)
    sign, hexadecimal, octal, decimal, suffix = match.groups()
    issue = _SUFFIX if suffix else issue
    if hexadecimal is not None:
        number = int(hexadecimal, 16)
    elif octal is not None:
        number = int(octal, 8)
        issue = issue or _octal(text, number, int(octal))
    else:
        number = int(decimal)  # also 08 and 09, which are not octal
    return Number(-number if sign == "-" else number, hexadecimal is not None, issue)


_parse_short = lru_cache(maxsize=1024)(_parse_any)


def _octal(text: str, octal: int, decimal: int) -> ValueIssue | None:
    if octal == decimal:
        return None
    return ValueIssue("number-octal", Severity.NOTE, f"the leading 0 of {text} makes it octal: {octal}, not {decimal}")


def _odd_number(text: str, issue: ValueIssue | None) -> Number:
    if (word := _WORDS.get(text.lower())) is not None:
        return Number(word, issue=issue or _WORD)
    if (match := _HEX_SUFFIX.fullmatch(text)) is not None:
        return Number(int(match[1], 16), True, _H)
    if _DECIMAL.fullmatch(text) and float(text).is_integer():
        return Number(int(float(text)), issue=_FRACTION)
    raise ValueError("not a number")


def _relative(text: str, node_id: int | None) -> Number:
    """Return the value of a sum such as ``$NODEID+0x200``, with its terms in any order; raise ValueError if invalid."""
    text = text.partition(";")[0].strip()
    issue = None
    if text.startswith("(") and text.endswith(")"):
        text, issue = text[1:-1], _PARENTHESES
    parts = [part.strip() for part in text.split("+", 4)]
    names = [part for part in parts if "$" in part]
    if len(names) != 1 or names[0].lower() != _NODE_ID:
        raise ValueError("neither a number nor $NODEID plus a number")
    numbers = [parse_number(part) for part in parts if "$" not in part]
    if sum(number.value for number in numbers) < 0:  # as an unsigned number it would have another value per node
        raise ValueError("$NODEID minus a number is not possible (CiA 306-1)")
    issue = next((number.issue for number in numbers if number.issue is not None), issue)
    return Number(sum(number.value for number in numbers) + (node_id or 0), True, issue)


def _fitted(number: Number, data_type: DataType, relative: bool, text: str) -> Parsed:
    value, is_hex, issue = number
    low, high, span = _RANGES[data_type]
    if low <= value <= high:
        return Parsed(value, relative, issue)
    if high < value < span:  # only signed types have this gap
        return Parsed(value - span, relative, issue or (None if is_hex else _TWOS))
    for bits in _WIDER:  # INTEGER16 as 0xFFFF8000
        if is_hex and low < 0 and low <= value - (1 << bits) < 0:
            return Parsed(value - (1 << bits), relative, issue or _EXTENDED)
    if -span // 2 <= value < 0 and low == 0 and span > 2:
        return Parsed(value + span, relative, issue or _TWOS)
    raise ValueError(f"{text[:_MAX_DIGITS]} does not fit {data_type.name} ({low} to {high})")


def _real(text: str, data_type: DataType) -> Parsed:
    text = text.partition(";")[0].strip()
    layout = REALS[data_type]
    if len(text) <= _MAX_DIGITS and _DECIMAL.fullmatch(text):
        return Parsed(_representable(float(text), data_type))
    number = parse_number(text)
    if not number.is_hex or not 0 <= number.value < 1 << (8 * layout.size):
        raise ValueError("neither a decimal number nor the bits of a number in hexadecimal")
    bits: float = layout.unpack(number.value.to_bytes(layout.size, "little"))[0]
    return Parsed(bits, False, number.issue)


def _representable(value: float, data_type: DataType) -> float:
    try:
        fits = isfinite(REALS[data_type].unpack(REALS[data_type].pack(value))[0])
    except OverflowError:
        fits = False
    if not fits:
        raise ValueError(f"{value!r} is too large for {data_type.name}")
    return value


def _format_real(value: float, data_type: DataType) -> str:
    text = repr(value)
    if _DECIMAL.fullmatch(text):
        return text
    return real_bits(value, data_type)  # not a number, or infinite: only the bits can express it


def _bytes(text: str, _data_type: DataType) -> Parsed:
    digits = text[2:] if text[:2] in ("0x", "0X") else text
    try:
        return Parsed(bytes.fromhex(digits))
    except ValueError:
        issue = ValueIssue("bytes-text", Severity.NOTE, "not in hexadecimal; the characters are treated as bytes")
        return Parsed(_latin(text), False, issue)


def _text(text: str, data_type: DataType) -> Parsed:
    if data_type is DataType.VISIBLE_STRING and any(ord(char) > _LATIN for char in text):
        return Parsed(text, False, _UTF8)
    return Parsed(text)


def _time(text: str, data_type: DataType) -> Parsed:
    """Parse a 48-bit time: either one number, or days and milliseconds."""
    parts = text.partition(";")[0].split()
    if len(parts) != _TWO:
        return _whole(text, data_type, None)
    days, milliseconds = (parse_number(part).value for part in parts)
    if not (0 <= days < 1 << 16 and 0 <= milliseconds < 1 << 32):
        raise ValueError("days are 0 to 65535, milliseconds 0 to 4294967295")
    return Parsed(days << 32 | milliseconds, False, _DAYS)


def _latin(text: str) -> bytes:
    try:
        return text.encode("latin-1")
    except UnicodeEncodeError:
        raise ValueError("characters outside ISO 8859-1") from None


_PARSERS = {  # all other types are integers
    DataType.VISIBLE_STRING: _text,
    DataType.UNICODE_STRING: _text,
    DataType.OCTET_STRING: _bytes,
    DataType.DOMAIN: _bytes,
    DataType.TIME_OF_DAY: _time,
    DataType.TIME_DIFFERENCE: _time,
    DataType.REAL32: _real,
    DataType.REAL64: _real,
}
