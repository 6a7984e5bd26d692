"""Tracking error, feed-forward, and trapezoidal profile of a joint.

A position measured at a SYNC is compared with the set-point that was due at that SYNC, not with the newest one: a drive
uses a set-point from the SYNC after the RPDO on and reaches it one period later (0x60C2), so that the error of a drive
that follows exactly is 0, independent of the bus delay. No memory is allocated; a step is a few operations with floats.
Errors are in rad or rad/s (m or m/s).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.cia402.units import INT16_MAX, INT16_MIN, INT32_MAX, INT32_MIN, to_object
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.hardware.interfaces import CommandInterface


# Feed-forward of velocity (0x60B1) and torque (0x60B2) in addition to the positions of CSP (CiA 402-2).
#
# The controller of the position also commands the offsets, in the units of 0x60FF and 0x6071, within the drive's
# limits; the drive adds them in its velocity and torque loops and never to the position. The offsets are zero unless
# they belong to a moving position: at standstill, in a stop, in another mode, if another controller commands them, and
# if the positions do not change for three cycles and 50 ms, since the offsets of an interrupted stream would work
# against the position loop.


FEED_FORWARD: Final = (VELOCITY, EFFORT)
"""Command interfaces that can be claimed together with a position."""
_BROKEN_S: Final = 0.05
_BROKEN_CYCLES: Final = 3.5


class FeedForward:
    """Feed-forward offsets of one axis; `fed` while a controller claims at least one offset."""

    def __init__(self, axis: AxisProcessData, commands: Mapping[str, CommandInterface]) -> None:
        self.fed = False
        self._foreign, self._reported = "", ""
        self._axis, self._commands = axis, commands
        self._outputs = {VELOCITY: axis.velocity_offset, EFFORT: axis.torque_offset}
        self._velocity: CommandInterface | None = None
        self._effort: CommandInterface | None = None
        self._last = math.nan
        self._standing_s = 0.0

    def claim(self, interfaces: Collection[str]) -> None:
        """Send the offsets of these command interfaces from now on; set all other offsets to zero."""
        self._velocity = self._commands[VELOCITY] if VELOCITY in interfaces else None
        self._effort = self._commands[EFFORT] if EFFORT in interfaces else None
        self.fed = bool(interfaces)
        self._foreign = self._reported = ""
        self.refresh()
        self.zero()

    def refresh(self) -> None:
        """Update the ranges of the claimed offsets after a scale change."""
        scale = self._axis.scale
        if self._velocity is not None:
            _span(self._velocity, INT32_MAX / abs(scale.vel_to_dev))
        if self._effort is not None:
            _span(self._effort, INT16_MAX / abs(scale.eff_to_dev))

    def refused(self) -> str | None:
        """Return a text once if another controller commands an offset, which is then not sent; else None."""
        if self._foreign == self._reported:
            return None
        self._reported = interface = self._foreign
        position, other_owner = self._commands[POSITION].owner, self._commands[interface].owner
        return (
            f"its {interface} is commanded by {other_owner} but its position by {position}, so the feed-forward "
            f"is not sent; deactivate {other_owner}"
        )

    def zero(self) -> None:
        self._last, self._standing_s = math.nan, 0.0
        for output in self._outputs.values():
            if output is not None:
                output.set(0)

    def follow(self, position: CommandInterface, period: float) -> None:
        """Send the offsets for this cycle's position; `period` is in s."""
        value = position.value
        if value != self._last:
            self._last, self._standing_s = value, 0.0
        else:
            self._standing_s += period
        broken = value != value or self._standing_s > max(_BROKEN_S, _BROKEN_CYCLES * period)
        axis = self._axis
        velocity, effort = self._velocity, self._effort
        if velocity is not None and axis.velocity_offset is not None:
            raw = 0 if broken else self._raw(position, velocity, axis.scale.vel_to_dev, INT32_MIN, INT32_MAX)
            axis.velocity_offset.set(axis.limits.of_velocity(raw))
        if effort is not None and axis.torque_offset is not None:
            raw = 0 if broken else self._raw(position, effort, axis.scale.eff_to_dev, INT16_MIN, INT16_MAX)
            axis.torque_offset.set(axis.limits.of_torque(raw))

    def _raw(self, position: CommandInterface, command: CommandInterface, factor: float, low: int, high: int) -> int:
        if command.owner != position.owner:
            self._foreign = command.interface
            return 0
        return to_object(command.value * factor, low, high) or 0


def _span(command: CommandInterface, most: float) -> None:
    command.lowest, command.highest, command.range = -most, most, None


# Trapezoidal position profile for modes in which the drive computes no profile: one step per cycle.
#
# A set-point of a trajectory is for the present cycle; a TARGET is a final position, which a drive in CSP or IP must
# not get at once.
#
# A profile begins with the present speed, ends at standstill, and is never faster than `most`. The acceleration is at
# most `rise`, also towards a new target behind the axis, and the deceleration begins as late as `rise` permits. The
# units are counts, counts/s and counts/s^2; no memory is allocated. A stop during the profile ends the steps and calls
# `rest`.


_MIN: Final = 1  # counts per cycle: the slowest motion


