"""The modes of operation with a profile of their own, each a small object (CiA 402-2, 7, 8 and 16).

The law of this file: set-points are user units, demands are the plant's counts. A set-point makes a new demand only
where it, or a ramp or limit that matters to it, changed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.virtual.cyclic import (
    NEW_SET_POINT,
    CyclicPosition,
    CyclicVelocity,
    InterpolatedPosition,
    Torque,
)
from canopen_control.virtual.handler import BIT_12, BIT_13, REACHED, Following, Idle, ModeHandler
from canopen_control.virtual.homing import Homing
from canopen_control.virtual.motion import move_to, ramp_to

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.virtual.drive import VirtualDrive

__all__ = ["HANDLERS", "ProfilePosition", "ProfileVelocity", "VelocityMode"]

_MS = 1_000_000
IMMEDIATELY, RELATIVE, CHANGE_ON_SET_POINT = 1 << 5, 1 << 6, 1 << 9


class ProfileVelocity(Following):
    """PV: a ramp to 0x60FF, 0x6083 up and 0x6084 down. Bit 12: the speed is below 0x606F."""

    def __init__(self) -> None:
        super().__init__()
        self._target = 0.0

    def reset(self) -> None:
        """Forget the target."""
        super().reset()
        self._target = 0.0

    def update(self, drive: VirtualDrive, now: int) -> None:
        """Take target and ramps; a position limit ahead is where the motion ends."""
        target = drive.limits.target_velocity()
        ramps = drive.ramp(o.PROFILE_ACCELERATION), self.deceleration(drive)
        if self.changed((target, *ramps, *drive.limits.bounds())):
            self._target = target
            drive.limits.lead(target, *ramps, now)

    def bits(self, drive: VirtualDrive) -> int:
        """Return bit 10 within 0x606D of the target, bit 12 below 0x606F."""
        velocity = drive.mover.plant.velocity
        reached = drive.mover.demand.end_ns <= drive.now and not drive.limited
        reached = reached and abs(velocity - self._target) <= max(drive.speed(o.VELOCITY_WINDOW), 0.5)
        slow = abs(velocity) <= max(drive.speed(o.VELOCITY_THRESHOLD), 0.5)
        return (REACHED if reached else 0) | (BIT_12 if slow else 0)

    def deceleration(self, drive: VirtualDrive) -> float:
        """Return 0x6084, or 0x6083 on drives that have one ramp for both."""
        both = drive.personality.velocity_ramp_both_ways or not drive.has(o.PROFILE_DECELERATION)
        return drive.ramp(o.PROFILE_ACCELERATION if both else o.PROFILE_DECELERATION)


class VelocityMode(Following):
    """VL, the frequency converter's: 0x6042 in rpm, ramps 0x6048 and 0x6049, bits 4, 5 and 6 enable it."""

    _RUN = 0x70  # bits 4 (enable ramp), 5 (unlock ramp), 6 (reference ramp)

    def update(self, drive: VirtualDrive, now: int) -> None:
        """Take target and ramps."""
        word = drive.controlword
        if not word & 0x20:  # locked: the ramp's output stands
            return
        rpm = drive.number(o.VL_TARGET_VELOCITY) * drive.units.turn if word & 0x50 == 0x50 else 0.0
        amount, most = abs(rpm), drive.number(o.VL_MIN_MAX_AMOUNT, 2)
        if rpm and amount < (least := drive.number(o.VL_MIN_MAX_AMOUNT, 1)):
            amount = float(least)
        target = math.copysign(min(amount, most) if most else amount, rpm) * drive.counts_per_rpm
        inputs = (target, self._slope(drive, o.VL_ACCELERATION), self.deceleration(drive))
        if self.changed(inputs):
            drive.limits.lead(*inputs, now)

    def control(self, drive: VirtualDrive, word: int, previous: int, now: int) -> None:
        """Hold the present speed while the ramp is locked."""
        if previous & ~word & 0x20:
            self._inputs = None
            position, velocity = drive.mover.state(now)
            drive.mover.run(ramp_to(now, position, velocity, velocity, 0.0, 0.0), now)

    def bits(self, drive: VirtualDrive) -> int:  # noqa: ARG002 # VL defines none
        """Return none."""
        return 0

    def deceleration(self, drive: VirtualDrive) -> float:
        """Return 0x6049."""
        return self._slope(drive, o.VL_DECELERATION)

    def quick_stop_deceleration(self, drive: VirtualDrive) -> float:
        """Return 0x604A, or 0x6085 where that is absent or zero."""
        has_own = drive.number(o.VL_QUICK_STOP, 1) and drive.number(o.VL_QUICK_STOP, 2)
        return self._slope(drive, o.VL_QUICK_STOP) if has_own else super().quick_stop_deceleration(drive)

    @staticmethod
    def _slope(drive: VirtualDrive, index: int) -> float:
        delta, seconds = drive.number(index, 1), drive.number(index, 2)
        return delta * drive.counts_per_rpm / seconds if delta and seconds else drive.personality.unset_ramp


