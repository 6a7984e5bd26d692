"""The bits of an object by name: statusword, controlword, error register, supported modes, digital inputs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.cia301.emcy_codes import REGISTER_TEXTS
from canopen_control.cia402 import objects
from canopen_control.cia402.modes import MODE_BITS, OperationMode

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["NamedBit", "axis_word", "bits_of", "statusword_bits"]

_STATUSWORD: Final = {
    0: "ready to switch on",
    1: "switched on",
    2: "operation enabled",
    3: "fault",
    4: "voltage enabled",
    5: "no quick stop",
    6: "switch on disabled",
    7: "warning",
    9: "remote",
    10: "target reached",
    11: "internal limit",
}
_CONTROLWORD: Final = {
    0: "switch on",
    1: "enable voltage",
    2: "no quick stop",
    3: "enable operation",
    7: "fault reset",
    8: "halt",
}
_INPUTS: Final = {0: "negative limit switch", 1: "positive limit switch", 2: "home switch", 3: "interlock"}
_MODES: Final = {mode - 1: mode.name for mode in OperationMode if mode > 0}
_ERROR_REGISTER: Final = 0x1001


class NamedBit(NamedTuple):
    """A bit that means something, and whether it is set."""

    bit: int
    name: str
    on: bool


def axis_word(index: int) -> bool:
    """Whether an object is a statusword or a controlword: some of their bits are those of the mode of operation."""
    return objects.axis_of(index)[0] in (objects.STATUSWORD, objects.CONTROLWORD)


def statusword_bits(word: int, mode: int | str | None = None) -> list[NamedBit]:
    """Return the bits of a statusword; `mode`, a number or a name, is what bits 10, 12 and 13 belong to."""
    number = OperationMode.__members__.get(mode) if isinstance(mode, str) else mode
    known = MODE_BITS.get(number) if number is not None else None
    return _named(word, {**_STATUSWORD, **(known.statusword if known is not None else {})})


def bits_of(index: int, subindex: int, value: object, mode: int | None = None) -> list[NamedBit]:
    """Return the bits of an object that has named ones; none for all others."""
    base = objects.axis_of(index)[0]
    if subindex or not isinstance(value, int):
        return []
    if base == objects.STATUSWORD:
        return statusword_bits(value, mode)
    if base == objects.CONTROLWORD:
        known = MODE_BITS.get(mode) if mode is not None else None
        return _named(value, {**_CONTROLWORD, **(known.controlword if known is not None else {})})
    if index == _ERROR_REGISTER:
        return _named(value, {bit.bit_length() - 1: text for bit, text in REGISTER_TEXTS.items()})
    if base == objects.SUPPORTED_DRIVE_MODES:
        return _named(value, _MODES)
    return _named(value, _INPUTS) if base == objects.DIGITAL_INPUTS else []


def _named(value: int, names: Mapping[int, str]) -> list[NamedBit]:
    return [NamedBit(bit, names[bit], bool(value >> bit & 1)) for bit in sorted(names)]
