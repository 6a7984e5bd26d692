"""All signals of a device: those of its profile, and objects by their address.

Objects have no names that two makers share, so the name of a signal is the profile's (`di0`, `position`), or that of
bus.yml; a device of CiA 454 has none but those. ``0x6401:01`` and ``0x6000:01.3`` name any object, or a bit of it, with
its raw number.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.profiles.device_signal import Signal, object_of
from canopen_control.profiles.device_type import Profile
from canopen_control.profiles.io_tables import io_signals
from canopen_control.profiles.sensor_tables import (
    battery_signals,
    charger_signals,
    encoder_signals,
    inclinometer_signals,
    measuring_signals,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.od.model import ObjectDictionary

__all__ = ["object_signal", "profile_signals"]

_TABLES: Final[dict[Profile, Callable[[ObjectDictionary], Iterator[Signal]]]] = {
    Profile.IO: io_signals,
    Profile.MEASURING: measuring_signals,
    Profile.ENCODER: encoder_signals,
    Profile.INCLINOMETER: inclinometer_signals,
    Profile.BATTERY: battery_signals,
    Profile.CHARGER: charger_signals,
}


def profile_signals(od: ObjectDictionary, profile: Profile) -> dict[str, Signal]:
    """Return the signals of a device by name, in the order of its table; none of a drive or an unknown profile."""
    table = _TABLES.get(profile)
    return {} if table is None else {signal.name: signal for signal in table(od)}


def object_signal(od: ObjectDictionary, name: str) -> Signal | None:
    """Return the raw number of an object as a signal that is named by its address, None where there is none."""
    found = object_of(name) if name[:2] in ("0x", "0X") else None
    entry = None if found is None else od.get(found[0], found[1])
    if found is None or entry is None or entry.data_type.bits is None:
        return None
    return Signal(name, found[0], found[1], output=entry.rpdo_mappable and entry.writable, bit=found[2])
