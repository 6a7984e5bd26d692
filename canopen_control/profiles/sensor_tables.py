"""Signals of sensors and chargers: measuring (CiA 404), encoders (406), inclinometers (410), batteries (418), 419.

What a raw number is worth stands in objects of the device (decimal digits, steps per turn, resolution) and is read from
there. Angles are in rad, the others in the unit that is named.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Final

from canopen_control.od.model import DataType
from canopen_control.profiles.device_signal import Scale, Signal, factor_of_digits, factor_of_prefix, unit_of_code

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.od.model import Entry, ObjectDictionary

__all__ = ["battery_signals", "charger_signals", "encoder_signals", "inclinometer_signals", "measuring_signals"]

_LINEAR: Final = (8, 9)  # high word of 0x1000 of an encoder that measures a length
_STEP_M: Final = 1e-9  # 0x6005:01 is in 0.001 um
_ANGLE_DEG: Final = 1e-3  # 0x6000 of an inclinometer is in 0.001 degrees


def _number(od: ObjectDictionary, index: int, subindex: int, default: int) -> int:
    entry = od.get(index, subindex)
    return entry.value if entry is not None and isinstance(entry.value, int) else default


def measuring_signals(od: ObjectDictionary) -> Iterator[Signal]:
    """Yield ai0, ... (process values, invalid with their status) and ao0, ... of a CiA 404 device.

    The same values may be there as floats, of 16 and of 32 bits: those that a TPDO maps are meant, else the first.
    """
    index = next((each for each in (0x7130, 0x9130, 0x6130, 0x8130) if _mapped(od, each)), None)
    index = index or next((each for each in (0x7130, 0x9130, 0x6130, 0x8130) if (each, 1) in od), None)
    for subindex in () if index is None else od.subindices(index):
        if 1 <= subindex < 0xFF:
            status = (0x6150, subindex) if (0x6150, subindex) in od else None
            unit, scales = _unit(od, index or 0, subindex, 0x6131, 0x6132)
            yield Signal(f"ai{subindex - 1}", index or 0, subindex, unit=unit, status=status, scales=scales)
            if status is not None:
                yield Signal(f"status{subindex - 1}", *status)
    for subindex in od.subindices(0x7300):
        if 1 <= subindex < 0xFF:
            unit, scales = _unit(od, 0x7300, subindex, 0x6301, 0x6302)
            yield Signal(f"ao{subindex - 1}", 0x7300, subindex, output=True, unit=unit, scales=scales)


def _mapped(od: ObjectDictionary, index: int) -> bool:
    """Whether a TPDO of the file carries the object."""
    return any(
        isinstance(entry.value, int) and entry.value >> 16 == index
        for entry in od
        if 0x1A00 <= entry.index < 0x1C00 and entry.subindex
    )


def _unit(od: ObjectDictionary, index: int, subindex: int, code: int, digits: int) -> tuple[str, tuple[Scale, ...]]:
    """Return the unit of a value, and where the device says its prefix and decimal digits."""
    scales = []
    if (code, subindex) in od:
        scales.append(Scale((code, subindex), factor_of_prefix, _number(od, code, subindex, 0)))
    entry = od.get(index, subindex)
    if (digits, subindex) in od and entry is not None and entry.data_type is not DataType.REAL32:
        scales.append(Scale((digits, subindex), factor_of_digits, _number(od, digits, subindex, 0)))
    return unit_of_code(_number(od, code, subindex, 0)), tuple(scales)


def _per_turn(steps: int) -> float:
    return math.tau / steps if steps > 0 else math.tau / 4096


def _per_step(thousandths: int) -> float:
    return thousandths * _STEP_M if thousandths > 0 else _STEP_M


def encoder_signals(od: ObjectDictionary) -> Iterator[Signal]:
    """Yield `position` (rad, of a linear encoder m, without end), `position_absolute` and `speed` of a CiA 406 device.

    The position of the device begins again at its total range (0x6002), that without end goes on. The unit of `speed`
    is the maker's.
    """
    if _number(od, 0x1000, 0, 0) >> 16 & 0xFF in _LINEAR:
        unit, scale = "m", Scale((0x6005, 1), _per_step, _number(od, 0x6005, 1, 1000))
    else:
        unit, scale = "rad", Scale((0x6001, 0), _per_turn, _number(od, 0x6001, 0, 4096))
    scales = (scale,) if scale.address in od else ()
    plain = 1.0 if scales else scale.of(scale.assumed)
    if (0x6004, 0) in od:
        wraps = (0x6002, 0) if (0x6002, 0) in od else None
        yield Signal("position", 0x6004, factor=plain, unit=unit, scales=scales, unwrap=wraps)
        yield Signal("position_absolute", 0x6004, factor=plain, unit=unit, scales=scales)
    elif (0x6020, 1) in od:
        yield Signal("position", 0x6020, 1, factor=plain, unit=unit, scales=scales)
    if (0x6030, 1) in od:
        yield Signal("speed", 0x6030, 1)


def _resolution(thousandths: int) -> float:
    return math.radians(thousandths * _ANGLE_DEG) if thousandths > 0 else math.radians(_ANGLE_DEG)


def inclinometer_signals(od: ObjectDictionary) -> Iterator[Signal]:
    """Yield `longitudinal` and `lateral` in rad of a CiA 410 device, with the 16-bit or the 32-bit objects."""
    scales = (Scale((0x6000, 0), _resolution, _number(od, 0x6000, 0, 10)),)
    for name, short, long in (("longitudinal", 0x6010, 0x6110), ("lateral", 0x6020, 0x6120)):
        index = next((each for each in (short, long) if _mapped(od, each)), None)
        index = index or next((each for each in (short, long) if (each, 0) in od), None)
        if index is not None:
            yield Signal(name, index, unit="rad", scales=scales)


_Table = tuple[tuple[str, int, int, float, str], ...]
_BATTERY: Final[_Table] = (
    ("battery_temperature", 0x6010, 0, 0.125, "degC"),
    ("battery_voltage", 0x6060, 0, 1 / 1024, "V"),
    ("battery_percentage", 0x6081, 0, 1.0, "%"),
    ("battery_status", 0x6000, 0, 1.0, ""),
    ("battery_charge_current", 0x6070, 0, 1 / 16, "A"),
    ("battery_capacity", 0x6020, 2, 1.0, "Ah"),
)
"""Name, object, unit per raw number and unit; the names are those of ros2_control's battery broadcaster."""


