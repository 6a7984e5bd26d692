"""Targets that are positions: CSP and IP, a place for every SYNC, and PP, a set-point with a handshake (CiA 402-2).

The law of this file: CSP and IP have no ramp in the drive, so the master ramps, also to a stop; PP leaves the way to
the drive. What is more than half a turn of the counter away is no target: the axis stands, and `Axis.misfit` says so.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.setpoint import SetPointHandshake
from canopen_control.cia402.units import INT32_MAX, INT32_MIN, wrap_int32
from canopen_control.hardware.interfaces import POSITION
from canopen_control.hardware.mode_target import ModeTarget, stop_slope
from canopen_control.hardware.place_ramp import PlaceRamp

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.cia402.setpoint import SetPointEvent
    from canopen_control.hardware.axis import Axis
    from canopen_control.master.cycle import Output

__all__ = ["InterpolatedTarget", "PositionTarget", "SetPointTarget"]

_NAN: Final = math.nan
_INTERPOLATE: Final = 0x10
_NEAR: Final = 1 << 30  # counts: closer than this no rounding makes a target lie beyond half a turn of its counter


class _PositionTarget(ModeTarget):
    """What the targets of positions share: where the axis is, turns of its counter included."""

    def span(self) -> tuple[float, float]:
        """Return what is less than half a turn of the counter away: beyond that the drive would go the other way."""
        here, scale = self._axis.raw_position + self._axis.unwrap.offset, self._axis.scale
        ends = [(here + way - scale.offset_pos_to_dev) / scale.pos_to_dev for way in (INT32_MIN + 1, INT32_MAX)]
        return min(ends), max(ends)

    def _count_of(self, value: float, none: int) -> int:
        """Return the count of a target; `none` without one, and for one that does not fit, which is noted."""
        axis = self._axis
        scale = axis.scale
        count = value * scale.pos_to_dev + scale.offset_pos_to_dev
        if -_NEAR <= count - (axis.raw_position + axis.unwrap.offset) <= _NEAR:  # False for nan
            axis.misfit = _NAN
            return round(count)
        if value != value:
            return none
        low, high = self.span()
        fits = low <= value <= high
        axis.misfit = _NAN if fits else value
        return scale.position_count(value) if fits else none


class PositionTarget(_PositionTarget):
    """CSP: a target for every SYNC, in steps the drive can make; the master's ramp ends the motion."""

    interface = POSITION
    tracks = True

    def __init__(self, axis: Axis, output: Output, machine: DriveMachine) -> None:
        super().__init__(axis, output, machine)
        self._count: int | None = None  # of the target, turns of the counter included; None: where the axis is
        self._speed = 0.0  # counts per second
        self._ramp = PlaceRamp()

    def hold(self) -> None:
        """Target the actual position."""
        self._count, self._value = None, _NAN
        self._speed = self._slope = 0.0
        self._ramp.rest()
        self.output.set(self._axis.raw_position)

    def ramp(self, velocity: float, slope: float) -> None:
        """See `ModeTarget`; infinite ones leave the way to the drive."""
        counts = abs(self._axis.scale.pos_to_dev / self._axis.scale.vel_to_dev)
        self._ramp.limit(velocity * counts, slope * counts)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        """Send a position, no faster than the drive's largest velocity; without one stay."""
        if self._same(value) and self._speed == 0.0:
            return
        if self._ramp.speed and value != value:
            if self.slow(period):
                self._ramp.rest()
            return
        here = self._here() if self._count is None else self._count
        self._go(here, self._towards(here, self._count_of(value, here), period), period)

    def slow(self, period: float) -> bool:
        """Let the target run out along the drive's deceleration."""
        self._value = _NAN
        if self._speed == 0.0:
            return True
        here = self._here()
        self._slope = self._slope or stop_slope(self._axis, abs(self._speed))
        left = max(0.0, abs(self._speed) - self._slope * period)
        speed = math.copysign(left, self._speed)
        self._go(here, here + round(speed * period), period)
        self._speed = speed
        return left == 0.0

    def _here(self) -> int:
        if self._count is None:
            self._count = self._axis.raw_position + self._axis.unwrap.offset
        return self._count

    def _towards(self, here: int, target: int, period: float) -> int:
        limits, way = self._axis.limits, target - here
        if way * limits.blocked > 0:
            self._ramp.rest()
            return here
        if self._ramp.limited:
            return here + self._ramp.step(way, period, limits.velocity)
        step = int(limits.velocity * period)
        if -step <= way <= step:
            return target
        step = max(1, step)
        return max(here - step, min(here + step, target))

    def _go(self, here: int, count: int, period: float) -> None:
        """Send a count, as far as the software limits let it, instead of the one sent last."""
        axis = self._axis
        limits, offset = axis.limits, axis.unwrap.offset
        raw = wrap_int32(count - offset)
        if not limits.low <= raw <= limits.high:
            bounded = limits.of_position(raw)
            if bounded != raw:
                raw, count = bounded, bounded + offset
        self._speed = (count - here) / period if period > 0 else 0.0
        self._count = count
        if raw != self.output.value:
            self.output.set(raw)


