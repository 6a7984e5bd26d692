"""Command limiters with the behaviour of ros2_control and control_toolbox.

| upstream | class | limits | compared with |
|---|---|---|---|
| control_toolbox::RateLimiter | `RateLimiter` | numbers and their two derivatives | the last two commands |
| joint_limits JointSaturationLimiter | `JointLimiter` | one joint's commands, by quantity | the previous command |
| joint_limits JointSoftLimiter | `SoftLimiter` | the same, slower before soft limits | the same, and the joint |
| joint_limits JointTrajectoryPointSaturationLimiter | `PointLimiter` | points of several joints | the previous point |

The algorithms differ from each other, as they do upstream. Each limiter has `enforce`, which clamps `desired` in place,
compared with `actual` if there was no previous command, and returns whether a value was changed. `reset` discards
previous commands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from mypy_extensions import mypyc_attr

from canopen_control.errors import ControlError
from canopen_control.urdf.joint_element import ACCELERATION, EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.trajectory.point import Point
    from canopen_control.urdf.joint_element import HardLimits, SoftLimits


NAN: Final = math.nan
SLOW_STOP: Final = "slow_stop"
IMMOBILE: Final = "immobile"
"""Kind of the event for a limit of 0, which permits no motion."""
LONGEST_STOP_S: Final = 10.0  # maximum duration of a controlled stop, as in `hardware.axis_statechart`


# Rate limiter (control_toolbox::RateLimiter): limits jerk, then acceleration, then velocity, compared with the two
# previous limited values. A limit of nan is off, or derived: without max_velocity there is no velocity limit; without
# max_acceleration no acceleration limit at all; without max_jerk no jerk limit. The default of min_velocity is
# -max_velocity, of max_acceleration_reverse -max_acceleration, of max_deceleration max_acceleration_reverse, of
# max_deceleration_reverse max_acceleration, of min_jerk -max_jerk. The jerk limit applies only while the step from one
# value to the next grows in its direction, in speeding up as in braking.


@dataclass(frozen=True)
class VelocityLimits:
    """Velocity, acceleration and jerk limits of one number in SI units; nan means unlimited.

    Lower bounds have their sign, as in ROS: `max_acceleration` and `max_deceleration_reverse` are >= 0;
    `max_deceleration` (while moving forward) and `max_acceleration_reverse` (while speeding up backward) are <= 0.
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


def slow_stop(name: str, seconds: float, key: str) -> str | None:
    """Return a warning about a deceleration limit with which a stop takes too long, or None up to `LONGEST_STOP_S`."""
    if seconds <= LONGEST_STOP_S or math.isinf(seconds):  # an infinite velocity limit is none
        return None
    return f"{name} needs {round(seconds):.6g} s to stop from its velocity limit; raise the magnitude of {key}"


def immobile_text(key: str, effect: str, sign: str = "above") -> str:
    """Return the text of the event IMMOBILE about the parameter `key`, whose value is 0."""
    return f"{key} is 0, so {effect}; give a value {sign} 0, or remove it"


