"""Targets of the modes of operation (CiA 402-2): a value in SI units becomes the target object of a mode.

`hold` commands standstill at the present position, for every cycle in which nothing may move; `follow` sends a target
in SI units, nan for none; `ramp_down` is one cycle of a controlled stop and returns whether the target is at
standstill. An unchanged target costs only a comparison.

CSP, IP and CSV have no ramp in the drive, so the master computes their stop ramps; PP and PV leave the ramp to the
drive. A target that is more than half the range of the counter away, or does not fit its object, is not sent: the axis
stops, and `out_of_range` of the axis is this target.
"""

from __future__ import annotations

import math
from abc import ABCMeta, abstractmethod
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.setpoint import SetPointHandshake
from canopen_control.cia402.units import INT16_MAX, INT16_MIN, INT32_MAX, INT32_MIN, to_object, wrap_int32
from canopen_control.hardware.axis import HELD
from canopen_control.hardware.tracking import TrapezoidalProfile
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.cia402.setpoint import SetPointEvent
    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.master.cycle import Output


_NAN: Final = math.nan
_DEFAULT_STOP_S: Final = 0.5  # duration of a stop if the drive has no deceleration
_VL_RUN: Final = 0x70  # CiA 402-2, 0x6040 in mode VL: bits 4, 5 and 6 enable, unlock and use the ramp's reference
_INTERPOLATE: Final = 0x10  # CiA 402-2, 0x6040 in mode IP: bit 4 enables interpolation
_FAR: Final = 0.01  # rad (m): at a larger distance the set-point is not reached
_FAST: Final = 0.05  # rad/s (m/s): a higher speed is motion
_WAY_CYCLES: Final = 2.0  # delay of a measured value and of a target, in cycles
_NEAR: Final = 1 << 30  # counts: a closer target is certainly within half the range of the counter


class ModeTarget(metaclass=ABCMeta):
    """Base class of the targets of modes of operation.

    `output` is the target object in an RPDO, `bits` are the mode-specific bits of the controlword, `held_bits` those at
    standstill; `handshakes` is True if the target has events, `tracks` if the axis must reach the position or velocity
    in every cycle, `ramped` if the master computes its ramps, because the drive has none in this mode. `value` is the
    last target, nan for none, and `blocked` the direction in which an active limit forbade motion then; `steady` is
    True if repeating a target changes nothing.
    """

    interface = ""
    bits = 0
    held_bits = 0
    handshakes = False
    tracks = False
    ramped = False
    steady = False

    def __init__(self, axis: AxisProcessData, output: Output, machine: DriveMachine) -> None:
        self._axis, self.output, self._machine = axis, output, machine
        self.value = _NAN
        self.blocked = 0
        self._slope = 0.0  # deceleration of a stop that the master ramps

    @abstractmethod
    def hold(self) -> None:
        """Command standstill at the current position."""

    @abstractmethod
    def follow(self, value: float, now: int, period: float) -> None:
        """Send a target in SI units (nan: no target); `now` is in ns, `period` in s."""

    def within(self, value: float, low: float, high: float) -> float:
        """Clamp a target to the range of its command interface."""
        return max(low, min(high, value))

    def ramp(self, velocity: float, slope: float) -> None:
        """Set the maximum speed and acceleration in device units, if the master computes a position profile."""
        del velocity, slope

    @abstractmethod
    def ramp_down(self, period: float) -> bool:
        """Run one cycle of a controlled stop; return True once the target is at standstill."""

    @abstractmethod
    def value_range(self) -> tuple[float, float]:
        """Return the smallest and largest value of the target object in SI units."""

    def commands_into_limit(self, value: float) -> bool:  # noqa: ARG002 - the verb of every mode
        """Whether a target moves the axis beyond its active limit; never for positions, which end there."""
        return False

    def events(self) -> Sequence[SetPointEvent]:
        """Return the new set-point events; only PP has any."""
        return ()

    def _same(self, value: float) -> bool:
        """Whether the target and the blocked direction are unchanged since the last cycle; if not, store both."""
        if value == self.value and self._axis.limits.blocked == self.blocked:
            return True
        self.value, self.blocked = value, self._axis.limits.blocked
        return False