class TrapezoidalProfile:
    """Trapezoidal profile of one axis; `speed` is signed, in counts/s; `limited` if a limit is finite."""

    __slots__ = ("_max", "_rise", "limited", "speed")

    def __init__(self) -> None:
        self.speed = 0.0
        self.limit(math.inf, math.inf)

    def limit(self, most: float, rise: float) -> None:
        """Set the maximum speed and the maximum acceleration from the next step on."""
        self._max, self._rise = most, rise
        self.limited = most < math.inf or rise < math.inf

    def rest(self) -> None:
        """Start the next motion from standstill."""
        self.speed = 0.0

    def step(self, way: int, period: float, largest: float = math.inf) -> int:
        """Return the counts to move in a cycle of `period` s towards a target at the distance `way` in counts.

        `largest` is a further speed limit. A step is at least one count, so that the motion ends.
        """
        side, far = (1 if way >= 0 else -1), abs(way)
        speed = min(self._max, largest, self.speed * side + self._rise * period, math.sqrt(2 * self._rise * far))
        step = min(far, max(_MIN, round(speed * period))) if speed >= 0 else round(speed * period)
        self.speed = speed * side if step != far else 0.0
        return step * side


WINDOW_S: Final = 5.0
"""Length of a window in s; the figures cover the current, incomplete window and the previous one."""
_PAUSE: Final = 3  # up to this number of equal set-points is a repetition, more are a standstill
_NAN: Final = math.nan


class TrackingFigures(NamedTuple):
    """Maximum and RMS tracking error, recent and since the joint was enabled, and counts of irregular set-points."""

    window_s: float
    worst: float
    rms: float
    worst_since_enable: float
    rms_since_enable: float
    repeated: int
    skipped: int


class Tracking:
    """Tracking statistics of one joint; `interface` is the compared quantity, or "".

    Positions that are equal in consecutive cycles while the joint moves are counted in `repeated`; velocities are
    not counted. `skipped` counts the cycles without a set-point.
    """

    __slots__ = (
        "_count",
        "_factor",
        "_first",
        "_full",
        "_late",
        "_period_s",
        "_positions",
        "_previous_count",
        "_previous_sum",
        "_previous_worst",
        "_second",
        "_still",
        "_sum",
        "_third",
        "_total_count",
        "_total_sum",
        "_total_worst",
        "_worst",
        "interface",
        "repeated",
        "skipped",
    )

    def __init__(self) -> None:
        self.interface = ""
        self._positions = False
        self.pace(0.01)
        self.begin()

    def pace(self, period_s: float, *, late: bool = False, factor: float = 1.0) -> None:
        """Set the cycle time in s, and the factor from actuator errors to joint errors.

        `late` means that a set-point is compared three cycles later instead of two, because SYNC is sent before the
        RPDOs.
        """
        self._period_s, self._late, self._factor = period_s, late, abs(factor)
        self._full = max(1, round(WINDOW_S / period_s))

    def begin(self) -> None:
        """Clear all statistics when the joint is enabled."""
        self.repeated = self.skipped = 0
        self._worst = self._sum = self._previous_worst = self._previous_sum = self._total_worst = self._total_sum = 0.0
        self._count = self._previous_count = self._total_count = 0
        self.restart()

    def restart(self) -> None:
        """Discard the previous set-points, but keep the statistics, after standstill or a mode change."""
        self._first = self._second = self._third = _NAN
        self._still = _PAUSE + 1

    def compare(self, interface: str, *, positions: bool) -> None:
        """Select the compared interface, or ""; `positions` enables the count of repeated set-points."""
        self.interface, self._positions = interface, positions
        self.restart()

    def step(self, target: float, actual: float) -> None:
        """Add the set-point of this cycle and the last measured value; each may be nan (unknown)."""
        last = self._first
        # no tracking error, as in the previous cycles
        if target == actual and target == last == self._second == self._third:
            self._count += 1
            self._still += 1
            if self._count >= self._full:
                self._start_window()
            return
        error = (self._third if self._late else self._second) - actual
        self._third, self._second, self._first = self._second, last, target
        if error < 0.0:
            error = -error
        if error >= 0.0:  # False for nan
            if error > self._worst:
                self._worst = error
            self._sum += error * error
            self._count += 1
            if self._count >= self._full:
                self._start_window()
        if target == last:
            self._still += 1
        elif self._still:
            if self._still <= _PAUSE and self._positions:
                self.repeated += self._still
            self._still = 0

    def skip(self, edges: int) -> None:
        """Count missed set-points while the joint moves."""
        if self.moving:
            self.skipped += edges

    @property
    def moving(self) -> bool:
        """Whether the joint is currently commanded to move."""
        return self._still <= _PAUSE if self._positions else self._first != 0.0 and self._first == self._first

    def figures(self) -> TrackingFigures | None:
        """Return the statistics, or None without samples since the joint was enabled."""
        total = self._total_count + self._count
        if not total:
            return None
        count, factor = self._previous_count + self._count, self._factor
        return TrackingFigures(
            count * self._period_s,
            factor * max(self._previous_worst, self._worst),
            factor * math.sqrt((self._previous_sum + self._sum) / count),
            factor * max(self._total_worst, self._worst),
            factor * math.sqrt((self._total_sum + self._sum) / total),
            self.repeated,
            self.skipped,
        )

    def _start_window(self) -> None:
        """Close the current window and start the next."""
        self._previous_worst, self._previous_sum, self._previous_count = self._worst, self._sum, self._count
        self._total_worst = max(self._total_worst, self._worst)
        self._total_sum += self._sum
        self._total_count += self._count
        self._worst = self._sum = 0.0
        self._count = 0