class RateLaw:
    """Limits of one number for `RateLimiter`, with derived defaults; `free` means that nothing is limited.

    Raises ValueError if a minimum is above its maximum.
    """

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
        self.free = not (self._has_v or self._has_a or self._has_j)
        self._check()

    def _check(self) -> None:
        if self._has_v and self._min_v > self._max_v:
            raise ValueError("Invalid value limits")
        if self._has_a and (self._acc_reverse > self._acc or self._dec > self._dec_reverse):
            raise ValueError("Invalid first derivative limits")
        if self._has_j and self._min_j > self._max_j:
            raise ValueError("Invalid second derivative limits")

    @property
    def brakes(self) -> bool:
        """Whether a motion can end: a deceleration limit of 0 keeps the speed even after the commands have ended."""
        return not self._has_a or self._dec < 0.0 < self._dec_reverse

    @property
    def blocked(self) -> tuple[str, str]:
        """Names of limits of 0 that permit no motion from standstill forward, and backward; "" without one."""
        forward, backward = (
            (
                ("max_velocity", self._has_v, self._max_v),
                ("max_acceleration", self._has_a, self._acc),
                ("max_jerk", self._has_j, self._max_j),
            ),
            (
                ("min_velocity", self._has_v, self._min_v),
                ("max_acceleration_reverse", self._has_a, self._acc_reverse),
                ("min_jerk", self._has_j, self._min_j),
            ),
        )
        first, second = (
            next((name for name, given, limit in limits if given and limit == 0.0), "")
            for limits in (forward, backward)
        )
        return first, second

    @property
    def immobile(self) -> str:
        """Name of a limit that permits no motion from standstill in either direction, or ""."""
        forward, backward = self.blocked
        return forward if backward else ""

    @property
    def brake_s(self) -> float:
        """Time in s to stop from the velocity limit, or else from 1 m/s or rad/s; 0 without a deceleration limit."""
        if not (self._has_a and self.brakes):
            return 0.0
        slowest = min(-self._dec, self._dec_reverse)
        return max(self._max_v, -self._min_v) / slowest if self._has_v else 1.0 / slowest

    @property
    def longest_brake(self) -> str:
        """Name of the deceleration limit that determines `brake_s`."""
        return "max_deceleration" if -self._dec <= self._dec_reverse else "max_deceleration_reverse"

    def limit(self, v: float, v0: float, v1: float, dt: float) -> float:
        """Apply all limits to `v`; `v0` is the last limited value, `v1` the one before; `dt` is in s."""
        if self._has_j:
            v = self.limit_jerk(v, v0, v1, dt)
        if self._has_a:
            v = self.limit_acceleration(v, v0, dt)
        return self.limit_velocity(v) if self._has_v else v

    def limit_velocity(self, v: float) -> float:
        """Return `v` clamped to the velocity limits."""
        if not self._has_v:
            return v
        return self._min_v if v < self._min_v else self._max_v if v > self._max_v else v

    def limit_acceleration(self, v: float, v0: float, dt: float) -> float:
        """Return `v` with its step from the last value `v0` clamped to the acceleration limits; `dt` is in s."""
        if not self._has_a:
            return v
        step = v - v0
        low = (self._dec if v0 > 0.0 else self._acc_reverse) * dt
        high = (self._dec_reverse if v0 < 0.0 else self._acc) * dt
        return v0 + (low if step < low else high if step > high else step)

    def limit_jerk(self, v: float, v0: float, v1: float, dt: float) -> float:
        """Return `v`; if its step from `v0` grows, the growth is clamped to the jerk limits. `dt` is in s."""
        if not self._has_j:
            return v
        dv, dv0 = v - v0, v0 - v1
        if (dv - dv0) * dv <= 0.0:
            return v
        low, high = self._min_j * dt * dt, self._max_j * dt * dt
        return v0 + dv0 + min(max(dv - dv0, low), high)


_UNLIMITED: Final = RateLaw(VelocityLimits())


class RateLimiter:
    """Limiter of several numbers, each with its `RateLaw` and its last two commands, which `step` records.

    `rest` are the initial values, nan for the actual value. A nan is no command: the number stays nan, and its history
    is unchanged. `last` are the commands of the last `step`.
    """

    def __init__(self, rest: Sequence[float]) -> None:
        self._rest = list(rest)
        self.laws: list[RateLaw] = [_UNLIMITED] * len(self._rest)
        self.last, self._earlier = list(rest), list(rest)

    def enforce(self, actual: list[float], desired: list[float], period: float) -> bool:
        """Clamp the numbers and return whether any was changed; the history is unchanged until `step`."""
        limited, latest, before = False, self.last, self._earlier
        for at, law in enumerate(self.laws):
            target, last, earlier = desired[at], latest[at], before[at]
            if target != target or law.free:  # nan
                continue
            if last != last:
                last = actual[at]
            if earlier != earlier:
                earlier = last
            desired[at] = value = law.limit(target, last, earlier, period)
            if value != target:
                limited = True
        return limited

    def step(self, actual: list[float], commanded: list[float]) -> None:
        """Record the commands of this cycle for the limits of the next cycles."""
        self._earlier[:] = self.last
        total = sum(commanded)
        if total == total:  # False for nan
            self.last[:] = commanded
            return
        for at in range(len(commanded)):
            value = commanded[at]
            if value == value:
                self.last[at] = value
            elif self.last[at] != self.last[at]:
                self.last[at] = actual[at]

    def reset(self) -> None:
        self.last[:] = self._earlier[:] = self._rest