def stop_slope(axis: AxisProcessData, speed: float) -> float:
    """Return the deceleration of a stop in units/s^2: 0x6084, or the value that stops `speed` in half a second."""
    slope = axis.limits.deceleration
    return slope if math.isfinite(slope) and slope > 0 else speed / _DEFAULT_STOP_S


class _ScaledTarget(ModeTarget):
    """Target of velocity or torque with a scale factor and an integer range."""

    low = INT16_MIN
    high = INT16_MAX

    @abstractmethod
    def factor(self) -> float:
        """Return the device units per SI unit, with the sign of the direction."""

    def value_range(self) -> tuple[float, float]:
        factor = self.factor()
        ends = self.low / factor, self.high / factor
        return min(ends), max(ends)

    def commands_into_limit(self, value: float) -> bool:
        return value * self.factor() * self._axis.limits.blocked > 0  # False for nan

    def _scaled(self, value: float) -> int:
        """Return a target in device units; 0 for nan or a target out of range, which is stored in `out_of_range`."""
        raw = to_object(value * self.factor(), self.low, self.high)
        self._axis.out_of_range = _NAN if raw is not None else value
        return 0 if raw is None else raw


class VelocityTarget(_ScaledTarget):
    """Target of mode PV; the drive computes the ramp."""

    interface = VELOCITY
    tracks = True
    steady = True
    low = INT32_MIN
    high = INT32_MAX
    ramped = False  # the master ramps
    has_minimum = False

    def hold(self) -> None:
        self.value = _NAN
        self._slope = 0.0
        self.output.set(0)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        axis = self._axis
        blocked = axis.limits.blocked
        if value == self.value and blocked == self.blocked:
            return  # same as `_same`, but faster
        self.value, self.blocked = value, blocked
        self._slope = 0.0
        self.output.set(self._bounded(self._scaled(value)))

    def _bounded(self, raw: int) -> int:
        return self._axis.limits.of_velocity(raw)

    def factor(self) -> float:
        return self._axis.scale.vel_to_dev

    def ramp_down(self, period: float) -> bool:
        """Ramp to zero with the drive's deceleration; command zero at once if the drive computes the ramp."""
        raw: int = self.output.value
        self.value = _NAN
        if not self.ramped or raw == 0:
            self.output.set(0)
            return True
        self._slope = self._slope or stop_slope(self._axis, abs(raw))
        step = max(1, round(self._slope * period))
        raw = max(0, raw - step) if raw > 0 else min(0, raw + step)
        self.output.set(raw)
        return raw == 0


class RampedVelocityTarget(VelocityTarget):
    """Target of mode CSV; the master computes the stop ramp."""

    ramped = True


class WordVelocityTarget(VelocityTarget):
    """Target of mode VL: 0x6042 in rpm of the motor, 16 bits, with the drive's ramp enabled."""

    bits = _VL_RUN
    held_bits = _VL_RUN  # without bit 5 the ramp keeps its speed, also in a drive that ignores a quick stop
    low = INT16_MIN
    high = INT16_MAX
    has_minimum = True  # CiA 402-2, 0x6046: a drive turns at its minimum velocity at least, unless its target is 0

    def factor(self) -> float:
        """Return the motor rpm per rad/s (m/s)."""
        return self._axis.rpm_to_dev

    def _bounded(self, raw: int) -> int:
        axis = self._axis
        return axis.limits.within(raw, axis.limits.most * abs(axis.rpm_to_dev / axis.scale.vel_to_dev))