class InterpolatedTarget(PositionTarget):
    """IP: as CSP, with interpolation switched on."""

    bits = _INTERPOLATE


class SetPointTarget(_PositionTarget):
    """PP: every new target is a set-point with its own handshake; a stop is the drive's halt (0x605D)."""

    interface = POSITION
    handshakes = True

    def __init__(self, axis: Axis, output: Output, machine: DriveMachine) -> None:
        super().__init__(axis, output, machine)
        self._handshake = SetPointHandshake()
        self._given: int | None = None

    def hold(self) -> None:
        """Give up the set-point and target the actual position."""
        self._value, self._given = _NAN, None
        if self._handshake.busy:
            self._handshake.abort("the axis is not enabled")
            self._handshake.update(None, ready=False, now=0)
        self.bits = 0
        self.output.set(self._axis.raw_position)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        """Hand a new target to the drive, in place of one it is under way to; with none it comes to rest on the way."""
        handshake, machine = self._handshake, self._machine
        if self._same(value):
            pass
        elif not math.isnan(value):
            self._give(value)
        elif self._given is not None:
            self._take_back(self._given)
        if handshake.busy:
            self.bits = handshake.update(machine.statusword, ready=True, now=now, halted=machine.halted)
            if handshake.target is not None:
                self.output.set(handshake.target)

    def move(self, count: int, *, relative: bool) -> None:
        """Give one set-point in device units, from outside any controller."""
        self._handshake.move(count, relative=relative, immediately=True)

    def slow(self, period: float) -> bool:  # noqa: ARG002 - the verb of every mode
        """Let the drive ramp down by its halt option."""
        self._value, self._given = _NAN, None
        if self._handshake.busy:
            self._handshake.abort("stopped")
            self._handshake.update(self._machine.statusword, ready=False, now=0)
        self.bits = 0
        self._machine.halt(True)
        return True

    def events(self) -> Sequence[SetPointEvent]:
        """Return what happened to the set-points."""
        return self._handshake.events()

    def _take_back(self, given: int) -> None:
        """Let the drive come to rest where its own ramp ends, unless it is at the target that is taken back."""
        self._given = None
        axis, here = self._axis, self._axis.raw_position
        if not self._handshake.busy:
            return
        velocity = axis.velocity.value if axis.velocity is not None and axis.velocity.fresh else 0
        way = velocity * abs(velocity) / (2 * stop_slope(axis, max(1, abs(velocity))))
        rest = here + round(way * abs(axis.scale.pos_to_dev / axis.scale.vel_to_dev))
        low, high = min(here, given), max(here, given)
        self._handshake.move(max(low, min(high, rest)), immediately=True)

    def _give(self, value: float) -> None:
        axis = self._axis
        count = self._count_of(value, axis.raw_position + axis.unwrap.offset)
        raw = axis.limits.of_position(axis.unwrap.raw_of(count))
        if raw != self._given:
            self._given = raw
            self._handshake.move(raw, immediately=True)