# Joint limiter: clamps the commands of one joint to its limits of position, velocity, effort, acceleration and jerk.
#
# Rules (joint_limits of ros2_control jazzy, JointSaturationLimiter): the quantities are limited in the order of
# `QUANTITIES`. Since the previous command, a position changes by at most what the velocity limit allows, and a velocity
# by at most what the acceleration limit allows. A velocity does not lead beyond the end of the range within the cycle.
# An effort neither pushes the joint beyond the end of the range nor accelerates a joint that is already too fast. A nan
# is no command. All values are in SI units (rad or m).


POS: Final = 0
VEL: Final = 1
EFF: Final = 2
ACC: Final = 3
JERK: Final = 4
QUANTITIES: Final = (POSITION, VELOCITY, EFFORT, ACCELERATION, "jerk")
"""Quantities of a joint, in the order of limiting; POS to JERK are their indices."""
NOTHING: Final = (math.nan,) * len(QUANTITIES)

_FAR_OUT: Final = 0.0087  # rad or m outside the range from which a position command is an error
NEAR: Final = 0.002  # rad or m outside the range within which a velocity may still move the joint back


@mypyc_attr(allow_interpreted_subclasses=True)
class JointLimiter:
    """Limiter of the commands of one joint; `before` holds the previous commands, nan after `reset`."""

    def __init__(self, limits: HardLimits) -> None:
        self.limits = limits
        self.before: list[float] = list(NOTHING)
        self._low = self._high = 0.0

    def reset(self) -> None:
        self.before[:] = NOTHING

    def enforce(self, actual: list[float], desired: list[float], period: float) -> bool:
        """Clamp the desired values, by quantity, and return whether any was changed; `period` is in s.

        Raise ControlError for a position command to a joint that is far outside its range.
        """
        if period <= 0.0:
            return False
        self._begin(actual, desired)
        limited = False
        for at in range(len(desired)):
            target = desired[at]
            if math.isnan(target):
                continue
            self._bound(at, target, actual, period)
            if target < self._low or target > self._high:
                limited = True
                desired[at] = target = min(max(target, self._low), self._high)
            self.before[at] = target
        return limited

    def _begin(self, actual: list[float], desired: list[float]) -> None:
        """Without previous commands, start from the measured values, or where unknown from the desired values."""
        before = self.before
        for limited in before:
            if limited == limited:  # is not nan
                return
        for at in range(len(desired)):
            if not math.isnan(desired[at]):
                before[at] = desired[at] if math.isnan(actual[at]) else actual[at]

    def _bound(self, at: int, target: float, actual: list[float], period: float) -> None:
        """Set `_low` and `_high` to the allowed range of a quantity; swap the two if they are in the wrong order."""
        if at == POS:
            self._bound_position(actual, period)
        elif at == VEL:
            self._bound_velocity(target, actual, period)
        elif at == EFF:
            self._bound_effort(actual)
        else:
            most = self.limits.max_jerk if at == JERK else self._max_acceleration(target, actual[VEL])
            self._low, self._high = -most, most
        if self._low > self._high:
            self._low, self._high = self._high, self._low

    def _bound_position(self, actual: list[float], period: float) -> None:
        limits = self.limits
        low, high, here = limits.min_position, limits.max_position, actual[POS]
        if here < low - _FAR_OUT or here > high + _FAR_OUT:
            raise ControlError(
                f"the joint is at {here:g}, outside its range from {low:g} to {high:g}; check the limits"
            )
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

    def _bound_velocity(self, target: float, actual: list[float], period: float) -> None:
        limits, here, before = self.limits, actual[POS], self.before[VEL]
        low, high = -limits.max_velocity, limits.max_velocity
        if limits.has_ends and not math.isnan(here):
            low, high = (
                max((limits.min_position - here) / period, low),
                min((limits.max_position - here) / period, high),
            )
            if self._may_not_move(target, here):
                low = high = 0.0
        if math.isfinite(limits.max_acceleration) and not math.isnan(before):
            change = limits.max_acceleration * period
            low, high = max(before - change, low), min(before + change, high)
        self._low, self._high = low, high

    def _may_not_move(self, target: float, here: float) -> bool:
        """Whether the joint is far outside its range, or slightly outside and commanded farther out."""
        low, high = self.limits.min_position, self.limits.max_position
        if low <= here <= high:
            return False
        above = low < here < high + NEAR and target >= 0.0
        below = low - NEAR < here < high and target <= 0.0
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

    def _max_acceleration(self, target: float, speed: float) -> float:
        slows_down = target * speed < 0.0
        if slows_down and math.isfinite(self.limits.max_deceleration):
            return self.limits.max_deceleration
        return self.limits.max_acceleration


