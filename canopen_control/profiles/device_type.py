"""Profile of a device, such as CiA 401 (I/O) or CiA 418 (battery), determined from its object dictionary.

The low word of 0x1000 is the number of the profile, but half of all files have 0 there, and some call a drive an I/O
module. A device with controlword and statusword is therefore a drive, and without a number in 0x1000 the objects
decide.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Final

from canopen_control.od.model import DataType

if TYPE_CHECKING:
    from canopen_control.od.model import ObjectDictionary


DEVICE_TYPE: Final = 0x1000
_CONTROLWORD, _STATUSWORD, _AXIS_OFFSET, _AXES = 0x6040, 0x6041, 0x800, 8


class Profile(enum.IntEnum):
    """Device profiles by the number of their CiA standard; NONE for an unknown profile."""

    NONE = 0
    IO = 401
    DRIVE = 402
    MEASURING = 404
    ENCODER = 406
    INCLINOMETER = 410
    BATTERY = 418
    CHARGER = 419
    ENERGY = 454

    @property
    def words(self) -> str:
        """Description of a device with this profile, for messages."""
        return _WORDS[self]


_WORDS: Final = {
    Profile.NONE: "device",
    Profile.IO: "I/O module (CiA 401)",
    Profile.DRIVE: "drive (CiA 402)",
    Profile.MEASURING: "measuring device (CiA 404)",
    Profile.ENCODER: "encoder (CiA 406)",
    Profile.INCLINOMETER: "inclinometer (CiA 410)",
    Profile.BATTERY: "battery (CiA 418)",
    Profile.CHARGER: "battery charger (CiA 419)",
    Profile.ENERGY: "energy management device (CiA 454)",
}

T = DataType
#: objects (index, subindex, type), all required -> the profile, if 0x1000 names none; the first that fits
_SIGNATURES: Final = (
    (((0x6060, 0, T.UNSIGNED32), (0x6081, 0, T.UNSIGNED8)), Profile.BATTERY),
    (((0x6001, 0, T.UNSIGNED32), (0x6004, 0, T.UNSIGNED32)), Profile.ENCODER),
    (((0x6000, 0, T.UNSIGNED16), (0x6010, 0, T.INTEGER16)), Profile.INCLINOMETER),
    (((0x6150, 1, T.UNSIGNED8), (0x7130, 1, T.INTEGER16)), Profile.MEASURING),
    (((0x6150, 1, T.UNSIGNED8), (0x9130, 1, T.INTEGER32)), Profile.MEASURING),
    (((0x6000, 1, T.UNSIGNED8),), Profile.IO),
    (((0x6200, 1, T.UNSIGNED8),), Profile.IO),
    (((0x6401, 1, T.INTEGER16),), Profile.IO),
    (((0x6411, 1, T.INTEGER16),), Profile.IO),
)


def profile_of(od: ObjectDictionary) -> Profile:
    """Return the profile of a device; NONE if neither 0x1000 nor the objects indicate a known profile."""
    if any(
        (_CONTROLWORD + _AXIS_OFFSET * axis, 0) in od and (_STATUSWORD + _AXIS_OFFSET * axis, 0) in od
        for axis in range(_AXES)
    ):
        return Profile.DRIVE
    entry = od.get(DEVICE_TYPE)  # the low word is the number of the profile (CiA 301 7.5.2.1)
    number = entry.value & 0xFFFF if entry is not None and isinstance(entry.value, int) else 0
    if number:
        is_known = number in _WORDS and number != Profile.DRIVE
        return Profile(number) if is_known else Profile.NONE
    for objects, profile in _SIGNATURES:
        if all(
            (declared := od.get(index, subindex)) is not None and declared.data_type is kind
            for index, subindex, kind in objects
        ):
            return Profile.CHARGER if profile is Profile.BATTERY and _receives_charge(od) else profile
    return Profile.NONE


def _receives_charge(od: ObjectDictionary) -> bool:
    """Whether the state of charge is writable: a charger has the objects of a battery, but receives their values."""
    entry = od.get(0x6081)
    return entry is not None and entry.writable and entry.rpdo_mappable
