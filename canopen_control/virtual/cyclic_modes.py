"""The modes of operation whose set-points come in cycles, and the torque modes (CiA 402-2, 9 and 12 to 15).

Set-points are user units, demands are the plant's counts. A set-point makes a new demand only where it, or a limit that
matters to it, changed. A drive whose clock is not the master's looks at the set-point in its own rhythm instead of when
it comes.

An interpolated demand ends when the next set-point is due. A SYNC that is some microseconds late finds the motor at
its end, standing, which says nothing of the motion: from the end on, the velocity is measured as an encoder does, as
the way over the last interpolation time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o
from canopen_control.cia402.options import Reaction
from canopen_control.virtual.mode_base import BIT_12, BIT_13, NEW_SET_POINT, REACHED, FollowingMode
from canopen_control.virtual.trajectory import INFINITE, linear_to, ramp_to

if TYPE_CHECKING:
    from canopen_control.virtual.mode_base import Axis
    from canopen_control.virtual.trajectory import Trajectory

__all__ = ["CyclicPosition", "CyclicVelocity", "InterpolatedPosition", "Torque"]

_MS = 1_000_000


class CyclicPosition(FollowingMode):
    """CSP: go to the target within 0x60C2, no ramp; bit 12 while it does, bit 13 on a following error."""

    def __init__(self, axis: Axis) -> None:
        self._demand: Trajectory | None = None
        self._in_use = False
        super().__init__(axis)

    def reset(self) -> None:
        """Forget the last target; a look at the next one that is under way comes to nothing."""
        super().reset()
        self._in_use = False

    def start(self, now: int) -> None:
        """Go on to the target from the present motion."""
        self._in_use = True
        super().start(now)

    def update(self, now: int) -> None:
        """Take the target; what the drive cannot reach in time is a following error."""
        if not self.clock.drift_ppm.value:
            self._follow(now)
        elif "interpolate" not in self.mover.timers:
            self._look(now)

    def _look(self, now: int) -> None:
        """Look at the target in the rhythm of a clock that is not the master's."""
        ppm = self.clock.drift_ppm.value
        if self.power.live and self._in_use and ppm:
            period = round(self.objects.interpolation_s * (1e9 - 1e3 * ppm)) or _MS
            self.mover.at("interpolate", now + period, self._look)
            self._follow(now)

    def _follow(self, now: int) -> None:
        """Go to the target within the interpolation time."""
        target = self.limits.position(self.units.zero + self.target() * self.units.position)
        if not self.changed(target):
            return
        position, seconds = self.mover.state(now)[0], self.objects.interpolation_s
        reach = self.model.max_velocity * seconds
        within = max(-reach, min(reach, target - position)) if seconds else target - position
        demand = linear_to(now, position, position + within, seconds)
        self._demand = demand
        self.mover.run(demand, now)
        self.limits.judge_following_error(target - position - within, now)

    def measured_velocity(self) -> float:
        """Return the plant's, and after the end of the way to a set-point the mean over the interpolation time."""
        mover, demand = self.mover, self.mover.demand
        if demand is not self._demand or mover.time < demand.end_ns or not mover.plant.stiff:
            return mover.plant.velocity
        seconds = self.objects.interpolation_s
        if not seconds:
            return mover.plant.velocity
        since = max(demand.start_ns, mover.time - round(seconds * 1e9))
        return (mover.plant.position - demand.at(since)[0]) / seconds

    def target(self) -> float:
        """Return the set-point in user counts."""
        return float(self.objects.number(o.TARGET_POSITION) + self.objects.number(o.POSITION_OFFSET))

    def bits(self) -> int:
        """Return bits 12 and 13; bit 10 is reserved."""
        return (BIT_12 if self.power.live and not self.limits.active else 0) | (BIT_13 if self.limits.exceeded else 0)


class InterpolatedPosition(CyclicPosition):
    """IP: as CSP with the linear sub mode, from 0x60C1:1, while bit 4 is set."""

    def update(self, now: int) -> None:
        """Take the set-point while interpolation is enabled."""
        if self.power.controlword & NEW_SET_POINT:
            super().update(now)

    def target(self) -> float:
        """Return the data record."""
        return float(self.objects.number(o.INTERPOLATION_DATA, 1))

    def control(self, word: int, previous: int, now: int) -> None:
        """Stop when interpolation is switched off."""
        if previous & ~word & NEW_SET_POINT:
            self._inputs = None
            self.stop(now, Reaction.SLOW_DOWN_RAMP)

    def bits(self) -> int:
        """Return bit 12 while interpolation is active, bit 10 at the set-point."""
        active = self.power.controlword & NEW_SET_POINT and self.power.live
        reached = self.mover.demand.end_ns <= self.mover.time
        return (BIT_12 if active else 0) | (REACHED if reached else 0)


class CyclicVelocity(FollowingMode):
    """CSV: take 0x60FF plus its offset at once, as far as 0x60C5 and 0x60C6 let it."""

    def update(self, now: int) -> None:
        """Take the target."""
        target = self.limits.target_velocity()
        unit = self.units.acceleration
        up = self.objects.number(o.MAX_ACCELERATION) * unit or INFINITE
        down = self.objects.number(o.MAX_DECELERATION) * unit or INFINITE
        if self.changed((target, up, down, *self.limits.bounds())):
            self.limits.lead(target, up, down, now)

    def bits(self) -> int:
        """Return bit 12 while it follows."""
        return BIT_12 if self.power.live and not self.limits.active else 0


class Torque(FollowingMode):
    """TQ and CST: 0x6071 within its limits, along 0x6087 in TQ, at once in CST.

    From a motion the motor keeps its velocity at first.
    """

    def __init__(self, axis: Axis, *, cyclic: bool = False) -> None:
        super().__init__(axis)
        self._cyclic = cyclic

    def update(self, now: int) -> None:
        """Take target, limits and slope."""
        target = self.limits.torque(self.objects.number(o.TARGET_TORQUE) + self.objects.number(o.TORQUE_OFFSET))
        slope = INFINITE if self._cyclic else float(self.objects.number(o.TORQUE_SLOPE)) or INFINITE
        if self.changed((target, slope)):
            present = self.mover.torque.at(now)[1] if self.mover.torque is not None else 0.0
            self.mover.push(ramp_to(now, 0.0, present, target, slope, slope), now)

    def bits(self) -> int:
        """Return bit 10 at the target torque (TQ), bit 12 while it follows (CST)."""
        if self._cyclic:
            return BIT_12 if self.power.live else 0
        torque = self.mover.torque
        return REACHED if torque is not None and torque.end_ns <= self.mover.time else 0
