"""Soft joint limiter: slows a joint down before its soft limits, those of a URDF's <safety_controller>.

The law of the file (joint_limits of ros2_control jazzy, JointSoftLimiter): towards a soft limit the velocity is at most
`k_position` times the distance to it, beyond it leads back at one degree per second (of a prismatic joint: as many
m/s), and an effort is at most `k_velocity` times what the velocity may still grow by. The hard limits (`joint_limiter`)
hold besides.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.hardware.joint_limiter import EFF, NEAR, POS, VEL, JointLimiter

if TYPE_CHECKING:
    from canopen_control.urdf.joint_element import HardLimits, SoftLimits

__all__ = ["SoftLimiter"]

_RETURN: Final = math.pi / 180.0
_NO_RANGE: Final = 1e-10


class SoftLimiter(JointLimiter):
    """Clamps the commands of one joint with hard and soft limits."""

    def __init__(self, limits: HardLimits, soft: SoftLimits) -> None:
        super().__init__(limits)
        self._soft = soft
        self._slowest = self._fastest = 0.0
        ends = math.isfinite(soft.lower) and math.isfinite(soft.upper)
        self._has_range = ends and soft.upper - soft.lower > _NO_RANGE
        slows = math.isfinite(soft.k_position) and abs(soft.k_position) > _NO_RANGE
        self._slows = self._has_range and slows and limits.has_ends and math.isfinite(limits.max_velocity)

    def _begin(self, actual: list[float], desired: list[float]) -> None:
        super()._begin(actual, desired)
        self._limit_speed(actual[POS])

    def _limit_speed(self, actual: float) -> None:
        """Work out which velocities the distances to the soft limits allow."""
        limits, soft, most = self.limits, self._soft, self.limits.max_velocity
        self._slowest, self._fastest = -most, most
        start = self._start(actual)
        if not (self._slows and math.isfinite(start)):
            return
        self._slowest = _clamp(-soft.k_position * (start - soft.lower), -most, most)
        self._fastest = _clamp(-soft.k_position * (start - soft.upper), -most, most)
        here = start if math.isnan(actual) else actual
        if here < limits.min_position - NEAR or here > limits.max_position + NEAR:
            self._slowest = self._fastest = 0.0
        elif here < soft.lower or here > soft.upper:
            self._slowest = math.copysign(_RETURN, self._slowest)
            self._fastest = math.copysign(_RETURN, self._fastest)

    def _start(self, actual: float) -> float:
        """Return the position command before, else where the joint is."""
        before = self.before[POS]
        return before if math.isfinite(before) else actual

    def _bound(self, at: int, wanted: float, actual: list[float], period: float) -> None:
        super()._bound(at, wanted, actual, period)
        if at == POS:
            self._narrow_position(actual, period)
        elif at == VEL:
            self._narrow_velocity(actual, period)
        elif at == EFF:
            self._narrow_effort(actual)

    def _narrow_position(self, actual: list[float], period: float) -> None:
        low, high = (self._soft.lower, self._soft.upper) if self._has_range else (-math.inf, math.inf)
        start = self._start(actual[POS])
        if math.isfinite(self.limits.max_velocity) and math.isfinite(start):
            low = _clamp(start + self._slowest * period, low, high)
            high = _clamp(start + self._fastest * period, low, high)
        hard_low, hard_high = max(low, self._low), min(high, self._high)
        self._low, self._high = (hard_low, hard_high) if hard_low <= hard_high else (low, high)

    def _narrow_velocity(self, actual: list[float], period: float) -> None:
        limits, speed = self.limits, actual[VEL]
        if math.isfinite(limits.max_velocity) and math.isfinite(limits.max_acceleration) and not math.isnan(speed):
            change = limits.max_acceleration * period
            self._slowest, self._fastest = max(speed - change, self._slowest), min(speed + change, self._fastest)
        self._low = self._slowest = max(self._slowest, self._low)
        self._high = self._fastest = min(self._fastest, self._high)

    def _narrow_effort(self, actual: list[float]) -> None:
        most, k_velocity, speed = self.limits.max_effort, self._soft.k_velocity, actual[VEL]
        if not (math.isfinite(most) and math.isfinite(k_velocity)) or math.isnan(speed):
            return
        self._low = max(_clamp(-k_velocity * (speed - self._slowest), -most, most), self._low)
        self._high = min(_clamp(-k_velocity * (speed - self._fastest), -most, most), self._high)


def _clamp(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
