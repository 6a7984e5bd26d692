"""Overload protection (I2t) of a motor: how much more than its rated current it had, and for how long.

The heat above that of the rated torque grows with the square of the torque and is given off again below it. What a
motor takes is twice its rated torque for two seconds, or three times for three quarters of one; then its drive reports
continuous over-current (0x2310) and faults. Torques are in per mille of the rated one.
"""

from __future__ import annotations

from typing import Final

from canopen_control.cia402 import objects as o

__all__ = ["OVERLOAD", "TORQUE_LIMITS", "OverloadGuard"]

OVERLOAD: Final = 0x2310
TORQUE_LIMITS: Final = (o.MAX_TORQUE, o.MAX_CURRENT)
"""Objects that bound the torque of all loops: current and torque of a motor are proportional."""

_HEAT_S: Final = 6.0  # s that a motor takes the heat of its rated torque once more
_GAP_S: Final = 0.1  # between two looks, longer than any while it has power


class OverloadGuard:
    """The heat of one motor, looked at again and again; `heat` is what is above that of the rated torque, in s."""

    def __init__(self) -> None:
        self.heat = 0.0
        self._looked: int | None = None

    def exceeded(self, torque: float, now: int) -> bool:
        """Whether it is too hot at `now`, in ns, having had `torque` since the last look; after a pause it had none."""
        seconds = 0.0 if self._looked is None else (now - self._looked) * 1e-9
        self._looked = now
        ratio = 0.0 if seconds > _GAP_S else torque / 1000.0
        self.heat = max(0.0, self.heat + (ratio * ratio - 1.0) * seconds)
        return self.heat > _HEAT_S
