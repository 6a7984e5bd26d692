"""Joint limiter: clamps the commands of one joint to its limits of position, velocity, effort, acceleration and jerk.

The law of the file (joint_limits of ros2_control jazzy, JointSaturationLimiter): the quantities are judged in their
order; a position moves by what the velocity, and that by what the acceleration allows since the command before; a
velocity does not lead past the end of the joint within the cycle; an effort does not push beyond the end, nor what is
too fast further. What is nan is not given. All in SI units (rad or m).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from mypy_extensions import mypyc_attr

from canopen_control.errors import ControlError
from canopen_control.urdf.declared_interface import ACCELERATION, EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from canopen_control.urdf.joint_element import HardLimits

__all__ = ["ACC", "EFF", "JERK", "NOTHING", "POS", "QUANTITIES", "VEL", "JointLimiter"]

POS: Final = 0
VEL: Final = 1
EFF: Final = 2
ACC: Final = 3
JERK: Final = 4
QUANTITIES: Final = (POSITION, VELOCITY, EFFORT, ACCELERATION, "jerk")
"""The quantities of a joint in the order in which they are judged; POS to JERK are their places."""
NOTHING: Final = (math.nan,) * len(QUANTITIES)

_FAR_OUT: Final = 0.0087  # rad or m: a joint that is this far outside of its range is an error
NEAR: Final = 0.002  # rad or m: so far outside it may still move back


@mypyc_attr(allow_interpreted_subclasses=True)
class JointLimiter:
    """Clamps the commands of one joint; `before` are the last ones, nan where none was given since `reset`."""

    def __init__(self, limits: HardLimits) -> None:
        self.limits = limits
        self.before: list[float] = list(NOTHING)
        self._low = self._high = 0.0

    def reset(self) -> None:
        """Forget the commands before: the next one is measured from where the joint is."""
        self.before[:] = NOTHING

    def enforce(self, actual: list[float], desired: list[float], period: float) -> bool:
        """Clamp what is desired, by quantity, and return whether anything was; `period` in s, none at or below 0.

        Raises ControlError where a position is wanted of a joint that is far outside of its range.
        """
        if period <= 0.0:
            return False
        self._begin(actual, desired)
        limited = False
        for at in range(len(desired)):
            wanted = desired[at]
            if math.isnan(wanted):
                continue
            self._bound(at, wanted, actual, period)
            if wanted < self._low or wanted > self._high:
                limited = True
                desired[at] = wanted = min(max(wanted, self._low), self._high)
            self.before[at] = wanted
        return limited

    def _begin(self, actual: list[float], desired: list[float]) -> None:
        """Where no command is known yet, measure from where the joint is, or from what is wanted first."""
        before = self.before
        for known in before:
            if known == known:  # is not nan
                return
        for at in range(len(desired)):
            if not math.isnan(desired[at]):
                before[at] = desired[at] if math.isnan(actual[at]) else actual[at]

    def _bound(self, at: int, wanted: float, actual: list[float], period: float) -> None:
        """Set the range of a quantity; ends that are crossed are swapped."""
        if at == POS:
            self._bound_position(actual, period)
        elif at == VEL:
            self._bound_velocity(wanted, actual, period)
        elif at == EFF:
            self._bound_effort(actual)
        else:
            most = self.limits.max_jerk if at == JERK else self._most_acceleration(wanted, actual[VEL])
            self._low, self._high = -most, most
        if self._low > self._high:
            self._low, self._high = self._high, self._low

    def _bound_position(self, actual: list[float], period: float) -> None:
        limits = self.limits
        low, high, here = limits.min_position, limits.max_position, actual[POS]
        if here < low - _FAR_OUT or here > high + _FAR_OUT:
            raise ControlError(f"it is at {here:g}, outside of its range from {low:g} to {high:g}; check its limits")
        start = here if math.isnan(self.before[POS]) else self.before[POS]
        if math.isfinite(limits.max_velocity) and math.isfinite(start):
            fastest = limits.max_velocity
            if math.isfinite(limits.max_acceleration):
                speed = 0.0 if math.isnan(actual[VEL]) else abs(actual[VEL])
                fastest = min(fastest, speed + limits.max_acceleration * period)
            step = fastest * period
            low = max(min(start - step, high), low)
            high = min(max(start + step, low), high)
        self._low, self._high = low, high

    def _bound_velocity(self, wanted: float, actual: list[float], period: float) -> None:
        limits, here, before = self.limits, actual[POS], self.before[VEL]
        low, high = -limits.max_velocity, limits.max_velocity
        if limits.has_ends and not math.isnan(here):
            low, high = (
                max((limits.min_position - here) / period, low),
                min((limits.max_position - here) / period, high),
            )
            if self._may_not_move(wanted, here):
                low = high = 0.0
        if math.isfinite(limits.max_acceleration) and not math.isnan(before):
            change = limits.max_acceleration * period
            low, high = max(before - change, low), min(before + change, high)
        self._low, self._high = low, high

    def _may_not_move(self, wanted: float, here: float) -> bool:
        """Whether it is outside of its range, and is far out or would go on that way."""
        low, high = self.limits.min_position, self.limits.max_position
        if low <= here <= high:
            return False
        above = low < here < high + NEAR and wanted >= 0.0
        below = low - NEAR < here < high and wanted <= 0.0
        return above or below or here > high + NEAR or here < low - NEAR

    def _bound_effort(self, actual: list[float]) -> None:
        limits, here, speed = self.limits, actual[POS], actual[VEL]
        low, high = -limits.max_effort, limits.max_effort
        if here <= limits.min_position and speed <= 0.0:  # False for nan
            low = 0.0
        elif here >= limits.max_position and speed >= 0.0:
            high = 0.0
        if speed < -limits.max_velocity:
            low = 0.0
        elif speed > limits.max_velocity:
            high = 0.0
        self._low, self._high = low, high

    def _most_acceleration(self, wanted: float, speed: float) -> float:
        slows_down = wanted * speed < 0.0
        if slows_down and math.isfinite(self.limits.max_deceleration):
            return self.limits.max_deceleration
        return self.limits.max_acceleration
