"""Tracking of a joint: its error, and repeated or skipped set-points.

What a drive measures at a SYNC is compared with the set-point that it was to have reached then,
not with the newest one: it takes a set-point with the SYNC after the RPDO and arrives a period later (0x60C2), so that
the error of a drive that follows exactly is 0, whatever the bus takes. Nothing is allocated; a step is a few floats.
Errors are in rad or rad/s (m or m/s).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

WINDOW_S: Final = 5.0
"""The figures are of the newest window, which is not full, and the one before it."""
_PAUSE: Final = 3  # so many equal set-points at most are a repetition, more of them a standstill
_NAN: Final = math.nan


class TrackingFigures(NamedTuple):
    """Maximum and RMS tracking error, over `window_s` and since enabling; set-points by number."""

    window_s: float
    worst: float
    rms: float
    worst_since_enable: float
    rms_since_enable: float
    repeated: int
    skipped: int


class Tracking:
    """Tracking statistics of one joint; `interface` is the compared quantity, "" for none.

    Positions that are equal cycle after cycle while the joint moves are `repeated`, velocities never are. `skipped`
    counts the edges of the grid without a set-point.
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
        """Set the period of the cycle in s, and the factor from device units to those of the joint.

        `late`: a set-point is measured three cycles later, since SYNC goes before the RPDOs, instead of two.
        """
        self._period_s, self._late, self._factor = period_s, late, abs(factor)
        self._full = max(1, round(WINDOW_S / period_s))

    def begin(self) -> None:
        """Reset after the joint was enabled."""
        self.repeated = self.skipped = 0
        self._worst = self._sum = self._previous_worst = self._previous_sum = self._total_worst = self._total_sum = 0.0
        self._count = self._previous_count = self._total_count = 0
        self.restart()

    def restart(self) -> None:
        """Reset the comparison after standstill or a mode change."""
        self._first = self._second = self._third = _NAN
        self._still = _PAUSE + 1

    def compare(self, interface: str, *, positions: bool) -> None:
        """Select the compared interface, "" for none."""
        self.interface, self._positions = interface, positions
        self.restart()

    def step(self, target: float, actual: float) -> None:
        """Add this cycle's set-point and the value measured before it; nan for none."""
        last = self._first
        error = (self._third if self._late else self._second) - actual
        self._third, self._second, self._first = self._second, last, target
        if error < 0.0:
            error = -error
        if error >= 0.0:  # not for nan
            if error > self._worst:
                self._worst = error
            self._sum += error * error
            self._count += 1
            if self._count >= self._full:
                self._turn()
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
        """Whether its set-points command motion."""
        return self._still <= _PAUSE if self._positions else self._first != 0.0 and self._first == self._first

    def figures(self) -> TrackingFigures | None:
        """Return the statistics, None without samples since the joint was enabled."""
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

    def _turn(self) -> None:
        """Start the next window."""
        self._previous_worst, self._previous_sum, self._previous_count = self._worst, self._sum, self._count
        self._total_worst = max(self._total_worst, self._worst)
        self._total_sum += self._sum
        self._total_count += self._count
        self._worst = self._sum = 0.0
        self._count = 0
