"""The units of the objects of CiA 301 and CiA 402-2, as people write them; "" for what has none or is not known.

Positions and velocities of a drive are in the user's units, which are its counts unless 0x60A8 and 0x60A9 say
otherwise; a velocity in revolutions per minute is told by 0x60A9. A stepper's counts are its microsteps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.units import rpm_of_unit

if TYPE_CHECKING:
    from canopen_control.od.model import ObjectDictionary

__all__ = ["unit_of"]

POSITION: Final = "counts"
VELOCITY: Final = "counts/s"
ACCELERATION: Final = "counts/s^2"
_BY_UNIT: Final = {
    POSITION: (
        *(objects.POSITION_DEMAND, objects.POSITION_ACTUAL_INTERNAL, objects.POSITION_ACTUAL, objects.TARGET_POSITION),
        *(objects.FOLLOWING_ERROR_WINDOW, objects.POSITION_WINDOW, objects.HOME_OFFSET, objects.POSITION_OFFSET),
        *(objects.FOLLOWING_ERROR_ACTUAL, objects.POSITION_DEMAND_INTERNAL, objects.TOUCH_PROBE_1_POSITIVE),
        *(objects.TOUCH_PROBE_1_NEGATIVE, objects.TOUCH_PROBE_2_POSITIVE, objects.TOUCH_PROBE_2_NEGATIVE),
        *(objects.POSITION_RANGE_LIMIT, objects.SOFTWARE_POSITION_LIMIT),
    ),
    VELOCITY: (
        *(objects.VELOCITY_DEMAND, objects.VELOCITY_ACTUAL, objects.VELOCITY_WINDOW, objects.VELOCITY_THRESHOLD),
        *(objects.MAX_PROFILE_VELOCITY, objects.PROFILE_VELOCITY, objects.END_VELOCITY, objects.TARGET_VELOCITY),
        *(objects.VELOCITY_OFFSET, objects.MAX_SLIPPAGE, objects.HOMING_SPEEDS),
    ),
    ACCELERATION: (
        *(objects.PROFILE_ACCELERATION, objects.PROFILE_DECELERATION, objects.QUICK_STOP_DECELERATION),
        *(objects.MAX_ACCELERATION, objects.MAX_DECELERATION, objects.HOMING_ACCELERATION),
    ),
    "rpm": (
        *(objects.VL_TARGET_VELOCITY, objects.VL_VELOCITY_DEMAND, objects.VL_VELOCITY_ACTUAL),
        *(objects.VL_MIN_MAX_AMOUNT, objects.MAX_MOTOR_SPEED),
    ),
    "1/1000 of the rated torque": (
        *(objects.TARGET_TORQUE, objects.MAX_TORQUE, objects.TORQUE_DEMAND, objects.TORQUE_ACTUAL),
        *(objects.POSITIVE_TORQUE_LIMIT, objects.NEGATIVE_TORQUE_LIMIT, objects.TORQUE_OFFSET),
    ),
    "1/1000 of the rated torque a second": (objects.TORQUE_SLOPE,),
    "1/1000 of the rated current": (objects.MAX_CURRENT, objects.CURRENT_ACTUAL),
    "mA": (objects.MOTOR_RATED_CURRENT,),
    "mNm": (objects.MOTOR_RATED_TORQUE,),
    "mV": (objects.DC_LINK_VOLTAGE,),
    "ms": (
        *(0x100C, 0x1017),
        *(objects.FOLLOWING_ERROR_TIMEOUT, objects.POSITION_WINDOW_TIME, objects.VELOCITY_WINDOW_TIME),
        *(objects.VELOCITY_THRESHOLD_TIME,),
    ),
    "us": (0x1006, 0x1007),
}
_UNITS: Final = {index: unit for unit, indices in _BY_UNIT.items() for index in indices}
_IN_REVOLUTIONS: Final = {VELOCITY: "rpm"}


def unit_of(od: ObjectDictionary, index: int, subindex: int) -> str:
    """Return the unit of an object by the profile; that of a velocity by 0x60A9 of the same axis."""
    base, axis = objects.axis_of(index)
    unit = _UNITS.get(base, "")
    if subindex == 0 and (index, 1) in od:
        return ""  # how many there are
    if unit in _IN_REVOLUTIONS:
        entry = od.get(objects.axis_index(objects.SI_UNIT_VELOCITY, axis))
        value = None if entry is None else entry.value
        rpm = rpm_of_unit(value) if isinstance(value, int) else 0.0
        if rpm:
            return "rpm" if rpm == 1.0 else f"{rpm:g} rpm"
    return unit
