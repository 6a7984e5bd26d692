"""The modes of operation whose set-points come in cycles, and the torque modes (CiA 402-2, 9 and 12 to 15).

Set-points are user units, demands are the plant's counts. A set-point makes a new demand where it, or a limit that
matters to it, changed, and where it comes while the drive goes on without one. A drive whose clock is not the master's
looks at the set-point in its own rhythm instead of when it comes, unless it follows the SYNC.

A position is gone to with constant velocity within the interpolation time 0x60C2 from where the demand is; 0 takes it
at once. An interpolated demand ends when the next set-point is due, or goes on for as long as the device model
extrapolates. A drive that recovers the rhythm of SYNC (`sync_rhythm`) is to be there when the next SYNC is due and not
one interpolation time after this one came, and goes on to where a SYNC as late as those before would find it.

A SYNC that is some microseconds late finds the motor at its end, standing, which says nothing of the motion: from the
end on, the velocity is measured as an encoder does, as the way over the last interpolation time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o
from canopen_control.virtual.mode_base import BIT_12, BIT_13, REACHED
from canopen_control.virtual.set_point_stream import StreamMode
from canopen_control.virtual.trajectory import INFINITE, linear_to, ramp_to

if TYPE_CHECKING:
    from canopen_control.virtual.mode_base import Axis
    from canopen_control.virtual.trajectory import Trajectory

__all__ = ["CyclicPosition", "CyclicVelocity", "Torque"]

_MS = 1_000_000


class CyclicPosition(StreamMode):
    """CSP: go to the target within 0x60C2, no ramp; bit 12 while it does, bit 13 on a following error."""

    set_point = o.TARGET_POSITION

    def __init__(self, axis: Axis) -> None:
        self._demand: Trajectory | None = None
        self._in_use = False
        super().__init__(axis)

    def reset(self) -> None:
        """Forget the last target; a look at the next one that is under way comes to nothing."""
        super().reset()
        self._in_use = False
        self._unseen = 0  # set-points since the last look in the drive's own rhythm

    def start(self, now: int) -> None:
        """Go on to the target from the present motion."""
        self._in_use = True
        super().start(now)

    def take(self, now: int) -> None:
        """Take the set-point, from the present demand also where it is the one before."""
        self._unseen += 1
        if not self._drifts and (self.cycles or self._in_rhythm(now)):
            self._inputs = None
        super().take(now)

    def compared(self) -> float | None:
        """Return the position."""
        return self.target()

    def missed(self) -> None:
        """Count a SYNC without a set-point; in a rhythm of its own the drive finds out by itself."""
        if not self._drifts:
            super().missed()

    def update(self, now: int) -> None:
        """Take the target; what the drive cannot reach in time is a following error."""
        if not self._drifts:
            self._follow(now)
        elif "interpolate" not in self.mover.timers:
            self._look(now)

    @property
    def _drifts(self) -> bool:
        """Whether the drive's rhythm is not the master's: its clock drifts, and it follows no SYNC."""
        locked = self.model.follows_sync and self.clock.sync_ns is not None
        return bool(self.clock.drift_ppm.value) and not locked

    def _look(self, now: int) -> None:
        """Look at the target in the rhythm of a clock that is not the master's."""
        ppm = self.clock.drift_ppm.value
        if self.power.live and self._in_use and self._drifts:
            period = round(self.objects.interpolation_s * (1e9 - 1e3 * ppm)) or _MS
            self.mover.at("interpolate", now + period, self._look)
            self._count_unseen()
            self._follow(now)

    def _count_unseen(self) -> None:
        """Count what the drift does: no set-point since the last look, or one that nobody looked at."""
        unseen, self._unseen = self._unseen, 0
        if unseen and self.cycles:
            self._inputs = None
        if self.streaming:
            self.meter.missed += not unseen
            self.meter.overwritten += max(0, unseen - 1)

    def _follow(self, now: int) -> None:
        self.feed()
        self.go(self.target(), now)

    def go(self, place: float, now: int) -> None:
        """Go to a place in user counts within the interpolation time, where it changed."""
        target = self.limits.position(self.units.zero + place * self.units.position)
        if not self.changed(target):
            return
        position, seconds = self.mover.state(now)[0], self.objects.interpolation_s
        slack = 0.0
        if self._in_rhythm(now):
            seconds, slack = seconds - self.clock.rhythm.late_ns * 1e-9, self.clock.rhythm.slack_ns * 1e-9
        reach = self.model.max_velocity * seconds
        within = max(-reach, min(reach, target - position)) if seconds else target - position
        onward = self._onward(position + within, within / seconds, slack) if seconds and self.streaming else 0.0
        demand = linear_to(now, position, position + within, seconds, onward)
        self._demand = demand
        self.meter.follow(self.mover.demand, now)
        self.mover.run(demand, now)
        self.limits.judge_following_error(target - position - within, now)

    def _in_rhythm(self, now: int) -> bool:
        """Whether a set-point that came with a SYNC just now is timed by the rhythm of SYNC."""
        clock = self.clock
        timed = self.model.recovers_sync and clock.sync_ns == now and self.streaming
        return timed and clock.rhythm.has_period(self.objects.interpolation_s)

    def _onward(self, place: float, velocity: float, slack: float) -> float:
        """Return for how many seconds the demand goes on beyond its set-point, at most to a limit; or for `slack`."""
        longest = max(self.cycles * self.objects.interpolation_s, slack)
        if not longest or not velocity:
            return 0.0
        low, high = self.limits.bounds()
        way = high - place if velocity > 0.0 else low - place
        return max(0.0, min(longest, way / velocity))

    def measured_velocity(self) -> float:
        """Return the plant's, and after the end of the way to a set-point the mean over the interpolation time."""
        mover, demand = self.mover, self.mover.demand
        if demand is not self._demand or mover.time < demand.end_ns or not mover.plant.stiff:
            return mover.plant.velocity
        seconds = self.objects.interpolation_s
        if not seconds:
            return mover.plant.velocity
        since = max(demand.start_ns, mover.time - round(seconds * 1e9))
        return (mover.plant.position - demand.at(since)[0]) / ((mover.time - since) * 1e-9)

    def target(self) -> float:
        """Return the set-point in user counts."""
        return float(self.objects.number(o.TARGET_POSITION) + self.objects.number(o.POSITION_OFFSET))

    def bits(self) -> int:
        """Return bits 12 and 13; bit 10 is reserved."""
        return (BIT_12 if self.power.live and not self.limits.active else 0) | (BIT_13 if self.limits.exceeded else 0)