class EffortTarget(_ScaledTarget):
    """Target of modes TQ and CST; a stop commands zero torque.

    A torque does not limit the velocity: a torque that would drive a joint beyond the velocity limit of its description
    is set to zero, as in ros2_control's joint limiter. The joint continues to accelerate during the two cycles that a
    measured value takes from the drive and a target takes to the drive, so that the velocity expected after these
    cycles is compared with the limit.
    """

    interface = EFFORT

    def __init__(self, axis: AxisProcessData, output: Output, machine: DriveMachine) -> None:
        super().__init__(axis, output, machine)
        self._last: int | None = None  # position in the previous cycle, if no velocity is measured
        self._speed = _NAN  # speed in the previous cycle

    def hold(self) -> None:
        self.value, self._last, self._speed = _NAN, None, _NAN
        self.output.set(0)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        """Send a torque within the drive's limits, or 0 if the velocity limit would be exceeded."""
        limits = self._axis.limits
        same = self._same(value)
        if limits.described == math.inf:
            if not same:
                self.output.set(limits.of_torque(self._scaled(value)))
            return
        before, self._speed = self._speed, self._measured(period)
        speed = self._speed
        if speed == speed and before == before:  # both speeds are known
            speed += _WAY_CYCLES * (speed - before)
        if value * speed > 0.0 and abs(speed) >= limits.described:  # False for nan
            limits.held = True
            value = 0.0
        self.output.set(limits.of_torque(self._scaled(value)))

    def _measured(self, period: float) -> float:
        """Return the measured speed in SI units, if necessary from positions; nan if unknown."""
        axis = self._axis
        if axis.velocity is not None and axis.velocity.fresh:
            speed: float = axis.velocity.value * axis.scale.vel_from_dev
            return speed
        here = axis.raw_position + axis.unwrap.offset
        last, self._last = self._last, here
        return _NAN if last is None or period <= 0.0 else (here - last) / axis.scale.pos_to_dev / period

    def factor(self) -> float:
        return self._axis.scale.eff_to_dev

    def ramp_down(self, period: float) -> bool:  # noqa: ARG002 - the verb of every mode
        self.hold()
        return True


class _PositionTarget(ModeTarget):
    """Target position, unwrapped beyond the drive's 32-bit counter."""

    def value_range(self) -> tuple[float, float]:
        """Return the positions half the counter's range away, beyond which the drive would turn the other way."""
        here, scale = self._axis.raw_position + self._axis.unwrap.offset, self._axis.scale
        ends = [(here + way - scale.offset_pos_to_dev) / scale.pos_to_dev for way in (INT32_MIN + 1, INT32_MAX)]
        return min(ends), max(ends)

    def within(self, value: float, low: float, high: float) -> float:
        """Clamp a target to the range; an axis outside the range stays there for a target that is outside too."""
        scale = self._axis.scale
        here = (self._start() - scale.offset_pos_to_dev) / scale.pos_to_dev
        return super().within(value, min(low, here), max(high, here))

    def _start(self) -> int:
        """Return the position in counts from which a target continues, including the turns of the counter."""
        return self._axis.raw_position + self._axis.unwrap.offset

    def _count_of(self, value: float, none: int) -> int:
        """Return the count of a target; `none` for nan or a target out of range, which is stored in `out_of_range`."""
        axis = self._axis
        scale = axis.scale
        count = value * scale.pos_to_dev + scale.offset_pos_to_dev
        if -_NEAR <= count - (axis.raw_position + axis.unwrap.offset) <= _NEAR:  # False for nan
            axis.out_of_range = _NAN
            return round(count)
        if value != value:
            return none
        low, high = self.value_range()
        fits = low <= value <= high
        axis.out_of_range = _NAN if fits else value
        return scale.position_count(value) if fits else none


