"""Limiter of velocity, acceleration and jerk of one number (control_toolbox::RateLimiter).

Limit = jerk, then acceleration, then velocity, each against the two previous limited values. nan
switches off or is derived: without max_velocity no velocity limit; without max_acceleration no acceleration limit at
all; without max_jerk no jerk limit; min_velocity is -max_velocity, max_acceleration_reverse -max_acceleration,
max_deceleration the same as max_acceleration_reverse, max_deceleration_reverse the same as max_acceleration, min_jerk
-max_jerk. Jerk limits only a step that grows, be it of speeding up or of braking.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

NAN: Final = math.nan


@dataclass(frozen=True)
class VelocityLimits:
    """Bounds in SI units, nan for none; min_velocity, decelerations and reverse limits are signed as in ROS.

    `max_acceleration` and `max_deceleration_reverse` are >= 0; `max_deceleration` (moving forward) and
    `max_acceleration_reverse` (speeding up backward) are <= 0.
    """

    min_velocity: float = NAN
    max_velocity: float = NAN
    max_acceleration_reverse: float = NAN
    max_acceleration: float = NAN
    max_deceleration: float = NAN
    max_deceleration_reverse: float = NAN
    min_jerk: float = NAN
    max_jerk: float = NAN


def _or(value: float, default: float) -> float:
    return default if math.isnan(value) else value


class RateLimiter:
    """Limiter of one number; ValueError if a minimum is above its maximum."""

    def __init__(self, limits: VelocityLimits) -> None:
        self._min_v, self._max_v = _or(limits.min_velocity, -limits.max_velocity), limits.max_velocity
        self._acc = limits.max_acceleration
        self._acc_reverse = _or(limits.max_acceleration_reverse, -self._acc)
        self._dec = _or(limits.max_deceleration, self._acc_reverse)
        self._dec_reverse = _or(limits.max_deceleration_reverse, self._acc)
        self._min_j, self._max_j = _or(limits.min_jerk, -limits.max_jerk), limits.max_jerk
        self._has_v, self._has_a, self._has_j = (
            not math.isnan(limit) for limit in (self._max_v, self._acc, self._max_j)
        )
        self._check()

    def _check(self) -> None:
        if self._has_v and self._min_v > self._max_v:
            raise ValueError("Invalid value limits")
        if self._has_a and (self._acc_reverse > self._acc or self._dec > self._dec_reverse):
            raise ValueError("Invalid first derivative limits")
        if self._has_j and self._min_j > self._max_j:
            raise ValueError("Invalid second derivative limits")

    def limit(self, v: float, v0: float, v1: float, dt: float) -> float:
        """Return `v` limited by the previous two limited values, v0 (last) and v1; `dt` in s."""
        if self._has_j:
            v = self.limit_jerk(v, v0, v1, dt)
        if self._has_a:
            v = self.limit_acceleration(v, v0, dt)
        return self.limit_velocity(v) if self._has_v else v

    def limit_velocity(self, v: float) -> float:
        """Clamp the value itself."""
        if not self._has_v:
            return v
        return self._min_v if v < self._min_v else self._max_v if v > self._max_v else v

    def limit_acceleration(self, v: float, v0: float, dt: float) -> float:
        """Clamp the step from v0 by the bounds for acceleration and deceleration."""
        if not self._has_a:
            return v
        step = v - v0
        low = (self._dec if v0 > 0.0 else self._acc_reverse) * dt
        high = (self._dec_reverse if v0 < 0.0 else self._acc) * dt
        return v0 + (low if step < low else high if step > high else step)

    def limit_jerk(self, v: float, v0: float, v1: float, dt: float) -> float:
        """Clamp the change of the step, only while the step grows in its direction."""
        if not self._has_j:
            return v
        dv, dv0 = v - v0, v0 - v1
        if (dv - dv0) * dv <= 0.0:
            return v
        low, high = self._min_j * dt * dt, self._max_j * dt * dt
        return v0 + dv0 + min(max(dv - dv0, low), high)
