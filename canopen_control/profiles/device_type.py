"""Which device profile a dictionary is of: CiA 401 I/O, 404 measuring, 406 encoder, 418 battery, ...

The low word of 0x1000 is the number of the profile, but half of all files have none there, and some call a drive an
I/O module: a drive is what has a controlword and a statusword, and where 0x1000 says nothing the objects do.
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
    """The profiles by the number of their standard, as the low word of 0x1000 has it; NONE: one that is not known."""

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
        """What a device of the profile is called."""
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
#: objects (index, subindex, type) that all must be there -> the profile, where 0x1000 says nothing; the first that fits
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
    """Return the profile of a device, NONE where neither 0x1000 nor its objects tell one that is known here."""
    if any(
        (_CONTROLWORD + _AXIS_OFFSET * axis, 0) in od and (_STATUSWORD + _AXIS_OFFSET * axis, 0) in od
        for axis in range(_AXES)
    ):
        return Profile.DRIVE
    entry = od.get(DEVICE_TYPE)
    number = entry.value & 0xFFFF if entry is not None and isinstance(entry.value, int) else 0
    if number:
        known = number in _WORDS and number != Profile.DRIVE
        return Profile(number) if known else Profile.NONE
    for objects, profile in _SIGNATURES:
        if all(
            (found := od.get(index, subindex)) is not None and found.data_type is kind
            for index, subindex, kind in objects
        ):
            return Profile.CHARGER if profile is Profile.BATTERY and _is_told_the_charge(od) else profile
    return Profile.NONE


def _is_told_the_charge(od: ObjectDictionary) -> bool:
    """Whether the state of charge of the battery comes from outside, which makes a charger of the same objects."""
    entry = od.get(0x6081)
    return entry is not None and entry.writable and entry.rpdo_mappable