class PositionTarget(_PositionTarget):
    """Target of mode CSP: one position per SYNC within the velocity limit; the master computes the stop ramp."""

    interface = POSITION
    tracks = True
    ramped = True

    def __init__(self, axis: AxisProcessData, output: Output, machine: DriveMachine) -> None:
        super().__init__(axis, output, machine)
        self._count: int | None = None  # target with the turns of the counter; None: the present position
        self._speed = 0.0  # counts per second
        self._rest = 0.0  # fraction of a count that is left for the next cycle at the velocity limit
        self._ramp = TrapezoidalProfile()

    def hold(self) -> None:
        self._count, self.value = None, _NAN
        self._speed = self._slope = 0.0
        self._ramp.rest()
        self.output.set(self._axis.raw_position)

    def ramp(self, velocity: float, slope: float) -> None:
        """Set the maximum speed and acceleration in device units; if both are infinite, no ramp is computed."""
        counts = abs(self._axis.scale.pos_to_dev / self._axis.scale.vel_to_dev)
        self._ramp.limit(velocity * counts, slope * counts)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        """Send a position within the velocity limit; for nan, stop or hold the last target."""
        if self._same(value) and self._speed == 0.0:
            return
        if self._ramp.speed and value != value:
            if self.ramp_down(period):
                self._ramp.rest()
            return
        here = self._here() if self._count is None else self._count
        self._send_position(here, self._towards(here, self._count_of(value, here), period), period)

    def ramp_down(self, period: float) -> bool:
        self.value = _NAN
        if self._speed == 0.0:
            return True
        here = self._here()
        self._slope = self._slope or stop_slope(self._axis, abs(self._speed))
        remaining = max(0.0, abs(self._speed) - self._slope * period)
        speed = math.copysign(remaining, self._speed)
        self._send_position(here, here + round(speed * period), period)
        self._speed = speed
        return remaining == 0.0

    def shift(self) -> None:
        """Send the present target in the drive's new coordinates, so that the axis does not move by the jump."""
        if self._count is not None:
            axis = self._axis
            self.output.set(axis.limits.of_position(wrap_int32(self._count - axis.unwrap.offset)))

    def _start(self) -> int:
        return super()._start() if self._count is None else self._count

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
            return here + self._ramp.step(way, period, limits.pace)
        reach = limits.pace * period + self._rest
        if -reach <= way <= reach:
            self._rest = 0.0
            return target
        limits.held = limits.held or abs(way) > reach * HELD + 1
        step = int(reach)
        self._rest = reach - step
        if step == 0:
            self.value = _NAN  # nan, so that the next cycle continues
        return here + step if way > 0 else here - step

    def _send_position(self, here: int, count: int, period: float) -> None:
        """Send a position count within the software position limits; store count and speed."""
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
    """Target of mode IP: as in CSP, with interpolation enabled by bit 4."""

    bits = _INTERPOLATE


