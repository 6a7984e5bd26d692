"""Objects that hold the gains of a drive's velocity and position loop, and what their numbers are worth.

CiA 402 names 0x60F9 and 0x60FB and leaves their content to the maker, so no two makers share a scale: where the scale
of a device is not known, its gains cannot be set, only proposed. A gain is told here as the loops of its device see it:
torque in per mille of the rated one (0x6076), way in the user units of 0x6064, velocity in those per second.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import POSITION_CONTROL_PARAMETERS, VELOCITY_CONTROL_PARAMETERS, axis_index

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.od.model import ObjectDictionary


class LoopGain(enum.Enum):
    """A gain of a position P over a velocity PI, with its unit."""

    VELOCITY_P = "per mille s/unit"
    VELOCITY_I = "per mille/unit"
    POSITION_P = "1/s"
    VELOCITY_FEED_FORWARD = "of the demanded velocity"


@dataclass(frozen=True, slots=True)
class GainObject:
    """Where a gain stands, and what 1 in that object is worth."""

    index: int
    subindex: int
    scale: float


_PROFILE: Final = 0x6000  # from here on each axis has its own range
_OWN: Final[Mapping[LoopGain, GainObject]] = MappingProxyType(
    {
        LoopGain.VELOCITY_P: GainObject(VELOCITY_CONTROL_PARAMETERS, 1, 1e-5),
        LoopGain.VELOCITY_I: GainObject(VELOCITY_CONTROL_PARAMETERS, 2, 1e-5),
        LoopGain.POSITION_P: GainObject(POSITION_CONTROL_PARAMETERS, 1, 1e-3),
        LoopGain.VELOCITY_FEED_FORWARD: GainObject(POSITION_CONTROL_PARAMETERS, 2, 1e-3),
    }
)
_KNOWN: Final[Mapping[tuple[int, int], Mapping[LoopGain, GainObject]]] = MappingProxyType({(0, 0x402): _OWN})
"""Vendor and product (0x1018) to the gains of that device."""


_FIRST, _SECOND = (1, 2)
_PI: Final = {LoopGain.VELOCITY_P: _FIRST, LoopGain.VELOCITY_I: _SECOND}
_P: Final = {LoopGain.POSITION_P: _FIRST}
_MAKERS: Final = (
    ("maxon", ((0x30A2, _PI), (0x30A1, _P))),  # EPOS4
    ("maxon", ((VELOCITY_CONTROL_PARAMETERS, _PI), (POSITION_CONTROL_PARAMETERS, _P))),  # before it
    (
        "copley",
        (
            (VELOCITY_CONTROL_PARAMETERS, _PI),
            (POSITION_CONTROL_PARAMETERS, _P | {LoopGain.VELOCITY_FEED_FORWARD: _SECOND}),
        ),
    ),
    ("faulhaber", ((VELOCITY_CONTROL_PARAMETERS, _PI), (POSITION_CONTROL_PARAMETERS, _P))),
    ("kinco", ((VELOCITY_CONTROL_PARAMETERS, _PI),)),
    ("nanotec", ((0x321B, _PI),)),
)
"""A word of the maker's name, and the records of its drives that hold gains, as its public EDS files have them; what a
number in them is worth stands in the maker's manual alone."""


def gain_places(od: ObjectDictionary, axis: int = 0) -> dict[LoopGain, tuple[int, int]]:
    """Return where the maker of a drive holds gains whose scale only its manual tells; nothing where nobody knows."""
    maker = od.device.vendor_name.lower()
    for word, records in _MAKERS:
        places = {
            gain: (axis_index(index, axis) if index >= _PROFILE else index, subindex)
            for index, gains in records
            for gain, subindex in gains.items()
        }
        if word in maker and all(places[gain] in od for gain in _PI):
            return {gain: place for gain, place in places.items() if place in od}
    return {}


def gain_objects(od: ObjectDictionary, axis: int = 0) -> dict[LoopGain, GainObject]:
    """Return where an axis of a device holds its gains; nothing where it has none, or nobody knows their scale."""
    known = _KNOWN.get((_identity(od, 1), _identity(od, 2)), {})
    shifted = {
        gain: GainObject(axis_index(each.index, axis), each.subindex, each.scale) for gain, each in known.items()
    }
    return {gain: each for gain, each in shifted.items() if (each.index, each.subindex) in od}


def _identity(od: ObjectDictionary, subindex: int) -> int:
    entry = od.get(0x1018, subindex)
    value = None if entry is None else entry.default
    told = {1: od.device.vendor_number, 2: od.device.product_number}[subindex]
    return value if isinstance(value, int) else told or 0
