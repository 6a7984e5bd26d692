"""Set-point quality of one axis: acceleration ripple, missed and doubled set-points, phase of RPDOs against SYNC.

What a drive's own monitoring would show of a cyclic mode. The demand is looked at on a grid of 0.5 ms, as a position
loop does: its first differences are the velocity, its second ones the acceleration. It is walked when something happens
to the demand, never in between, and what is kept are sums: measuring allocates nothing and needs no timer. An axis that
rests says nothing of its set-points: a standstill counts only where the motion goes on within 100 ms. Positions are the
plant's counts, set-points user units, times monotonic nanoseconds.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.rpc.messages.drive import SetPointQuality, Spread

if TYPE_CHECKING:
    from canopen_control.virtual.trajectory import Trajectory

__all__ = ["GRID_NS", "REST_NS", "SetPointMeter"]

GRID_NS = 500_000
REST_NS = 100_000_000
_REST_POINTS = REST_NS // GRID_NS
_GAP_NS = 1_000_000_000  # without a look at the demand: another motion
_SMALLEST_STEP = 2  # of set-points, in their unit: a slower motion repeats them by rounding
_MILLI = 1e-6  # of what is left of sums by rounding


class _Sums:
    """Count, extremes, sum, sum of magnitudes and of squares of values."""

    __slots__ = ("count", "high", "low", "magnitudes", "squares", "total")

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Begin anew."""
        self.count = 0
        self.total = self.magnitudes = self.squares = 0.0
        self.low, self.high = math.inf, -math.inf

    def add(self, value: float, times: int = 1) -> None:
        """Take a value."""
        self.count += times
        self.total += value * times
        self.magnitudes += abs(value) * times
        self.squares += value * value * times
        if value < self.low:
            self.low = value
        if value > self.high:
            self.high = value

    @property
    def mean(self) -> float:
        """The mean of what was taken."""
        return self.total / self.count

    @property
    def deviation(self) -> float:
        """The standard deviation; 0 where it is less than the rounding of the sums."""
        variance = self.squares / self.count - self.mean * self.mean
        return math.sqrt(variance) if variance > _MILLI * _MILLI * self.squares / self.count else 0.0

    def spread(self, unit: float) -> Spread:
        """Return extremes and mean, times `unit`, which may turn them round."""
        ends = self.low * unit, self.high * unit
        return Spread(min(ends), self.mean * unit, max(ends))


class SetPointMeter:
    """Counts and measures; `used`: there was something to. `missed` and `overwritten` are counted by others."""

    __slots__ = (
        "_accelerations",
        "_grid",
        "_moved_ns",
        "_phases",
        "_points",
        "_position",
        "_repeats",
        "_resting",
        "_set_point",
        "_step",
        "_velocities",
        "_way",
        "doubled",
        "missed",
        "overwritten",
        "taken",
        "used",
    )

    def __init__(self) -> None:
        self.used = False
        self._velocities, self._accelerations, self._phases = _Sums(), _Sums(), _Sums()
        self.restart()

    def restart(self) -> None:
        """Forget everything."""
        self.taken = self.missed = self.doubled = self.overwritten = 0
        for sums in (self._velocities, self._accelerations, self._phases):
            sums.clear()
        self._set_point: float | None = None
        self._step = 0.0  # of the set-points, when they last changed
        self._moved_ns = self._repeats = 0
        self.pause()

    # -- set-points

    def received(self, after_sync_ns: int) -> None:
        """Note when after a SYNC the RPDO with a set-point arrived."""
        self._phases.add(after_sync_ns * 1e-3)

    def take(self, set_point: float | None, now: int) -> None:
        """Count a set-point; a position is compared with the one before, None is not."""
        self.taken += 1
        if set_point is None:
            return
        before, self._set_point = self._set_point, set_point
        if before is None:
            return
        if set_point == before:
            self._repeats += 1
            return
        step = set_point - before
        if self._repeats and now - self._moved_ns <= REST_NS and self._step * step > 0.0:
            self.doubled += self._repeats if abs(self._step) >= _SMALLEST_STEP else 0
        self._step, self._repeats, self._moved_ns = step, 0, now

    # -- the demand

    def pause(self) -> None:
        """End the motion that is measured: the next demand does not go on from it."""
        self._grid = self._points = self._resting = 0
        self._position = self._way = 0.0

    def follow(self, demand: Trajectory, now: int) -> None:
        """Walk over `demand`, which was in force until now."""
        grid = self._grid
        if not grid or now - grid > _GAP_NS:
            self.pause()
            grid = (now // GRID_NS + 1) * GRID_NS
        while grid <= now:
            self._look(demand.at(grid)[0])
            end = demand.steady_until(grid)
            points = ((now if end is None else min(end, now)) - grid) // GRID_NS
            if points > 1:  # the way to the next point is that of all others
                self._look(demand.at(grid + GRID_NS)[0])
                self._go_on_evenly(demand.at(grid + points * GRID_NS)[0], points - 1)
                grid += points * GRID_NS
            grid += GRID_NS
        self._grid = grid

    def _look(self, position: float) -> None:
        """Take the demanded position at the next point of the grid."""
        way, self._position = position - self._position, position
        self._points += 1
        if self._points == 1:  # the first point has no way
            return
        change, self._way = way - self._way, way
        if way == 0.0:
            self._resting += 1
        elif self._resting <= _REST_POINTS:
            self._goes_on(way)
        else:
            self._resting = 0
            self._velocities.add(way)
        if self._points > 2 and (way or change):
            self._accelerations.add(change)

    def _go_on_evenly(self, position: float, points: int) -> None:
        """Take so many points up to a position, each with the way of the one before."""
        self._position = position
        self._points += points
        if self._way == 0.0:
            self._resting += points
        else:
            self._velocities.add(self._way, points)
            self._accelerations.add(0.0, points)

    def _goes_on(self, way: float) -> None:
        """Count the standstill that was none, if there was one, and the way after it."""
        if self._resting and self._velocities.count:
            self._velocities.add(0.0, self._resting)
            if self._resting > 1:  # the first point of it had an acceleration, and was counted
                self._accelerations.add(0.0, self._resting - 1)
        self._resting = 0
        self._velocities.add(way)

    # -- for people

    def tell(self, velocity_unit: float) -> SetPointQuality | None:
        """Return what was found, in units of which one has `velocity_unit` counts; None: no cyclic mode so far."""
        if not self.used:
            return None
        velocities, accelerations = self._velocities, self._accelerations
        per_second = 1e9 / GRID_NS / velocity_unit
        speed = velocities.magnitudes / velocities.count if velocities.count else 0.0
        change = accelerations.deviation if accelerations.count else None
        return SetPointQuality(
            taken=self.taken,
            missed=self.missed,
            doubled=self.doubled,
            overwritten=self.overwritten,
            velocity=velocities.spread(per_second) if velocities.count else None,
            velocity_ripple=velocities.deviation / speed if speed else None,
            acceleration=None if change is None else change * abs(per_second) * 1e9 / GRID_NS,
            acceleration_ripple=change / speed if change is not None and speed else None,
            phase_us=self._phases.spread(1.0) if self._phases.count else None,
        )