class SetPointTarget(_PositionTarget):
    """Target of mode PP: set-points with a handshake; a stop uses the halt bit (0x605D)."""

    interface = POSITION
    handshakes = True

    def __init__(self, axis: AxisProcessData, output: Output, machine: DriveMachine) -> None:
        super().__init__(axis, output, machine)
        self._handshake = SetPointHandshake()
        self._sent: int | None = None

    def hold(self) -> None:
        """Abandon the set-point and command the actual position."""
        self.value, self._sent = _NAN, None
        if self._handshake.busy:
            self._handshake.abort("the axis is not enabled")
            self._handshake.update(None, ready=False, now=0)
        self.bits = 0
        self.output.set(self._axis.raw_position)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        """Send a new set-point, which replaces an active one; for nan, stop with the drive's ramp."""
        handshake, machine = self._handshake, self._machine
        if self._same(value):
            pass
        elif not math.isnan(value):
            self._send_set_point(value)
        elif self._sent is not None:
            self._brake(self._sent)
        if handshake.busy:
            self.bits = handshake.update(
                machine.statusword,
                ready=True,
                now=now,
                halted=machine.halted,
                under_way=self._is_moving(),
                position=self._axis.raw_position,
            )
            if handshake.target is not None:
                self.output.set(handshake.target)

    def _is_moving(self) -> bool:
        """Whether the axis moves, faster than `_FAST`, and is farther than `_FAR` from its set-point."""
        axis, target = self._axis, self._handshake.target
        velocity, position = axis.velocity, axis.position
        if target is None or velocity is None or position is None or not (velocity.fresh and position.fresh):
            return False
        far = abs(wrap_int32(target - axis.raw_position)) > _FAR * abs(axis.scale.pos_to_dev)
        return far and abs(velocity.value * axis.scale.vel_from_dev) > _FAST

    def move(self, count: int, *, relative: bool) -> None:
        """Send one set-point in device units, independent of controllers."""
        self._handshake.move(count, relative=relative, immediately=True)

    def ramp_down(self, period: float) -> bool:  # noqa: ARG002 - the verb of every mode
        """Stop with the halt bit (0x605D); return True at once."""
        self.value, self._sent = _NAN, None
        if self._handshake.busy:
            self._handshake.abort("stopped")
            self._handshake.update(self._machine.statusword, ready=False, now=0)
        self.bits = 0
        self._machine.halt(True)
        return True

    def events(self) -> Sequence[SetPointEvent]:
        return self._handshake.events()

    def _brake(self, target: int) -> None:
        """Stop by moving the set-point to where the drive's braking ramp ends, but not beyond `target`."""
        self._sent = None
        axis, here = self._axis, self._axis.raw_position
        if not self._handshake.busy:
            return
        velocity = axis.velocity.value if axis.velocity is not None and axis.velocity.fresh else 0
        way = velocity * abs(velocity) / (2 * stop_slope(axis, max(1, abs(velocity))))
        resting = here + round(way * abs(axis.scale.pos_to_dev / axis.scale.vel_to_dev))
        low, high = min(here, target), max(here, target)
        self._handshake.stop_at(max(low, min(high, resting)))

    def _send_set_point(self, value: float) -> None:
        axis = self._axis
        if axis.limits.ramp_unbounded:
            self.value = _NAN  # waits until the drive's own speed is known to be within the limit
            return
        count = self._count_of(value, axis.raw_position + axis.unwrap.offset)
        raw = axis.limits.of_position(axis.unwrap.raw_of(count))
        if raw != self._sent:
            self._sent = raw
            self._handshake.move(raw, immediately=True)


TARGET_CLASSES: Final[Mapping[int, Callable[[AxisProcessData, Output, DriveMachine], ModeTarget]]] = MappingProxyType(
    {
        OperationMode.PP: SetPointTarget,
        OperationMode.VL: WordVelocityTarget,
        OperationMode.PV: VelocityTarget,
        OperationMode.TQ: EffortTarget,
        OperationMode.IP: InterpolatedTarget,
        OperationMode.CSP: PositionTarget,
        OperationMode.CSV: RampedVelocityTarget,
        OperationMode.CST: EffortTarget,
    }
)
"""Class of each mode's target, for the object in `cia402.modes.TARGET_OBJECTS`."""


OWN_CLASSES: Final[Mapping[str, Callable[[AxisProcessData, Output, DriveMachine], ModeTarget]]] = MappingProxyType(
    {POSITION: PositionTarget, VELOCITY: RampedVelocityTarget, EFFORT: EffortTarget}
)
"""Class of the target of a manufacturer-specific mode, by command interface; the master computes the ramp."""

HOLDING: Final = (PositionTarget, InterpolatedTarget)
"""Classes whose target at standstill is the actual position, to which the drive moves as soon as it is enabled."""


def make_target(mode: int, axis: AxisProcessData, machine: DriveMachine) -> ModeTarget | None:
    """Return the target of a mode, or None if the mode has no target object or no RPDO contains it."""
    address = axis.target_objects.get(mode)
    output = None if address is None else axis.output(*address)
    if address is None or output is None:
        return None
    target = (TARGET_CLASSES.get(mode) or OWN_CLASSES[axis.own_modes[mode]])(axis, output, machine)
    # EDS files of drives differ from the data types of CiA 402-2, such as 0x6071 with 32 bits
    entry = axis.node.od.get(axis.index(address[0]), address[1])
    if isinstance(target, _ScaledTarget) and entry is not None and (bits := entry.data_type.bits) is not None:
        target.low, target.high = -(1 << bits - 1), (1 << bits - 1) - 1
    return target
