"""PID controller with anti-windup, as in control_toolbox of ros2_control (jazzy).

The stored integral includes the integral gain, so that a change of the gain does not change the output at once. All
anti-windup methods except `legacy` use the integral of the previous step.
"""

from __future__ import annotations

import enum
import math
import sys
from dataclasses import dataclass
from typing import Final

_EPSILON: Final = sys.float_info.epsilon


class AntiWindup(enum.Enum):
    """Anti-windup methods, which limit the integral while the output is saturated."""

    BACK_CALCULATION = "back_calculation"
    CONDITIONAL_INTEGRATION = "conditional_integration"
    LEGACY = "legacy"
    NONE = "none"


@dataclass(frozen=True)
class Gains:
    """Gains of a PID loop, with the limits of the integral and the output, and the anti-windup method.

    `i_min` and `i_max` limit the integral, `u_min` and `u_max` the output. `tracking_time` is the time constant of the
    back calculation in s; 0 derives it from the gains. An error within `deadband` is not integrated. `clamp_integral`
    selects the ROS 1 behaviour of `legacy`: the integral is clamped before it is used. Raises ValueError for limits
    that exclude each other, and for an invalid tracking time.
    """

    p: float = 0.0
    i: float = 0.0
    d: float = 0.0
    i_max: float = math.inf
    i_min: float = -math.inf
    u_max: float = math.inf
    u_min: float = -math.inf
    anti_windup: AntiWindup = AntiWindup.NONE
    tracking_time: float = 0.0
    deadband: float = _EPSILON
    clamp_integral: bool = False

    def __post_init__(self) -> None:
        if not self.u_min < self.u_max:  # true for nan
            raise ValueError(f"the output cannot be above {self.u_min} and below {self.u_max}; give u_min < u_max")
        if self.i_min > 0.0 or self.i_max < 0.0:
            raise ValueError(f"the limits {self.i_min} to {self.i_max} of the integral must include 0")
        back = self.anti_windup is AntiWindup.BACK_CALCULATION
        if back and not 0.0 <= self.tracking_time < math.inf:
            raise ValueError(f"the tracking time constant is {self.tracking_time} s; give 0 or more")

    @property
    def tracking_time_used(self) -> float:
        """Time constant of the back calculation in s, derived from the gains if `tracking_time` is 0."""
        if self.anti_windup is not AntiWindup.BACK_CALCULATION or abs(self.tracking_time) > _EPSILON:
            return self.tracking_time
        if self.i and self.d:
            return math.sqrt(self.d / self.i) if self.d / self.i > 0.0 else math.nan
        return self.p / self.i if self.i else self.tracking_time


class Pid:
    """PID loop; `compute` executes one step, and `integral` includes the integral gain."""

    def __init__(self, gains: Gains) -> None:
        self.command = self.error = self.error_rate = self.integral = 0.0
        self._last_error = 0.0
        self.set_gains(gains)

    def set_gains(self, gains: Gains) -> None:
        """Replace the gains; the integral is unchanged."""
        self.gains = gains
        self._p, self._i, self._d = gains.p, gains.i, gains.d
        self._i_min, self._i_max, self._u_min, self._u_max = gains.i_min, gains.i_max, gains.u_min, gains.u_max
        self._deadband, self._tracking = gains.deadband, gains.tracking_time_used
        self._limited = math.isfinite(gains.u_min) or math.isfinite(gains.u_max)
        self._anti_windup, self._clamp_integral = gains.anti_windup, gains.clamp_integral

    def reset(self, keep_integral: bool = False) -> None:
        """Reset the state of the loop, including the integral unless `keep_integral` is True."""
        self.command = self.error = self.error_rate = self._last_error = 0.0
        if not keep_integral:
            self.integral = 0.0

    def compute(self, error: float, dt: float) -> float:
        """Return the command for an error, `dt` s after the previous step; the rate follows from the previous error.

        If `dt` is 0, nothing changes; a negative `dt` raises ValueError; an error that is not finite results in nan.
        """
        if self._is_zero_step(dt):
            return self.command
        if not math.isfinite(error):
            self.command = math.nan
            return self.command
        rate = (error - self._last_error) / dt
        self._last_error = error
        return self._step(error, rate, dt)

    def compute_with_rate(self, error: float, rate: float, dt: float) -> float:
        """Return the command for an error and its rate of change; for `dt` and invalid values see `compute`."""
        if self._is_zero_step(dt):
            return self.command
        return self._step(error, rate, dt)

    def _is_zero_step(self, dt: float) -> bool:
        if dt < 0.0 and abs(dt) > _EPSILON:
            raise ValueError(f"a PID step of {dt} s is negative")
        return abs(dt) <= _EPSILON

    def _step(self, error: float, rate: float, dt: float) -> float:
        self.error, self.error_rate = error, rate
        if not (math.isfinite(error) and math.isfinite(rate)):
            self.command = math.nan
            return self.command
        resting = abs(error) <= self._deadband
        legacy = self._anti_windup is AntiWindup.LEGACY
        if legacy and not resting:
            self.integral += self._i * dt * error
            if self._clamp_integral:
                self.integral = self._within(self.integral)
        integral = self._within(self.integral) if legacy and not self._clamp_integral else self.integral
        unlimited = self._p * error + integral + self._d * rate
        command = min(max(unlimited, self._u_min), self._u_max) if self._limited else unlimited
        if not (resting or legacy):
            self._integrate(error, dt, unlimited, command)
        self.integral = self._within(self.integral)
        self.command = command
        return command

    def _integrate(self, error: float, dt: float, unlimited: float, command: float) -> None:
        """Add the error to the integral, limited by the anti-windup method."""
        if self._anti_windup is AntiWindup.BACK_CALCULATION:
            if self._i:
                self.integral += dt * (self._i * error + _quotient(command - unlimited, self._tracking))
        elif self._anti_windup is AntiWindup.CONDITIONAL_INTEGRATION:
            if abs(command - unlimited) <= _EPSILON or error * unlimited <= 0.0:
                self.integral += dt * self._i * error
        else:
            self.integral += dt * self._i * error

    def _within(self, integral: float) -> float:
        return min(max(integral, self._i_min), self._i_max)


def _quotient(a: float, b: float) -> float:
    """Return a / b as in IEEE 754, since a time constant of 0 must not raise an exception in the cycle."""
    if b:
        return a / b
    return math.copysign(math.inf, a) * math.copysign(1.0, b) if a else math.nan