# Soft joint limiter: slows a joint down before its soft limits, which are those of a URDF <safety_controller>.
#
# Rules (joint_limits of ros2_control jazzy, JointSoftLimiter): the velocity towards a soft limit is at most
# `k_position` times the distance to the limit. Beyond the limit the joint returns at one degree per second (pi/180 m/s
# for a prismatic joint). An effort is at most `k_velocity` times the difference between the permitted and the actual
# velocity. The hard limits also apply.


_RETURN: Final = math.pi / 180.0
_NO_RANGE: Final = 1e-10


class SoftLimiter(JointLimiter):
    """Limiter of one joint's commands that applies soft limits in addition to the hard limits."""

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
        """Compute the velocities permitted at the joint's distances from its soft limits."""
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
        before = self.before[POS]
        return before if math.isfinite(before) else actual

    def _bound(self, at: int, target: float, actual: list[float], period: float) -> None:
        super()._bound(at, target, actual, period)
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


# Point limiter (joint_limits, JointTrajectoryPointSaturationLimiter): positions, then velocities, then accelerations
# are clamped, and the other quantities are recomputed from the clamped one. If a joint could no longer stop before the
# end of its range, all joints brake together, so that the direction of their path is kept.


_ZERO: Final = 1e-10  # values up to this magnitude count as not given


