"""Modes of operation (CiA 402-2, 0x6060, 0x6061, 0x6502), and their bits in controlword and statusword.

A mode is requested only if 0x6502 lists it. One table lists the modes for each command interface of a joint, cyclic
modes before profile modes. The mode 0 (no mode) is never chosen automatically, because some drives do not support it.
"""

from __future__ import annotations

from enum import IntEnum
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.cia402 import objects
from canopen_control.errors import UnsupportedMode

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


class OperationMode(IntEnum):
    """Modes of operation with a number in CiA 402-2; negative (manufacturer-specific) numbers are plain ints."""

    NONE = 0
    PP = 1  # profile position
    VL = 2  # velocity, of frequency converters
    PV = 3  # profile velocity
    TQ = 4  # profile torque
    HM = 6  # homing
    IP = 7  # interpolated position
    CSP = 8  # cyclic synchronous position
    CSV = 9  # cyclic synchronous velocity
    CST = 10  # cyclic synchronous torque
    CSTCA = 11  # cyclic synchronous torque with commutation angle


_SELECTABLE = tuple(mode for mode in OperationMode if mode)
_NAMES = {int(mode): mode.name for mode in OperationMode}


def mode_of(number: int) -> int:
    """Return the `OperationMode` for a number of CiA 402-2; other numbers are unchanged."""
    return OperationMode(number) if number in _NAMES else number


@lru_cache(maxsize=64)
def supported_modes(supported_drive_modes: int) -> tuple[OperationMode, ...]:
    """Return the modes in a value of 0x6502 in ascending order, without manufacturer-specific and reserved bits."""
    return tuple(mode for mode in _SELECTABLE if supported_drive_modes >> (mode - 1) & 1)


def mode_name(mode: int) -> str:
    """Return the short name of any mode number: `CSP`, `mode -3 (manufacturer)`, `mode 5 (reserved)`."""
    kind = "manufacturer" if mode < 0 else "reserved"
    return _NAMES.get(mode) or f"mode {mode} ({kind})"


def mode_words(mode: int) -> str:
    """Return a mode with the word "mode" for use in a sentence: `mode CSP`, `mode -3 (manufacturer)`."""
    name = mode_name(mode)
    return name if name.startswith("mode ") else f"mode {name}"


INTERFACE_MODES: Mapping[str, tuple[OperationMode, ...]] = MappingProxyType(
    {
        "position": (OperationMode.CSP, OperationMode.PP),
        "velocity": (OperationMode.CSV, OperationMode.PV),
        "effort": (OperationMode.CST, OperationMode.TQ),
    }
)
"""Modes for each command interface, best mode first."""

TARGET_OBJECTS: Mapping[int, tuple[int, int]] = MappingProxyType(
    {
        OperationMode.PP: (objects.TARGET_POSITION, 0),
        OperationMode.VL: (objects.VL_TARGET_VELOCITY, 0),
        OperationMode.PV: (objects.TARGET_VELOCITY, 0),
        OperationMode.TQ: (objects.TARGET_TORQUE, 0),
        OperationMode.IP: (objects.INTERPOLATION_DATA, 1),
        OperationMode.CSP: (objects.TARGET_POSITION, 0),
        OperationMode.CSV: (objects.TARGET_VELOCITY, 0),
        OperationMode.CST: (objects.TARGET_TORQUE, 0),
    }
)
"""Index and subindex of each mode's target on axis 0; homing has none, those of manufacturers' modes are unknown."""


def mode_for_interface(interface: str, supported: Iterable[int]) -> OperationMode:
    """Return the best supported mode for the command interface "position", "velocity" or "effort".

    Raise UnsupportedMode if the drive supports no such mode, or if the interface is unknown.
    """
    present = tuple(supported)
    modes = INTERFACE_MODES.get(interface, ())
    for mode in modes:
        if mode in present:
            return mode
    named = " or ".join(mode.name for mode in modes) or "any mode"
    raise UnsupportedMode(f"{named} for interface {interface!r}", tuple(map(mode_name, present)))


def require_mode(mode: int, supported: Iterable[int]) -> None:
    """Raise UnsupportedMode if a mode is not in `supported`.

    Manufacturer-specific (negative) modes are not checked, and neither are drives that list no modes: their reaction to
    the request decides.
    """
    present = tuple(supported)
    # CiA 402-2, 0x6502 is optional, and its bits cover only the modes of the profile
    if mode >= 0 and present and mode not in present:
        raise UnsupportedMode(mode_name(mode), tuple(map(mode_name, present)))


class ModeBits(NamedTuple):
    """Meanings of a mode's mode-specific bits, by bit number."""

    controlword: Mapping[int, str]
    statusword: Mapping[int, str]


_HALT = {8: "halt"}
_CYCLIC = ModeBits(_HALT, {12: "follows the set-point"})  # bit 10 is reserved: never "target reached"
MODE_BITS: Mapping[int, ModeBits] = MappingProxyType(
    {
        OperationMode.PP: ModeBits(
            {4: "new set-point", 5: "change immediately", 6: "relative", 9: "change on set-point", **_HALT},
            {10: "target reached", 12: "set-point acknowledged", 13: "following error"},
        ),
        OperationMode.VL: ModeBits({4: "enable ramp", 5: "unlock ramp", 6: "reference ramp", **_HALT}, {}),
        OperationMode.PV: ModeBits(_HALT, {10: "target reached", 12: "speed is zero", 13: "maximum slippage"}),
        OperationMode.TQ: ModeBits(_HALT, {10: "target reached"}),
        OperationMode.HM: ModeBits(
            {4: "start homing", **_HALT},
            {10: "target reached", 12: "homing attained", 13: "homing error"},
        ),
        OperationMode.IP: ModeBits(
            {4: "enable interpolation", **_HALT},
            {10: "target reached", 12: "interpolation active"},
        ),
        OperationMode.CSP: ModeBits(_HALT, {**_CYCLIC.statusword, 13: "following error"}),
        OperationMode.CSV: _CYCLIC,
        OperationMode.CST: _CYCLIC,
        OperationMode.CSTCA: _CYCLIC,
    }
)
"""Mode-specific bits 4 to 6, 8 and 9 of the controlword, and 10, 12 and 13 of the statusword (CiA 402-2)."""
