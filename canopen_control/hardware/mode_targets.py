"""What a mode of operation does with a joint's target: one small object per kind of target (CiA 402-2).

The law of this file: `hold` is standstill where the axis is, for every cycle in which nothing may move; `follow` takes
a target in SI units, nan for none; `slow` is one cycle of a controlled stop and tells when its target stands. The
profile modes leave the ramp to the drive (0x6084); the cyclic ones (CSP, CSV, IP) have none, so the master ramps. What
does not fit the object after scaling is no target: the axis stands, and `Axis.misfit` says so. A target that did not
change costs one comparison.
"""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.setpoint import SetPointHandshake
from canopen_control.cia402.units import INT16_MAX, INT16_MIN, INT32_MAX, INT32_MIN, to_object, wrap_int32
from canopen_control.hardware.interfaces import EFFORT, POSITION, VELOCITY
from canopen_control.hardware.place_ramp import PlaceRamp

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.cia402.setpoint import SetPointEvent
    from canopen_control.hardware.axis import Axis
    from canopen_control.master.cycle import Output

__all__ = ["MODES", "ModeTarget", "make_target", "target_address"]

_NAN: Final = math.nan
_VL_RUN: Final = 0x70  # bits 4, 5 and 6: enable ramp, unlock ramp, use the reference
_INTERPOLATE: Final = 0x10
_DEFAULT_STOP_S: Final = 0.5  # of a ramp where the drive tells no deceleration
_NEAR: Final = 1 << 30  # counts: closer than this no rounding makes a target lie beyond half a turn of its counter


class ModeTarget:
    """The target of one mode: what the modes share, and their verbs.

    `output` carries it, `bits` are the mode's bits of the controlword; `handshakes` says that it has events of its own,
    `tracks` that the axis is to be where the target is, or as fast, in every cycle.
    """

    interface = ""
    bits = 0
    handshakes = False
    tracks = False

    def __init__(self, axis: Axis, output: Output) -> None:
        self._axis, self.output = axis, output
        self._value = _NAN
        self._blocked = 0

    def hold(self) -> None:
        """Stay where the axis is."""
        raise NotImplementedError

    def follow(self, value: float, now: int, period: float) -> None:
        """Take a target in SI units, nan for none."""
        raise NotImplementedError

    def ramp(self, velocity: float, slope: float) -> None:
        """Take a speed and an acceleration, in device units, for targets that are places to go to and no set-points."""

    def slow(self, period: float) -> bool:
        """Make one cycle of a controlled stop; True when the target stands."""
        raise NotImplementedError

    def span(self) -> tuple[float, float]:
        """Return the lowest and the highest value that its object can hold now, in SI units."""
        raise NotImplementedError

    def pushes(self, value: float) -> bool:  # noqa: ARG002 - the verb of every mode
        """Whether a target in SI units leads beyond the active limit; a position never does, it stays before it."""
        return False

    def events(self) -> Sequence[SetPointEvent]:
        """Return what happened since the last call."""
        return ()

    def _same(self, value: float) -> bool:
        """Whether the target is the one of the last cycle, under the same limits."""
        if value == self._value and self._axis.limits.blocked == self._blocked:
            return True
        self._value, self._blocked = value, self._axis.limits.blocked
        return False

    def _scaled(self, value: float, factor: float, low: int, high: int) -> int:
        """Return a target in device units; 0 for none, and for one that does not fit, which is noted."""
        raw = to_object(value * factor, low, high)
        self._axis.misfit = _NAN if raw is not None else value
        return 0 if raw is None else raw


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


class VelocityTarget(ModeTarget):
    """PV and VL, where the drive ramps; and, `ramped` by the master, CSV."""

    interface = VELOCITY
    tracks = True

    def __init__(self, axis: Axis, output: Output, *, ramped: bool = False, words: bool = False, bits: int = 0) -> None:
        super().__init__(axis, output)
        self.bits = bits
        self._ramped, self._words = ramped, words
        self._low, self._high = (INT16_MIN, INT16_MAX) if words else (INT32_MIN, INT32_MAX)
        self._slope = 0.0

    def hold(self) -> None:
        """Command no velocity."""
        self._value = _NAN
        self._slope = 0.0
        self.output.set(0)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        """Send a velocity within the drive's limits."""
        axis = self._axis
        blocked = axis.limits.blocked
        if value == self._value and blocked == self._blocked:
            return  # as `_same`, without the call
        self._value, self._blocked = value, blocked
        self._slope = 0.0
        raw = self._scaled(value, self._factor(), self._low, self._high)
        self.output.set(axis.limits.of_velocity(raw))

    def span(self) -> tuple[float, float]:
        """Return what 0x60FF holds, or 0x6042."""
        return _span(self._low, self._high, self._factor())

    def _factor(self) -> float:
        return self._axis.rpm_to_dev if self._words else self._axis.scale.vel_to_dev

    def pushes(self, value: float) -> bool:
        """Whether a velocity leads beyond the limit that is active."""
        axis = self._axis
        scale = axis.rpm_to_dev if self._words else axis.scale.vel_to_dev
        return value * scale * axis.limits.blocked > 0  # not for nan

    def slow(self, period: float) -> bool:
        """Go towards zero along the drive's deceleration; at once where the drive makes the ramp."""
        raw: int = self.output.value
        self._value = _NAN
        if not self._ramped or raw == 0:
            self.output.set(0)
            return True
        self._slope = self._slope or _deceleration(self._axis, abs(raw))
        step = max(1, round(self._slope * period))
        raw = max(0, raw - step) if raw > 0 else min(0, raw + step)
        self.output.set(raw)
        return raw == 0