class CyclicVelocity(StreamMode):
    """CSV: take 0x60FF plus its offset at once, as far as 0x60C5 and 0x60C6 let it; without a new one it goes on."""

    set_point = o.TARGET_VELOCITY

    def update(self, now: int) -> None:
        """Take the target."""
        target = self.limits.target_velocity()
        unit = self.units.acceleration
        up = self.objects.number(o.MAX_ACCELERATION) * unit or INFINITE
        down = self.objects.number(o.MAX_DECELERATION) * unit or INFINITE
        self.mover.feed_forward(0.0, float(self.objects.number(o.TORQUE_OFFSET)))
        self.meter.follow(self.mover.demand, now)
        if self.changed((target, up, down, *self.limits.bounds())):
            self.limits.lead(target, up, down, now)

    def bits(self) -> int:
        """Return bit 12 while it follows."""
        return BIT_12 if self.power.live and not self.limits.active else 0


class Torque(StreamMode):
    """TQ and CST: 0x6071 within its limits, along 0x6087 in TQ, at once in CST.

    From a motion the motor keeps its velocity at first.
    """

    def __init__(self, axis: Axis, *, cyclic: bool = False) -> None:
        super().__init__(axis)
        self._cyclic = cyclic
        self.set_point = o.TARGET_TORQUE if cyclic else 0

    def start(self, now: int) -> None:
        """Go on to the target; what TQ does is no stream and is not measured."""
        self._begun = self._begun or not self._cyclic
        super().start(now)

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
