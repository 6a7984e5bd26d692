"""The modes of operation with a profile of their own, each a small object (CiA 402-2, 7, 8 and 16).

Set-points are user units, demands are the plant's counts. A set-point makes a new demand only where it, or a ramp or
limit that matters to it, changed.
"""

from __future__ import annotations

import math

from canopen_control.cia402 import objects as o
from canopen_control.virtual.mode_base import BIT_12, BIT_13, NEW_SET_POINT, REACHED, FollowingMode, Mode
from canopen_control.virtual.trajectory import move_to, ramp_to

__all__ = ["ProfilePosition", "ProfileVelocity", "VelocityMode"]

_MS = 1_000_000
IMMEDIATELY, RELATIVE, CHANGE_ON_SET_POINT = 1 << 5, 1 << 6, 1 << 9


class ProfileVelocity(FollowingMode):
    """PV: a ramp to 0x60FF, 0x6083 up and 0x6084 down. Bit 12: the speed is below 0x606F."""

    def reset(self) -> None:
        """Forget the target."""
        super().reset()
        self._target = 0.0
        self._windows_of = -1  # which version of the values they are from
        self._reached_within = self._slow_within = 0.0

    def update(self, now: int) -> None:
        """Take target and ramps; a position limit ahead is where the motion ends."""
        if not self.looks_anew():
            return
        target = self.limits.target_velocity()
        ramps = self.objects.ramp(o.PROFILE_ACCELERATION), self.deceleration()
        if self.changed((target, *ramps, *self.limits.bounds())):
            self._target = target
            self.limits.lead(target, *ramps, now)

    def bits(self) -> int:
        """Return bit 10 within 0x606D of the target, bit 12 below 0x606F."""
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
        """Return 0x6084, or 0x6083 on drives that have one ramp for both."""
        both = self.model.velocity_ramp_both_ways or not self.objects.has(o.PROFILE_DECELERATION)
        return self.objects.ramp(o.PROFILE_ACCELERATION if both else o.PROFILE_DECELERATION)


class VelocityMode(FollowingMode):
    """VL, the frequency converter's: 0x6042 in rpm, ramps 0x6048 and 0x6049, bits 4, 5 and 6 enable it."""

    _RUN = 0x70  # bits 4 (enable ramp), 5 (unlock ramp), 6 (reference ramp)

    def update(self, now: int) -> None:
        """Take target and ramps."""
        word = self.power.controlword
        if not word & 0x20:  # locked: the ramp's output stands
            return
        rpm = self.objects.number(o.VL_TARGET_VELOCITY) * self.units.turn if word & 0x50 == 0x50 else 0.0
        amount, most = abs(rpm), self.objects.number(o.VL_MIN_MAX_AMOUNT, 2)
        if rpm and amount < (least := self.objects.number(o.VL_MIN_MAX_AMOUNT, 1)):
            amount = float(least)
        target = math.copysign(min(amount, most) if most else amount, rpm) * self.objects.counts_per_rpm
        inputs = (target, self._slope(o.VL_ACCELERATION), self.deceleration())
        if self.changed(inputs):
            self.limits.lead(*inputs, now)

    def control(self, word: int, previous: int, now: int) -> None:
        """Hold the present speed while the ramp is locked."""
        if previous & ~word & 0x20:
            self._inputs = None
            position, velocity = self.mover.state(now)
            self.mover.run(ramp_to(now, position, velocity, velocity, 0.0, 0.0), now)

    def bits(self) -> int:
        """Return none."""
        return 0

    def deceleration(self) -> float:
        """Return 0x6049."""
        return self._slope(o.VL_DECELERATION)

    def quick_stop_deceleration(self) -> float:
        """Return 0x604A, or 0x6085 where that is absent or zero."""
        has_own = self.objects.number(o.VL_QUICK_STOP, 1) and self.objects.number(o.VL_QUICK_STOP, 2)
        return self._slope(o.VL_QUICK_STOP) if has_own else super().quick_stop_deceleration()

    def _slope(self, index: int) -> float:
        delta, seconds = self.objects.number(index, 1), self.objects.number(index, 2)
        return delta * self.objects.counts_per_rpm / seconds if delta and seconds else self.model.unset_ramp


class ProfilePosition(Mode):
    """PP: set-points taken by the rising edge of bit 4, one under way and one waiting (bit 12 until it has room).

    Bit 10 needs the demand at its end and the position within 0x6067 for 0x6068 ms: it is never early.
    """

    def reset(self) -> None:
        """Forget all set-points."""
        self._target: float | None = None  # the one under way or reached, in plant counts
        self._next: float | None = None
        self._busy = False  # on its way
        self._profile = (0.0, 0.0, 0.0)  # speed and ramps of the one under way
        self._reached = True
        self._acknowledged = False

    def start(self, now: int) -> None:
        """Go on to the set-point that a halt interrupted, or stand."""
        if self._target is None or not self.power.live:
            super().start(now)
        else:
            self._go(self._target, now)

    def control(self, word: int, previous: int, now: int) -> None:
        """Serve the handshake of bits 4 and 12."""
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
        else:  # halted: it starts when the halt ends
            self._target, self._busy = target, True

    def _blend(self, now: int) -> None:
        """Bit 9: pass the present set-point with the present speed, where the next one is further the same way."""
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
        """Take the waiting set-point, or watch the window."""
        if self._target is None or not self._busy or self.mover.demand.final_position != self._target:
            return
        if self._next is not None:
            target, self._next = self._next, None
            self._acknowledged = bool(self.power.controlword & NEW_SET_POINT)
            self._go(target, now)
        elif self.mover.demand.final_velocity:  # it goes on with 0x6082
            self._arrive()
            self.limits.lead(self.mover.demand.final_velocity, *self._profile[1:], now)
        else:
            self._settle(now, None)

    def _arrive(self) -> None:
        """Be at the target."""
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
        due = now + _MS if since is None or not self.mover.plant.stiff else since + wait
        self.mover.at("window", due, lambda then: self._settle(then, since))

    def bits(self) -> int:
        """Return bit 10 for the last set-point taken, bit 12 while one is acknowledged, bit 13: following error."""
        reached = self._reached and (self._target is not None or self.mover.standing)
        return (
            (REACHED if reached else 0)
            | (BIT_12 if self._acknowledged else 0)
            | (BIT_13 if self.limits.exceeded else 0)
        )
