"""Signal of a device: its object or bit, the conversion of raw numbers to units, and invalid numbers.

value = raw * factor * (scales read from the device) + offset, and the inverse for outputs; a bit is 0 or 1. The value
of an invalid raw number is nan.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.od.codec import decode, encode
from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.od.model import Address, Value


_OBJECT: Final = re.compile(r"(?:0[xX])?([0-9A-Fa-f]{4})(?::(?:0[xX])?([0-9A-Fa-f]{1,2}))?(?:\.(\d{1,2}))?")

TYPES: Final = {
    "bool": DataType.BOOLEAN,
    **{f"u{bits}": DataType[f"UNSIGNED{bits}"] for bits in (8, 16, 24, 32, 64)},
    **{f"i{bits}": DataType[f"INTEGER{bits}"] for bits in (8, 16, 24, 32, 64)},
    "f32": DataType.REAL32,
    "f64": DataType.REAL64,
}
"""Names of the types that can replace the type of an object."""


@dataclass(frozen=True, slots=True)
class SignalScale:
    """Scale factor in an object of the device: `of` computes the factor; `assumed` is used if the object is missing.

    The object is read after the boot of the node and not taken from a file, because users and devices change it.
    """

    address: Address
    of: Callable[[int], float]
    assumed: int


@dataclass(frozen=True, slots=True)
class Signal:
    """Input or output of a device; its value is invalid while the number in the object `status` is not 0.

    `data_type` overrides the type of the object, None: as in the file. `invalid` contains raw numbers without a value.
    `unwrap` is the object with the range of a position: the value is then the continuous travel since the first value.
    `safe` is the value of an output without a master, None: unchanged. `max_rate` is the largest plausible rate of an
    input in units per second; a faster change is a jump.
    """

    name: str
    index: int
    subindex: int = 0
    output: bool = False
    bit: int | None = None
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""
    data_type: DataType | None = None
    invalid: tuple[float, ...] = ()
    status: Address | None = None
    scales: tuple[SignalScale, ...] = ()
    unwrap: Address | None = None
    safe: float | None = 0.0
    max_rate: float | None = None

    @property
    def address(self) -> Address:
        """Address of the object: the pair (index, subindex)."""
        return self.index, self.subindex

    @property
    def where(self) -> str:
        """Address of the object and bit, for messages."""
        return f"0x{self.index:04X}:{self.subindex:02X}" + ("" if self.bit is None else f".{self.bit}")

    @property
    def needs(self) -> tuple[Address, ...]:
        """Addresses of the objects whose values the conversion needs."""
        return (*(scale.address for scale in self.scales), *(() if self.unwrap is None else (self.unwrap,)))

    def gain(self, numbers: Mapping[Address, Value]) -> float:
        """Return the units per raw number; `numbers` are the values read from the objects in `needs`."""
        gain = self.factor
        for scale in self.scales:
            number = numbers.get(scale.address)
            gain *= scale.of(number if isinstance(number, int) else scale.assumed)
        return gain

    def value(self, raw: float, gain: float) -> float:
        """Return the value of a raw number; nan if the number is invalid."""
        if raw in self.invalid:
            return math.nan
        if self.bit is not None:
            return float(int(raw) >> self.bit & 1)
        return raw * gain + self.offset

    def raw(self, value: float, gain: float, *, whole: bool) -> float:
        """Return the raw number of a value; `whole` rounds to an integer, for objects of integer types."""
        raw = (value - self.offset) / gain
        return round(raw) if whole else raw


def object_of(text: str) -> tuple[int, int, int | None] | None:
    """Return index, subindex and bit of ``0x6401:01``, ``6000:1.3`` or ``0x6004``; None for other texts."""
    match = _OBJECT.fullmatch(text.strip())
    if match is None:
        return None
    bit = None if match[3] is None else int(match[3])
    return None if bit is not None and bit > 63 else (int(match[1], 16), int(match[2] or "0", 16), bit)


def retyped(value: Value, source: DataType, target: DataType) -> Value:
    """Return a value with its bits interpreted as another type; nan if the bits are invalid for the type."""
    try:
        return decode(encode(value, source), target)
    except ValueError:
        return math.nan


# -- units and prefixes as coded in objects (CiA 303-2): unit in bits 16 to 23, prefix as a power of ten in bits 24 to
# 31

_UNITS: Final = {
    0x01: "m",
    0x02: "kg",
    0x03: "s",
    0x04: "A",
    0x05: "K",
    0x10: "rad",
    0x20: "Hz",
    0x21: "N",
    0x22: "Pa",
    0x23: "J",
    0x24: "W",
    0x26: "V",
    0x28: "Ohm",
    0x2D: "degC",
}


def unit_of_code(code: int) -> str:
    """Return the name of a coded unit, such as "degC" for 0x002D0000, or "" if it is not in the table."""
    return _UNITS.get(code >> 16 & 0xFF, "")


def factor_of_prefix(code: int) -> float:
    """Return the factor of a coded prefix, such as 0.001 for 0xFD260000 (millivolt)."""
    power = code >> 24 & 0xFF
    return float(10.0 ** (power - 0x100 if power > 0x7F else power))


def factor_of_digits(digits: int) -> float:
    """Return the weight of the last of `digits` decimal digits; 1.0 for an invalid number."""
    return float(10.0**-digits) if 0 <= digits <= 9 else 1.0
