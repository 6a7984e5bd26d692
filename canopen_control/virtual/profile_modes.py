"""Homing and the modes of operation with a motion profile: HM, PV, VL and PP (CiA 402-2).

Set-points are in user units, demands in plant counts. A set-point makes a new demand only if the set-point itself, or a
ramp or limit that affects it, has changed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.cia402 import objects as o
from canopen_control.cia402.objects import Reaction
from canopen_control.virtual.injection_point import InjectionPoint
from canopen_control.virtual.mode_base import BIT_12, BIT_13, NEW_SET_POINT, REACHED, FollowingMode, Mode
from canopen_control.virtual.trajectory import move_to, ramp_to

if TYPE_CHECKING:
    from canopen_control.virtual.mode_base import AxisParts


# Homing (CiA 402-2, 11): methods 1 to 14, 17 to 30, 33 to 35 and 37 on simulated switches and index pulses.
#
# An entry of `METHODS` defines the switch edge to find, the direction of the last, slow pass over this edge, and
# whether the next index pulse beyond the edge is home instead. The motion is a list of legs, and each leg crosses one
# position: fast until the edge is crossed, then slow, back and forth until the last pass has the right direction.
# Bits 13, 12 and 10 of the statusword mean: 000 running, 001 interrupted, 010 attained and still moving, 011 done,
# 101 error.


_IN_PLACE = (35, 37)
_LIMITS = ("negative", "positive")  # the edges that are limit switches
FAST, SLOW = 1, 2  # subindices of 0x6099


class HomingMethod(NamedTuple):
    """Rule of a homing method: switch edge to find, direction of the last pass, and whether an index pulse is home.

    `edge` is the name of an attribute of `Switches`, "" for none.
    """

    edge: str
    direction: int
    pulse: bool = False


_EDGES: dict[int, HomingMethod] = {
    17: HomingMethod("negative", 1),
    18: HomingMethod("positive", -1),
    # a home switch that stays active towards the positive (19, 20) or negative (21, 22) end
    19: HomingMethod("home_low", -1),
    20: HomingMethod("home_low", 1),
    21: HomingMethod("home_high", 1),
    22: HomingMethod("home_high", -1),
    # a home switch with two edges; 23 to 26 begin in the positive direction, 27 to 30 in the negative one
    23: HomingMethod("home_low", -1),
    24: HomingMethod("home_low", 1),
    25: HomingMethod("home_high", -1),
    26: HomingMethod("home_high", 1),
    27: HomingMethod("home_high", 1),
    28: HomingMethod("home_high", -1),
    29: HomingMethod("home_low", 1),
    30: HomingMethod("home_low", -1),
}
METHODS: dict[int, HomingMethod] = {
    **_EDGES,
    **{number - 16: method._replace(pulse=True) for number, method in _EDGES.items()},
    33: HomingMethod("", -1, pulse=True),
    34: HomingMethod("", 1, pulse=True),
    35: HomingMethod("", 0),
    37: HomingMethod("", 0),
}


class _Leg(NamedTuple):
    position: float
    direction: int
    speed: int  # FAST or SLOW


class HomingMode(Mode):
    """Homing mode (HM): a rising edge of controlword bit 4 starts homing, a falling edge aborts it.

    While the injection point `fails` is True, every homing ends with an error; a homing that begins while `endless` is
    True never ends by itself, whatever its method.
    """

    def __init__(self, axis: AxisParts) -> None:
        super().__init__(axis)
        self.fails: InjectionPoint[bool] = InjectionPoint(False)
        self.endless: InjectionPoint[bool] = InjectionPoint(False)

    def reset(self) -> None:
        """Discard homing in progress and the result bits; an earlier home position is kept."""
        self._legs: list[_Leg] = []
        self._running = False
        self._attained = False
        self._error = False
        self._home = 0.0

    def start(self, now: int) -> None:
        """Continue the leg that a halt interrupted, or stop and wait for bit 4."""
        if self._running and self._legs and self.power.live:
            self._run(now)
        else:
            self.stop(now, Reaction.SLOW_DOWN_RAMP)

    def control(self, word: int, previous: int, now: int) -> None:
        """Start homing at a rising edge of bit 4, and abort it at a falling edge."""
        if word & ~previous & NEW_SET_POINT:
            self._begin(now)
        elif previous & ~word & NEW_SET_POINT and self._running:
            self.reset()
            self._leave_switches()
            self.stop(now, Reaction.SLOW_DOWN_RAMP)

    def bits(self) -> int:
        """Return bit 13 (error), bit 12 (attained) and bit 10 (at standstill, and no homing in progress)."""
        still = 0 if self._running and not self._attained else (REACHED if self.mover.at_standstill else 0)
        return still | (BIT_12 if self._attained else 0) | (BIT_13 if self._error else 0)

    def deceleration(self) -> float:
        """Return the homing acceleration 0x609A in counts/s^2, which is also the slow-down ramp."""
        return self.objects.ramp(o.HOMING_ACCELERATION)

    def can_halt(self) -> bool:
        return self.model.homing_halts

    def control_unpowered(self, word: int, previous: int, now: int) -> None:
        """Take the current position as home (method 35 or 37) if the device can home without power."""
        number = self.objects.number(o.HOMING_METHOD)
        if word & ~previous & NEW_SET_POINT and self.model.homes_without_power and number in _IN_PLACE:
            self._begin(now)

    def unpowered_bits(self) -> int:
        """Return bit 12 of the statusword after homing without power, else 0."""
        return BIT_12 if self._attained and self.model.homes_without_power else 0

    def _begin(self, now: int) -> None:
        self.reset()
        number = self.objects.number(o.HOMING_METHOD)
        allowed = self.model.homing_methods
        method = METHODS.get(number)
        unknown = (allowed is not None and number not in allowed) or (method is None and number != 0)
        speeds = self.objects.number(o.HOMING_SPEEDS, FAST) and self.objects.number(o.HOMING_SPEEDS, SLOW)
        searches = method is not None and bool(method.edge or method.pulse)
        if unknown or self.fails.value:
            self._fail(now)
        elif self.endless.value and not (searches and speeds):
            self._running = True  # without a motion
        elif method is None:  # method 0: no search and no motion
            self._attained = True
        elif not searches:
            self._finish(self.mover.plant.position)
        elif not speeds:
            self._fail(now)
        else:
            self._plan(method, now)
        self.outbox.values_changed()

    def _plan(self, method: HomingMethod, now: int) -> None:
        switches, position = self.mover.switches, self.mover.plant.position
        switches.homing = True
        self._home = position
        if method.edge:
            self._home = float(getattr(switches, method.edge))
            self._legs = _legs_to(position, self._home, method.direction, is_limit=method.edge in _LIMITS)
        if method.pulse:
            period = switches.index_period
            count = math.floor(self._home / period) + 1 if method.direction > 0 else math.ceil(self._home / period) - 1
            self._home = count * period
            self._legs.append(_Leg(self._home, method.direction, SLOW))
        self._running = True
        self._run(now)

    def _run(self, now: int) -> None:
        """Start the motion of the first leg, and schedule the time at which its position is crossed."""
        leg = self._legs[0]
        position, velocity = self.mover.state(now)
        speed = self.objects.speed(o.HOMING_SPEEDS, leg.speed) * leg.direction
        acceleration = self.objects.ramp(o.HOMING_ACCELERATION)
        demand = ramp_to(now, position, velocity, speed, acceleration, acceleration)
        self.mover.run(demand, now)
        if velocity * leg.direction < 0.0:  # the axis may cross the position before it reverses
            after = now + int(abs(velocity) / acceleration * 1e9) if acceleration > 0.0 else now
        else:
            after = now
        crossing = demand.time_of(leg.position, after)
        if self.endless.value:
            return
        if crossing is None:
            self._fail(now)
        else:
            self.mover.at("homing", crossing, lambda then: self._crossed(then))

    def _crossed(self, now: int) -> None:
        if not self._running or not self.power.live:
            return
        self._legs.pop(0)
        if self._legs:
            self._run(now)
        else:
            self._finish(self._home if self.mover.plant.stiff else self.mover.plant.position)
            self.stop(now, Reaction.SLOW_DOWN_RAMP)
        self.outbox.values_changed()

    def _finish(self, home: float) -> None:
        self.units.zero = home - self.objects.number(o.HOME_OFFSET) * self.units.position
        self._attained, self._running = True, False
        self._leave_switches()

    def _fail(self, now: int) -> None:
        self.reset()
        self._error = True
        self._leave_switches()
        self.stop(now, Reaction.SLOW_DOWN_RAMP)

    def _leave_switches(self) -> None:
        self.mover.cancel("homing")
        self.mover.switches.homing = False


def _legs_to(position: float, edge: float, direction: int, *, is_limit: bool) -> list[_Leg]:
    """Return the passes over a switch edge: the first fast, the rest slow, the last in `direction`.

    A motor that stands exactly on the edge moves away from it first. Beyond a limit switch all passes are slow.
    """
    towards = 1 if edge > position else -1
    if edge == position:
        towards = -direction
    legs = [_Leg(edge, towards, SLOW if is_limit and towards == direction else FAST)]
    if towards == direction and legs[0].speed == FAST:
        legs.append(_Leg(edge, -direction, SLOW))
    if legs[-1].direction != direction or legs[-1].speed == FAST:
        legs.append(_Leg(edge, direction, SLOW))
    return legs


_MS = 1_000_000
IMMEDIATELY, RELATIVE, CHANGE_ON_SET_POINT = 1 << 5, 1 << 6, 1 << 9


class ProfileVelocity(FollowingMode):
    """Profile velocity mode (PV): ramp to 0x60FF with the acceleration 0x6083 and the deceleration 0x6084.

    Bit 12 of the statusword is set while the speed is below the threshold 0x606F.
    """

    def reset(self) -> None:
        super().reset()
        self._target = 0.0
        self._windows_of = -1  # version of the values from which the windows were read
        self._reached_within = self._slow_within = 0.0

    def update(self, now: int) -> None:
        if not self.inputs_may_change():
            return
        target = self.limits.target_velocity()
        ramps = self.objects.ramp(o.PROFILE_ACCELERATION), self.deceleration()
        if self.changed((target, *ramps, *self.limits.bounds())):
            self._target = target
            self.limits.ramp_velocity(target, *ramps, now)

    def bits(self) -> int:
        """Return bit 10 if the velocity is within 0x606D of the target, and bit 12 if the speed is below 0x606F."""
        mover, velocity = self.mover, self.mover.plant.velocity
        if self._windows_of != self.objects.store.version:
            self._read_windows()
        bits = BIT_12 if abs(velocity) <= self._slow_within else 0
        if mover.demand.end_ns > (mover.now or 0) or self.limits.active:
            return bits
        return bits | REACHED if abs(velocity - self._target) <= self._reached_within else bits

    def _read_windows(self) -> None:
        self._windows_of = self.objects.store.version
        self._reached_within = max(self.objects.speed(o.VELOCITY_WINDOW), 0.5)
        self._slow_within = max(self.objects.speed(o.VELOCITY_THRESHOLD), 0.5)

    def deceleration(self) -> float:
        """Return 0x6084 in counts/s^2, or 0x6083 on a drive with one ramp for acceleration and deceleration."""
        both = self.model.velocity_ramp_both_ways or not self.objects.has(o.PROFILE_DECELERATION)
        return self.objects.ramp(o.PROFILE_ACCELERATION if both else o.PROFILE_DECELERATION)


class VelocityMode(FollowingMode):
    """Velocity mode (VL) of frequency converters: ramp to 0x6042 in rpm, enabled by controlword bits 4, 5 and 6."""

    def update(self, now: int) -> None:
        """Apply the target 0x6042 and the ramps, unless bit 5 of the controlword locks the ramp."""
        word = self.power.controlword
        if not word & 0x20:  # locked: the output of the ramp is constant
            return
        rpm = self.objects.number(o.VL_TARGET_VELOCITY) * self.units.turn if word & 0x50 == 0x50 else 0.0
        amount, maximum = abs(rpm), self.objects.number(o.VL_MIN_MAX_AMOUNT, 2)
        if rpm and amount < (minimum := self.objects.number(o.VL_MIN_MAX_AMOUNT, 1)):
            amount = float(minimum)
        target = math.copysign(min(amount, maximum) if maximum else amount, rpm) * self.objects.counts_per_rpm
        inputs = (target, self._slope(o.VL_ACCELERATION), self.deceleration())
        if self.changed(inputs):
            self.limits.ramp_velocity(*inputs, now)

    def control(self, word: int, previous: int, now: int) -> None:
        """Keep the current speed when bit 5 of the controlword locks the ramp."""
        if previous & ~word & 0x20:
            self._inputs = None
            position, velocity = self.mover.state(now)
            self.mover.run(ramp_to(now, position, velocity, velocity, 0.0, 0.0), now)

    def bits(self) -> int:
        """Return 0, since VL uses none of bits 10, 12 and 13."""
        return 0

    def deceleration(self) -> float:
        return self._slope(o.VL_DECELERATION)

    def quick_stop_deceleration(self) -> float:
        """Return the quick-stop ramp 0x604A in counts/s^2, or 0x6085 if 0x604A is absent or zero."""
        has_own = self.objects.number(o.VL_QUICK_STOP, 1) and self.objects.number(o.VL_QUICK_STOP, 2)
        return self._slope(o.VL_QUICK_STOP) if has_own else super().quick_stop_deceleration()

    def _slope(self, index: int) -> float:
        delta, seconds = self.objects.number(index, 1), self.objects.number(index, 2)
        return delta * self.objects.counts_per_rpm / seconds if delta and seconds else self.model.unset_ramp


class ProfilePosition(Mode):
    """Profile position mode (PP) with the set-point handshake of bits 4 and 12, and one buffered set-point.

    Bit 12 also stays set while the buffer is full. Bit 10 is set only when the demand has ended and the position has
    been within 0x6067 for 0x6068 ms.
    """

    def reset(self) -> None:
        self._target: float | None = None  # active or reached set-point, in plant counts
        self._next: float | None = None
        self._busy = False  # in process
        self._profile = (0.0, 0.0, 0.0)  # speed and ramps of the active set-point
        self._reached = True
        self._acknowledged = False

    def start(self, now: int) -> None:
        """Continue to the set-point whose motion a halt interrupted, or stop the axis."""
        if self._target is None or not self.power.live:
            super().start(now)
        else:
            self._go(self._target, now)

    def control(self, word: int, previous: int, now: int) -> None:
        """Execute the set-point handshake of bits 4 and 12."""
        single = self.model.single_set_point
        if word & ~previous & NEW_SET_POINT:
            at_once = single or bool(word & IMMEDIATELY) or not self._busy
            if at_once or self._next is None:
                target = self._absolute(word, now)
                self._acknowledged = True
                self._take(target, at_once and not self.power.halted, now)
                if self._next is not None and word & CHANGE_ON_SET_POINT and not self.power.halted:
                    self._blend(now)
        elif not word & NEW_SET_POINT and self._next is None and not (single and self._busy):
            self._acknowledged = False

    def _absolute(self, word: int, now: int) -> float:
        target = self.objects.number(o.TARGET_POSITION) * self.units.position
        if not word & RELATIVE:
            offset = self.objects.number(o.POSITION_OFFSET) * self.units.position
            return self.limits.position(self.units.zero + target + offset)
        option = self.objects.number(o.POSITIONING_OPTION) & 3
        last = self._next if self._next is not None else self._target
        bases = (last, self.mover.state(now)[0], self.mover.plant.position)
        base = bases[option] if option < 3 else None
        return self.limits.position(target + (self.mover.plant.position if base is None else base))

    def _take(self, target: float, at_once: bool, now: int) -> None:
        if at_once:
            self._next = None
            self._go(target, now)
        elif self._busy:
            self._next = target
        else:  # halted: the set-point starts when the halt ends
            self._target, self._busy = target, True

    def _blend(self, now: int) -> None:
        """Pass the active set-point without stopping (bit 9) if the next set-point is in the same direction."""
        target, following = self._target, self._next
        position, velocity = self.mover.state(now)
        if target is None or following is None or (target - position) * (following - target) <= 0.0:
            return
        speed = self._profile[0]
        self.mover.run(move_to(now, position, velocity, target, *self._profile, end=speed), now)

    def _go(self, target: float, now: int) -> None:
        self._target, self._busy, self._reached = target, True, False
        self.mover.cancel("window")
        position, velocity = self.mover.state(now)
        speed = self.limits.velocity(self.objects.speed(o.PROFILE_VELOCITY) or self.model.unset_velocity)
        self._profile = speed, self.objects.ramp(o.PROFILE_ACCELERATION), self.deceleration()
        end = 0.0 if self.model.single_set_point else self.objects.speed(o.END_VELOCITY)
        self.mover.run(move_to(now, position, velocity, target, *self._profile, end=end), now)

    def arrived(self, now: int) -> None:
        """Start the buffered set-point, continue at the end velocity 0x6082, or check the position window."""
        if self._target is None or not self._busy or self.mover.demand.final_position != self._target:
            return
        if self._next is not None:
            target, self._next = self._next, None
            self._acknowledged = bool(self.power.controlword & NEW_SET_POINT)
            self._go(target, now)
        elif self.mover.demand.final_velocity:  # the motion continues with the end velocity 0x6082
            self._arrive()
            self.limits.ramp_velocity(self.mover.demand.final_velocity, *self._profile[1:], now)
        else:
            self._settle(now, None)

    def _arrive(self) -> None:
        """Mark the set-point as reached, and clear bit 12 unless bit 4 is set."""
        self._busy, self._reached = False, True
        if not self.power.controlword & NEW_SET_POINT:
            self._acknowledged = False
        self.outbox.values_changed()

    def _settle(self, now: int, inside_since: int | None) -> None:
        window = self.objects.length(o.POSITION_WINDOW)
        off = self.objects.number(o.POSITION_WINDOW) in (0, 0xFFFFFFFF)
        error = abs(self.mover.plant.position - (self._target or 0.0))
        inside = off or error <= window
        since = (now if inside_since is None else inside_since) if inside else None
        wait = 0 if off else self.objects.number(o.POSITION_WINDOW_TIME) * _MS
        if since is not None and now - since >= wait:
            self._arrive()
            return
        deadline = now + _MS if since is None or not self.mover.plant.stiff else since + wait
        self.mover.at("window", deadline, lambda then: self._settle(then, since))

    def bits(self) -> int:
        """Return bit 10 at the last set-point, bit 12 if a set-point is acknowledged, bit 13 on a following error."""
        reached = self._reached and (self._target is not None or self.mover.at_standstill)
        return (
            (REACHED if reached else 0)
            | (BIT_12 if self._acknowledged else 0)
            | (BIT_13 if self.limits.exceeded else 0)
        )