def battery_signals(od: ObjectDictionary) -> Iterator[Signal]:
    """Yield what a CiA 418 battery tells; no object of the profile holds the current of the pack."""
    for signal, _entry in _signals_of(od, _BATTERY):
        yield signal


_CHARGER: Final[_Table] = (
    ("charger_status", 0x6001, 0, 1.0, ""),
    ("charger_percentage", 0x6080, 0, 1.0, "%"),
    ("charge_current_requested", 0x6070, 0, 1 / 16, "A"),
    ("battery_status", 0x6000, 0, 1.0, ""),
    ("battery_temperature", 0x6010, 0, 0.125, "degC"),
    ("battery_voltage", 0x6060, 0, 1 / 1024, "V"),
    ("battery_percentage", 0x6081, 0, 1.0, "%"),
)
"""What a charger tells, and what it is told of the battery: the objects of CiA 418, seen from the other side."""


def charger_signals(od: ObjectDictionary) -> Iterator[Signal]:
    """Yield what a CiA 419 charger tells, and as outputs what it takes; a current is requested until it is 0."""
    for signal, entry in _signals_of(od, _CHARGER):
        yield dataclasses.replace(signal, output=entry.rpdo_mappable and entry.writable)


def _signals_of(od: ObjectDictionary, table: _Table) -> Iterator[tuple[Signal, Entry]]:
    """Yield the signals of a table that the device has, each with its object."""
    for name, index, subindex, factor, unit in table:
        if (entry := od.get(index, subindex)) is not None:
            yield Signal(name, index, subindex, factor=factor, unit=unit), entry