class PointLimiter:
    """Limiter that keeps trajectory points within joint `limits`; `joint` is the index of the first limited joint."""

    def __init__(self, limits: Sequence[HardLimits]) -> None:
        self.limits = list(limits)
        count = len(self.limits)
        self._positions, self._velocities, self._accelerations = [0.0] * count, [0.0] * count, [0.0] * count
        self._still = [0.0] * count
        self.joint = 0
        self._limited = self._brakes = False
        self._places = self._speeds = False  # whether the desired point has positions and velocities

    def enforce(self, actual: Point, desired: Point, period: float) -> bool:
        """Clamp the desired point in place and return whether a value was changed; `period` is in s.

        The point is unchanged unless all joints have actual positions, and all have desired positions or velocities.
        """
        count = len(self.limits)
        self._places, self._speeds = len(desired.positions) == count, len(desired.velocities) == count
        complete = len(actual.positions) == count and (self._places or self._speeds)
        if period <= 0.0 or not complete:
            return False
        speeds = actual.velocities if len(actual.velocities) == count else self._still
        grows = len(desired.accelerations) == count
        self._positions[:] = desired.positions if self._places else self._still
        self._velocities[:] = desired.velocities if self._speeds else self._still
        self._accelerations[:] = desired.accelerations if grows else self._still
        self._limited = self._brakes = False
        for joint in range(count):
            self._clamp(joint, actual.positions[joint], speeds[joint], period)
        if self._brakes:
            for joint in range(count):
                self._brake(joint, actual.positions[joint], speeds[joint], period)
        if self._places:
            desired.positions[:] = self._positions
        if self._speeds:
            desired.velocities[:] = self._velocities
        if grows:
            desired.accelerations[:] = self._accelerations
        return self._limited

    def _note(self, joint: int) -> None:
        if not self._limited:
            self.joint, self._limited = joint, True

    def _clamp(self, joint: int, here: float, speed: float, period: float) -> None:
        limits = self.limits[joint]
        if self._places:
            self._clamp_position(joint, here, period)
        if math.isfinite(limits.max_velocity):
            self._clamp_velocity(joint, here, speed, period)
        if math.isfinite(limits.max_acceleration) or math.isfinite(limits.max_deceleration):
            self._clamp_acceleration(joint, here, speed, period)
        if limits.has_ends:
            self._look_ahead(joint, here, period)

    def _clamp_position(self, joint: int, here: float, period: float) -> None:
        limits, desired = self.limits[joint], self._positions[joint]
        # a joint outside its range is held there, and returns only if the desired point leads into the range
        low, high = min(limits.min_position, here), max(limits.max_position, here)
        position = min(max(desired, low), high)
        if position != desired and limits.has_ends:
            self._positions[joint] = position
            self._note(joint)
        distance = position - here
        if abs(distance) > _ZERO and abs(self._velocities[joint]) <= _ZERO:
            self._velocities[joint] = distance / period

    def _clamp_velocity(self, joint: int, here: float, speed: float, period: float) -> None:
        most, velocity = self.limits[joint].max_velocity, self._velocities[joint]
        if abs(velocity) <= _ZERO or math.isnan(velocity):
            velocity = self._velocities[joint] = (self._positions[joint] - here) / period
        if abs(velocity) <= most or math.isnan(velocity):
            return
        velocity = self._velocities[joint] = math.copysign(most, velocity)
        self._note(joint)
        if self._places:
            self._positions[joint] = here + velocity * period
        self._accelerations[joint] = (velocity - speed) / period

    def _clamp_acceleration(self, joint: int, here: float, speed: float, period: float) -> None:
        limits, acceleration = self.limits[joint], self._accelerations[joint]
        if abs(acceleration) <= _ZERO or math.isnan(acceleration):
            acceleration = self._accelerations[joint] = (self._velocities[joint] - speed) / period
        slows_down = acceleration * speed < 0.0 and math.isfinite(limits.max_deceleration)
        most = limits.max_deceleration if slows_down else limits.max_acceleration
        if abs(acceleration) <= most or math.isnan(acceleration):
            return
        self._note(joint)
        self._accelerate(joint, math.copysign(most, acceleration), here, speed, period)

    def _accelerate(self, joint: int, acceleration: float, here: float, speed: float, period: float) -> None:
        """Integrate an acceleration over the period into the velocity and position of a joint."""
        self._accelerations[joint] = acceleration
        self._velocities[joint] = speed + acceleration * period
        if self._places:
            self._positions[joint] = here + speed * period + 0.5 * acceleration * period * period

    def _look_ahead(self, joint: int, here: float, period: float) -> None:
        """Request braking of all joints if a joint could otherwise not stop before the end of its range."""
        limits = self.limits[joint]
        if self._speeds and not self._places:
            target = here + self._velocities[joint] * period
            bounded = min(max(target, limits.min_position), limits.max_position)
            if bounded != target:
                self._velocities[joint] = (bounded - here) / period
                self._note(joint)
        velocity = self._velocities[joint]
        rate = abs(velocity / period)
        if math.isfinite(limits.max_deceleration):
            rate = limits.max_deceleration
        elif math.isfinite(limits.max_acceleration):
            rate = limits.max_acceleration
        if rate == 0.0:
            return
        below, above = here - limits.min_position, limits.max_position - here
        braking_distance, coasting_distance = velocity * velocity / (2.0 * rate), velocity * abs(velocity) / rate
        left = below if velocity < 0.0 else above
        if velocity != 0.0 and (left < braking_distance or left < coasting_distance):
            self._brakes = True
            self._note(joint)

    def _brake(self, joint: int, here: float, speed: float, period: float) -> None:
        limits, acceleration = self.limits[joint], -speed / period
        most = limits.max_deceleration if math.isfinite(limits.max_deceleration) else limits.max_acceleration
        self._accelerate(joint, math.copysign(min(abs(acceleration), most), acceleration), here, speed, period)
