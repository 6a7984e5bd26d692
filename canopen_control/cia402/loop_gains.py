"""Objects with the gains of a drive's velocity and position loops, and their scales.

CiA 402 names 0x60F9 and 0x60FB but leaves their content to the manufacturer, so that scales differ: gains for a device
with unknown scales can be proposed but not set. Gains are in the units of the drive's loops: torque in per mille of the
rated torque (0x6076), position in the user units of 0x6064, velocity in these units per second.
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
    """Gain of a position P controller with a velocity PI controller; the value is the unit of the gain."""

    VELOCITY_P = "per mille s/unit"
    VELOCITY_I = "per mille/unit"
    POSITION_P = "1/s"
    VELOCITY_FEED_FORWARD = "of the demanded velocity"


@dataclass(frozen=True, slots=True)
class GainObject:
    """Object that contains a gain, which is `scale` times the value of the object."""

    index: int
    subindex: int
    scale: float


_PROFILE: Final = 0x6000  # from this index on every axis has its own objects
_OWN: Final[Mapping[LoopGain, GainObject]] = MappingProxyType(
    {
        LoopGain.VELOCITY_P: GainObject(VELOCITY_CONTROL_PARAMETERS, 1, 1e-5),
        LoopGain.VELOCITY_I: GainObject(VELOCITY_CONTROL_PARAMETERS, 2, 1e-5),
        LoopGain.POSITION_P: GainObject(POSITION_CONTROL_PARAMETERS, 1, 1e-3),
        LoopGain.VELOCITY_FEED_FORWARD: GainObject(POSITION_CONTROL_PARAMETERS, 2, 1e-3),
    }
)
_KNOWN: Final[Mapping[tuple[int, int], Mapping[LoopGain, GainObject]]] = MappingProxyType({(0, 0x402): _OWN})
"""Gain objects of devices by vendor id and product code (0x1018)."""


_FIRST, _SECOND = (1, 2)
_PI: Final = {LoopGain.VELOCITY_P: _FIRST, LoopGain.VELOCITY_I: _SECOND}
_P: Final = {LoopGain.POSITION_P: _FIRST}
_MAKERS: Final = (
    ("maxon", ((0x30A2, _PI), (0x30A1, _P))),  # EPOS4
    ("maxon", ((VELOCITY_CONTROL_PARAMETERS, _PI), (POSITION_CONTROL_PARAMETERS, _P))),  # older devices
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
"""Part of a manufacturer's name, and the gain records in its public EDS files, whose scales are unknown here."""


def gain_places(od: ObjectDictionary, axis: int = 0) -> dict[LoopGain, tuple[int, int]]:
    """Return the index and subindex of each gain, chosen by the manufacturer's name; empty for an unknown device."""
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
    """Return the objects of an axis that contain gains of known scale; empty for an unknown device."""
    by_gain = _KNOWN.get((_identity(od, 1), _identity(od, 2)), {})
    shifted = {
        gain: GainObject(axis_index(gain_object.index, axis), gain_object.subindex, gain_object.scale)
        for gain, gain_object in by_gain.items()
    }
    return {
        gain: gain_object for gain, gain_object in shifted.items() if (gain_object.index, gain_object.subindex) in od
    }


def _identity(od: ObjectDictionary, subindex: int) -> int:
    entry = od.get(0x1018, subindex)
    value = None if entry is None else entry.default
    number = {1: od.device.vendor_number, 2: od.device.product_number}[subindex]
    return value if isinstance(value, int) else number or 0