class ProfilePosition(Idle):
    """PP: set-points taken by the rising edge of bit 4, one under way and one waiting (bit 12 until it has room).

    Bit 10 needs the demand at its end and the position within 0x6067 for 0x6068 ms: it is never early.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all set-points."""
        self._target: float | None = None  # the one under way or reached, in plant counts
        self._next: float | None = None
        self._busy = False  # on its way
        self._profile = (0.0, 0.0, 0.0)  # speed and ramps of the one under way
        self._reached = True
        self._acknowledged = False

    def start(self, drive: VirtualDrive, now: int) -> None:
        """Go on to the set-point that a halt interrupted, or stand."""
        if self._target is None or not drive.live:
            super().start(drive, now)
        else:
            self._go(drive, self._target, now)

    def control(self, drive: VirtualDrive, word: int, previous: int, now: int) -> None:
        """Serve the handshake of bits 4 and 12."""
        single = drive.personality.single_set_point
        if word & ~previous & NEW_SET_POINT:
            at_once = single or bool(word & IMMEDIATELY) or not self._busy
            if at_once or self._next is None:
                target = self._absolute(drive, word, now)
                self._acknowledged = True
                self._take(drive, target, at_once and not drive.halted, now)
                if self._next is not None and word & CHANGE_ON_SET_POINT and not drive.halted:
                    self._blend(drive, now)
        elif not word & NEW_SET_POINT and self._next is None and not (single and self._busy):
            self._acknowledged = False

    def _absolute(self, drive: VirtualDrive, word: int, now: int) -> float:
        target = drive.number(o.TARGET_POSITION) * drive.units.position
        if not word & RELATIVE:
            offset = drive.number(o.POSITION_OFFSET) * drive.units.position
            return drive.limits.position(drive.zero + target + offset)
        option = drive.number(o.POSITIONING_OPTION) & 3
        last = self._next if self._next is not None else self._target
        bases = (last, drive.mover.state(now)[0], drive.mover.plant.position)
        base = bases[option] if option < 3 else None
        return drive.limits.position(target + (drive.mover.plant.position if base is None else base))

    def _take(self, drive: VirtualDrive, target: float, at_once: bool, now: int) -> None:
        if at_once:
            self._next = None
            self._go(drive, target, now)
        elif self._busy:
            self._next = target
        else:  # halted: it starts when the halt ends
            self._target, self._busy = target, True

    def _blend(self, drive: VirtualDrive, now: int) -> None:
        """Bit 9: pass the present set-point with the present speed, where the next one is further the same way."""
        target, following = self._target, self._next
        position, velocity = drive.mover.state(now)
        if target is None or following is None or (target - position) * (following - target) <= 0.0:
            return
        speed = self._profile[0]
        drive.mover.run(move_to(now, position, velocity, target, *self._profile, end=speed), now)

    def _go(self, drive: VirtualDrive, target: float, now: int) -> None:
        self._target, self._busy, self._reached = target, True, False
        drive.mover.cancel("window")
        position, velocity = drive.mover.state(now)
        speed = drive.limits.velocity(drive.speed(o.PROFILE_VELOCITY) or drive.personality.unset_velocity)
        self._profile = speed, drive.ramp(o.PROFILE_ACCELERATION), self.deceleration(drive)
        end = 0.0 if drive.personality.single_set_point else drive.speed(o.END_VELOCITY)
        drive.mover.run(move_to(now, position, velocity, target, *self._profile, end=end), now)

    def arrived(self, drive: VirtualDrive, now: int) -> None:
        """Take the waiting set-point, or watch the window."""
        if self._target is None or not self._busy or drive.mover.demand.final_position != self._target:
            return
        if self._next is not None:
            target, self._next = self._next, None
            self._acknowledged = bool(drive.controlword & NEW_SET_POINT)
            self._go(drive, target, now)
        elif drive.mover.demand.final_velocity:  # it goes on with 0x6082
            self._arrive(drive)
            drive.limits.lead(drive.mover.demand.final_velocity, *self._profile[1:], now)
        else:
            self._settle(drive, now, None)

    def _arrive(self, drive: VirtualDrive) -> None:
        """Be at the target."""
        self._busy, self._reached = False, True
        if not drive.controlword & NEW_SET_POINT:
            self._acknowledged = False
        drive.touch()

    def _settle(self, drive: VirtualDrive, now: int, inside_since: int | None) -> None:
        window = drive.length(o.POSITION_WINDOW)
        off = drive.number(o.POSITION_WINDOW) in (0, 0xFFFFFFFF)
        error = abs(drive.mover.plant.position - (self._target or 0.0))
        inside = off or error <= window
        since = (now if inside_since is None else inside_since) if inside else None
        wait = 0 if off else drive.number(o.POSITION_WINDOW_TIME) * _MS
        if since is not None and now - since >= wait:
            self._arrive(drive)
            return
        due = now + _MS if since is None or not drive.mover.plant.stiff else since + wait
        drive.mover.at("window", due, lambda then: self._settle(drive, then, since))

    def bits(self, drive: VirtualDrive) -> int:
        """Return bit 10 for the last set-point taken, bit 12 while one is acknowledged, bit 13: following error."""
        reached = self._reached and (self._target is not None or drive.mover.standing)
        return (
            (REACHED if reached else 0)
            | (BIT_12 if self._acknowledged else 0)
            | (BIT_13 if drive.limits.exceeded else 0)
        )


HANDLERS: dict[int, Callable[[], ModeHandler]] = {
    OperationMode.PP: ProfilePosition,
    OperationMode.VL: VelocityMode,
    OperationMode.PV: ProfileVelocity,
    OperationMode.TQ: Torque,
    OperationMode.HM: Homing,
    OperationMode.IP: InterpolatedPosition,
    OperationMode.CSP: CyclicPosition,
    OperationMode.CSV: CyclicVelocity,
    OperationMode.CST: lambda: Torque(cyclic=True),
    OperationMode.CSTCA: lambda: Torque(cyclic=True),
}