class EffortTarget(ModeTarget):
    """TQ and CST: a stop takes the torque away."""

    interface = EFFORT

    def hold(self) -> None:
        """Command no torque."""
        self._value = _NAN
        self.output.set(0)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        """Send a torque within the drive's limits."""
        if not self._same(value):
            raw = self._scaled(value, self._axis.scale.eff_to_dev, INT16_MIN, INT16_MAX)
            self.output.set(self._axis.limits.of_torque(raw))

    def pushes(self, value: float) -> bool:
        """Whether a torque leads beyond the limit that is active."""
        axis = self._axis
        return value * axis.scale.eff_to_dev * axis.limits.blocked > 0  # not for nan

    def span(self) -> tuple[float, float]:
        """Return what 0x6071 holds."""
        return _span(INT16_MIN, INT16_MAX, self._axis.scale.eff_to_dev)

    def slow(self, period: float) -> bool:  # noqa: ARG002 - the verb of every mode
        """Take the torque away."""
        self.hold()
        return True


class PositionTarget(_PositionTarget):
    """CSP and IP: a target for every SYNC, in steps the drive can make; the master's ramp ends the motion."""

    interface = POSITION
    tracks = True

    def __init__(self, axis: Axis, output: Output, *, bits: int = 0) -> None:
        super().__init__(axis, output)
        self.bits = bits
        self._count: int | None = None  # of the target, turns of the counter included; None: where the axis is
        self._speed = 0.0  # counts per second
        self._slope = 0.0
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
        self._slope = self._slope or _deceleration(self._axis, abs(self._speed))
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


class SetPointTarget(_PositionTarget):
    """PP: every new target is a set-point with its own handshake; a stop is the drive's halt (0x605D)."""

    interface = POSITION
    handshakes = True

    def __init__(self, axis: Axis, output: Output, machine: DriveMachine) -> None:
        super().__init__(axis, output)
        self._machine = machine
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
        way = velocity * abs(velocity) / (2 * _deceleration(axis, max(1, abs(velocity))))
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


def _span(low: int, high: int, factor: float) -> tuple[float, float]:
    """Return the ends of an object in SI units, for a reversed axis too; not finite where the factor is that small."""
    ends = low / factor, high / factor
    return min(ends), max(ends)


def _deceleration(axis: Axis, speed: float) -> float:
    """Return units/s^2 of a stop: the drive's (0x6084), or what stops this speed in half a second."""
    slope = axis.limits.deceleration
    return slope if math.isfinite(slope) and slope > 0 else speed / _DEFAULT_STOP_S


MODES: Mapping[int, tuple[int, int, Callable[[Axis, Output, DriveMachine], ModeTarget]]] = MappingProxyType(
    {
        OperationMode.PP: (objects.TARGET_POSITION, 0, SetPointTarget),
        OperationMode.VL: (
            objects.VL_TARGET_VELOCITY,
            0,
            lambda axis, output, _machine: VelocityTarget(axis, output, words=True, bits=_VL_RUN),
        ),
        OperationMode.PV: (objects.TARGET_VELOCITY, 0, lambda axis, output, _machine: VelocityTarget(axis, output)),
        OperationMode.TQ: (objects.TARGET_TORQUE, 0, lambda axis, output, _machine: EffortTarget(axis, output)),
        OperationMode.IP: (
            objects.INTERPOLATION_DATA,
            1,
            lambda axis, output, _machine: PositionTarget(axis, output, bits=_INTERPOLATE),
        ),
        OperationMode.CSP: (objects.TARGET_POSITION, 0, lambda axis, output, _machine: PositionTarget(axis, output)),
        OperationMode.CSV: (
            objects.TARGET_VELOCITY,
            0,
            lambda axis, output, _machine: VelocityTarget(axis, output, ramped=True),
        ),
        OperationMode.CST: (objects.TARGET_TORQUE, 0, lambda axis, output, _machine: EffortTarget(axis, output)),
    }
)
"""Mode to (index and subindex of its target, what makes it)."""


def target_address(mode: int) -> tuple[int, int] | None:
    """Return index and subindex of a mode's target on axis 0, None for a mode without one (homing, vendor modes)."""
    row = MODES.get(mode)
    return None if row is None else (row[0], row[1])


def make_target(mode: int, axis: Axis, machine: DriveMachine) -> ModeTarget | None:
    """Return the target of `mode`, None where the mode has none or no RPDO carries it."""
    row = MODES.get(mode)
    output = None if row is None else axis.output(row[0], row[1])
    return None if row is None or output is None else row[2](axis, output, machine)
