"""Base classes of the modes of operation of one axis, and statistics of the set-points.

A mode acts only while the power state machine is `live`. `update` is called after every write that may affect the
mode, and makes a new demand only if an input of the mode changed. `control` gets the present and the previous
controlword, `arrived` is called at the end of a demand, and `bits` returns bits 10, 12 and 13 of the statusword.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o
from canopen_control.cia402.objects import Reaction
from canopen_control.rpc.messages.drive import SetPointQuality, Spread
from canopen_control.virtual.trajectory import INFINITE, ramp_to

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.virtual.axis_motion import AxisMotion, AxisObjects
    from canopen_control.virtual.device_model import DeviceModel
    from canopen_control.virtual.node_outbox import NodeClock, NodeOutbox
    from canopen_control.virtual.power_machine import DriveLimits, PowerMachine
    from canopen_control.virtual.trajectory import DemandCurve

    SetPointFilter = Callable[[int, int, int], bool]


# Set-point quality of one axis: acceleration ripple, missed and doubled set-points, phase of RPDOs against SYNC.
#
# These are the values that a drive's own monitoring would show in a cyclic mode. The demand is sampled on a grid of
# 0.5 ms, as in a position loop: its first differences are the velocity, its second differences the acceleration. The
# samples are computed when the demand changes, never in between, and only sums are kept: measuring allocates nothing
# and needs no timer. A standstill gives no information on set-points and counts only if the motion continues within
# 100 ms. Positions are in plant counts, set-points in user units, and times in monotonic nanoseconds.


GRID_NS = 500_000
REST_NS = 100_000_000
_REST_POINTS = REST_NS // GRID_NS
_GAP_NS = 1_000_000_000  # after this time without a sample a new motion begins
_SMALLEST_STEP = 2  # in units of the set-points: a slower motion repeats set-points by rounding
_MILLI = 1e-6  # relative rounding error of the sums


class _Sums:
    __slots__ = ("count", "high", "low", "magnitudes", "squares", "total")

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        self.count = 0
        self.total = self.magnitudes = self.squares = 0.0
        self.low, self.high = math.inf, -math.inf

    def add(self, value: float, times: int = 1) -> None:
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
        return self.total / self.count

    @property
    def deviation(self) -> float:
        """Standard deviation of the values; 0 if below the rounding error of the sums."""
        variance = self.squares / self.count - self.mean * self.mean
        return math.sqrt(variance) if variance > _MILLI * _MILLI * self.squares / self.count else 0.0

    def spread(self, unit: float) -> Spread:
        """Return minimum, mean and maximum, each multiplied by `unit`, which may be negative."""
        ends = self.low * unit, self.high * unit
        return Spread(min(ends), self.mean * unit, max(ends))


class SetpointStatistics:
    """Statistics of the set-points of one axis in the cyclic modes.

    `used` is set when a cyclic mode first starts. The modes themselves count `missed` and `overwritten`.
    """

    __slots__ = (
        "_accelerations",
        "_distance",
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
        """Clear all counts and samples; `used` is unchanged."""
        self.taken = self.missed = self.doubled = self.overwritten = 0
        for sums in (self._velocities, self._accelerations, self._phases):
            sums.clear()
        self._set_point: float | None = None
        self._step = 0.0  # step of the set-points at their last change
        self._moved_ns = self._repeats = 0
        self.pause()

    # -- set-points

    def received(self, after_sync_ns: int) -> None:
        """Record that a set-point arrived `after_sync_ns` after a SYNC."""
        self._phases.add(after_sync_ns * 1e-3)

    def take(self, set_point: float | None, now: int) -> None:
        """Count a set-point, and compare it with the previous one to find repetitions; None is only counted."""
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
        """End the measured motion; the next demand starts a new measurement."""
        self._grid = self._points = self._resting = 0
        self._position = self._distance = 0.0

    def follow(self, demand: DemandCurve, now: int) -> None:
        """Sample the active demand every 0.5 ms, from the last sample to `now`."""
        grid = self._grid
        if not grid or now - grid > _GAP_NS:
            self.pause()
            grid = (now // GRID_NS + 1) * GRID_NS
        while grid <= now:
            self._sample(demand.at(grid)[0])
            end = demand.steady_until(grid)
            points = ((now if end is None else min(end, now)) - grid) // GRID_NS
            if points > 1:  # at constant velocity all further points have the same distance
                self._sample(demand.at(grid + GRID_NS)[0])
                self._record_evenly(demand.at(grid + points * GRID_NS)[0], points - 1)
                grid += points * GRID_NS
            grid += GRID_NS
        self._grid = grid

    def _sample(self, position: float) -> None:
        """Record the demanded position at the next sampling time."""
        distance, self._position = position - self._position, position
        self._points += 1
        if self._points == 1:  # the first point has no distance
            return
        change, self._distance = distance - self._distance, distance
        if distance == 0.0:
            self._resting += 1
        elif self._resting <= _REST_POINTS:
            self._record_step(distance)
        else:
            self._resting = 0
            self._velocities.add(distance)
        if self._points > 2 and (distance or change):
            self._accelerations.add(change)

    def _record_evenly(self, position: float, points: int) -> None:
        """Record `points` further samples at constant velocity, the last one at `position`."""
        self._position = position
        self._points += points
        if self._distance == 0.0:
            self._resting += points
        else:
            self._velocities.add(self._distance, points)
            self._accelerations.add(0.0, points)

    def _record_step(self, distance: float) -> None:
        """Record a step of the motion; a short standstill before it is attributed to a late set-point."""
        if self._resting and self._velocities.count:
            self._velocities.add(0.0, self._resting)
            if self._resting > 1:  # the acceleration at the first point of the standstill is counted already
                self._accelerations.add(0.0, self._resting - 1)
        self._resting = 0
        self._velocities.add(distance)

    # -- results

    def quality(self, velocity_unit: float) -> SetPointQuality | None:
        """Return the statistics, or None if no cyclic mode was used; `velocity_unit` is in counts/s."""
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


REACHED, BIT_12, BIT_13 = 1 << 10, 1 << 12, 1 << 13
NEW_SET_POINT = 1 << 4  # bit of the controlword; HM and IP use it as well


class AxisParts:
    """Parts of one axis that the modes of operation use."""

    __slots__ = ("clock", "limits", "meter", "mover", "objects", "outbox", "power")

    def __init__(
        self,
        objects: AxisObjects,
        mover: AxisMotion,
        power: PowerMachine,
        limits: DriveLimits,
        outbox: NodeOutbox,
        clock: NodeClock,
        meter: SetpointStatistics,
    ) -> None:
        self.objects, self.mover, self.power, self.limits = objects, mover, power, limits
        self.outbox, self.clock, self.meter = outbox, clock, meter


class Mode:
    """Base class of all modes of operation; this class itself is "no mode" (0) and stops the axis.

    `set_point` is the index of the object whose values in RPDOs are set-points; 0 if RPDOs carry no set-points.
    """

    set_point = 0

    def __init__(self, axis: AxisParts) -> None:
        self.objects, self.units, self.model = axis.objects, axis.objects.units, axis.objects.model
        self.mover, self.power, self.limits = axis.mover, axis.power, axis.limits
        self.outbox, self.clock, self.meter = axis.outbox, axis.clock, axis.meter
        self.reset()

    def set_model(self, model: DeviceModel) -> None:
        """Replace the device model."""
        self.model = model

    def reset(self) -> None:
        """Discard the state of the mode when the axis is disabled or changes to another mode."""

    def start(self, now: int) -> None:
        """Start the mode in OPERATION ENABLED from the current motion; also called at the end of a halt."""
        self.stop(now, Reaction.SLOW_DOWN_RAMP)

    def stop(self, now: int, reaction: Reaction) -> None:
        """Stop the motor with the ramp of `reaction`, or at once if the reaction has no ramp."""
        position, velocity = self.mover.state(now)
        deceleration = INFINITE
        if reaction is Reaction.SLOW_DOWN_RAMP:
            deceleration = self.deceleration()
        elif reaction is Reaction.QUICK_STOP_RAMP:
            deceleration = self.quick_stop_deceleration()
        self.mover.run(ramp_to(now, position, velocity, 0.0, 0.0, deceleration), now)

    def update(self, now: int) -> None:
        """Apply changed set-points."""

    def take(self, now: int) -> None:
        """Apply the set-point in an RPDO, which may equal the previous one."""
        self.update(now)

    def count_missed(self) -> None:
        """Count a SYNC before which no set-point arrived."""

    def control(self, word: int, previous: int, now: int) -> None:
        """Apply the mode-specific bits of the controlword."""

    def control_unpowered(self, word: int, previous: int, now: int) -> None:
        """Apply the mode-specific bits of the controlword while the motor has no power."""

    def arrived(self, now: int) -> None:
        """Continue the mode when a demand has ended."""

    def bits(self) -> int:
        """Return bits 10, 12 and 13 of the statusword; in no mode (0), bit 10 at standstill."""
        return REACHED if self.mover.at_standstill else 0

    def unpowered_bits(self) -> int:
        """Return bits 10, 12 and 13 of the statusword outside OPERATION ENABLED."""
        return 0

    def measured_velocity(self) -> float:
        """Return the velocity measured by the drive, in counts/s."""
        return self.mover.plant.velocity

    def deceleration(self) -> float:
        """Return the slow-down ramp in counts/s^2, from 0x6084."""
        return self.objects.ramp(o.PROFILE_DECELERATION)

    def quick_stop_deceleration(self) -> float:
        """Return the quick-stop ramp in counts/s^2, from 0x6085."""
        return self.objects.ramp(o.QUICK_STOP_DECELERATION)

    def can_halt(self) -> bool:
        """Whether the halt bit (bit 8) of the controlword has an effect."""
        return True


class ModeGate:
    """Gate that blocks the set-points of an axis while `closed_by` is not empty.

    `brake_ns` is the time after an enable for which the brake keeps the gate closed.
    A controlword is passed to the mode only if every filter in `takes` returns True; a filter gets the controlword,
    the previous controlword and the time in ns.
    """

    def __init__(self) -> None:
        self.closed_by: set[str] = set()
        self.brake_ns = 0
        self.takes: list[SetPointFilter] = []


class FollowingMode(Mode):
    """Base class of modes that follow a target without a handshake; `update` acts only on changed inputs."""

    def reset(self) -> None:
        self._inputs: object = None
        self._applied: tuple[int, float] | None = None  # version of the values, and zero, of the last update

    def start(self, now: int) -> None:
        self._inputs = None
        if self.power.live:
            self.update(now)

    def inputs_may_change(self) -> bool:
        """Whether inputs may have changed since the last call; always True with wired limit switches."""
        present = None if self.mover.switches.wired else (self.objects.store.version, self.units.zero)
        before, self._applied = self._applied, present
        return present is None or present != before or self._inputs is None

    def changed(self, inputs: object) -> bool:
        """Store `inputs` (target and limits); return whether they differ from the previous inputs."""
        differs, self._inputs = inputs != self._inputs, inputs
        return differs
