"""The modes of operation whose set-points come in cycles, and the torque modes (CiA 402-2, 9 and 12 to 15).

The law of this file: set-points are user units, demands are the plant's counts. A set-point makes a new demand only
where it, or a limit that matters to it, changed. A drive whose clock is not the master's looks at the set-point in its
own rhythm instead of when it comes.

An interpolated demand ends when the next set-point is due. A SYNC that is some microseconds late finds the motor at
its end, standing, which says nothing of the motion: from the end on, the velocity is measured as an encoder does, as
the way over the last interpolation time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o
from canopen_control.cia402.options import Reaction
from canopen_control.virtual.handler import BIT_12, BIT_13, REACHED, Following
from canopen_control.virtual.motion import INFINITE, linear_to, ramp_to

if TYPE_CHECKING:
    from canopen_control.virtual.drive import VirtualDrive
    from canopen_control.virtual.motion import Trajectory

__all__ = ["NEW_SET_POINT", "CyclicPosition", "CyclicVelocity", "InterpolatedPosition", "Torque"]

_MS = 1_000_000
NEW_SET_POINT = 1 << 4


class CyclicPosition(Following):
    """CSP: go to the target within 0x60C2, no ramp; bit 12 while it does, bit 13 on a following error."""

    def __init__(self) -> None:
        super().__init__()
        self._demand: Trajectory | None = None

    def update(self, drive: VirtualDrive, now: int) -> None:
        """Take the target; what the drive cannot reach in time is a following error."""
        ppm = drive.node.clock_ppm
        if not ppm:
            self._follow(drive, now)
        elif "interpolate" not in drive.mover.timers:
            self._look(drive, now)

    def _look(self, drive: VirtualDrive, now: int) -> None:
        """Look at the target in the rhythm of a clock that is not the master's."""
        if drive.live and drive.handler is self and drive.node.clock_ppm:
            period = round(drive.interpolation_s * (1e9 - 1e3 * drive.node.clock_ppm)) or _MS
            drive.mover.at("interpolate", now + period, lambda then: self._look(drive, then))
            self._follow(drive, now)

    def _follow(self, drive: VirtualDrive, now: int) -> None:
        """Go to the target within the interpolation time."""
        target = drive.limits.position(drive.zero + self.target(drive) * drive.units.position)
        if not self.changed(target):
            return
        position = drive.mover.state(now)[0]
        seconds, reach = drive.interpolation_s, drive.personality.max_velocity * drive.interpolation_s
        within = max(-reach, min(reach, target - position)) if seconds else target - position
        demand = linear_to(now, position, position + within, seconds)
        self._demand = demand
        drive.mover.run(demand, now)
        drive.left_behind(target - position - within, now)

    def measured_velocity(self, drive: VirtualDrive) -> float:
        """Return the plant's, and after the end of the way to a set-point the mean over the interpolation time."""
        mover, seconds = drive.mover, drive.interpolation_s
        demand = mover.demand
        if not mover.plant.stiff or demand is not self._demand or drive.now < demand.end_ns or not seconds:
            return mover.plant.velocity
        since = max(demand.start_ns, drive.now - round(seconds * 1e9))
        return (mover.plant.position - demand.at(since)[0]) / seconds

    def target(self, drive: VirtualDrive) -> float:
        """Return the set-point in user counts."""
        return float(drive.number(o.TARGET_POSITION) + drive.number(o.POSITION_OFFSET))

    def bits(self, drive: VirtualDrive) -> int:
        """Return bits 12 and 13; bit 10 is reserved."""
        return (BIT_12 if drive.live and not drive.limited else 0) | (BIT_13 if drive.limits.exceeded else 0)


class InterpolatedPosition(CyclicPosition):
    """IP: as CSP with the linear sub mode, from 0x60C1:1, while bit 4 is set."""

    def update(self, drive: VirtualDrive, now: int) -> None:
        """Take the set-point while interpolation is enabled."""
        if drive.controlword & NEW_SET_POINT:
            super().update(drive, now)

    def target(self, drive: VirtualDrive) -> float:
        """Return the data record."""
        return float(drive.number(o.INTERPOLATION_DATA, 1))

    def control(self, drive: VirtualDrive, word: int, previous: int, now: int) -> None:
        """Stop when interpolation is switched off."""
        if previous & ~word & NEW_SET_POINT:
            self._inputs = None
            drive.stop(now, Reaction.SLOW_DOWN_RAMP)

    def bits(self, drive: VirtualDrive) -> int:
        """Return bit 12 while interpolation is active, bit 10 at the set-point."""
        active = drive.controlword & NEW_SET_POINT and drive.live
        reached = drive.mover.demand.end_ns <= drive.now
        return (BIT_12 if active else 0) | (REACHED if reached else 0)


class CyclicVelocity(Following):
    """CSV: take 0x60FF plus its offset at once, as far as 0x60C5 and 0x60C6 let it."""

    def update(self, drive: VirtualDrive, now: int) -> None:
        """Take the target."""
        target = drive.limits.target_velocity()
        unit = drive.units.acceleration
        up = drive.number(o.MAX_ACCELERATION) * unit or INFINITE
        down = drive.number(o.MAX_DECELERATION) * unit or INFINITE
        if self.changed((target, up, down, *drive.limits.bounds())):
            drive.limits.lead(target, up, down, now)

    def bits(self, drive: VirtualDrive) -> int:
        """Return bit 12 while it follows."""
        return BIT_12 if drive.live and not drive.limited else 0


class Torque(Following):
    """TQ and CST: 0x6071 within its limits, along 0x6087 in TQ, at once in CST.

    From a motion the motor keeps its velocity at first.
    """

    def __init__(self, cyclic: bool = False) -> None:
        super().__init__()
        self._cyclic = cyclic

    def update(self, drive: VirtualDrive, now: int) -> None:
        """Take target, limits and slope."""
        target = drive.limits.torque(drive.number(o.TARGET_TORQUE) + drive.number(o.TORQUE_OFFSET))
        slope = INFINITE if self._cyclic else float(drive.number(o.TORQUE_SLOPE)) or INFINITE
        if self.changed((target, slope)):
            present = drive.mover.torque.at(now)[1] if drive.mover.torque is not None else 0.0
            drive.mover.push(ramp_to(now, 0.0, present, target, slope, slope), now)

    def bits(self, drive: VirtualDrive) -> int:
        """Return bit 10 at the target torque (TQ), bit 12 while it follows (CST)."""
        if self._cyclic:
            return BIT_12 if drive.live else 0
        torque = drive.mover.torque
        return REACHED if torque is not None and torque.end_ns <= drive.now else 0
