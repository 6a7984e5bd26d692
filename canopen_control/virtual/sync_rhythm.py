"""The rhythm of SYNC as the phase lock (PLL) of a drive recovers it from SYNCs that come early and late.

A filter of growing memory, up to `_MEMORY` SYNCs: the least-squares line through the times at which they came, the way
a drive's own clock is pulled to SYNC. A SYNC off by almost half a period, or after a long silence, begins it anew.
SYNCs that come in time are taken as they are, to the nanosecond. Times are monotonic nanoseconds.
"""

from __future__ import annotations

from typing import Final

__all__ = ["SyncRhythm"]

_MEMORY: Final = 256  # SYNCs: 2.6 s at 100 Hz
_LOCKED: Final = 3  # SYNCs until a period is known
_MOST_MISSED: Final = 8  # one after the other
_SAME: Final = 0.02  # by which two periods may differ
_FORGETS: Final = 1.0 / 256
_MARGIN: Final = 1.25  # the next one may be later than any before


class SyncRhythm:
    """`late_ns` is how late the newest SYNC came (negative: early), `period_ns` the recovered period, 0 for none yet.

    `slack_ns` is how late the next one may be, by those before: 0 where all came in time.
    """

    __slots__ = ("_count", "_edge", "_latest", "_missed", "late_ns", "period_ns")

    def __init__(self) -> None:
        self._begin(0)
        self._count = 0

    def _begin(self, now: int) -> None:
        self._count, self._edge, self._missed = 1, float(now), 0
        self.period_ns = self.late_ns = self._latest = 0.0

    @property
    def slack_ns(self) -> float:
        """How late the next SYNC may be and still count as one that comes."""
        return min(self._latest * _MARGIN, 0.5 * self.period_ns)

    def has_period(self, seconds: float) -> bool:
        """Whether SYNC comes in the rhythm that an interpolation time says."""
        return self._count >= _LOCKED and abs(self.period_ns * 1e-9 - seconds) <= _SAME * seconds

    def heard(self, now: int) -> None:
        """Take a SYNC."""
        gap, period = now - self._edge, self.period_ns
        if not period and self._count and gap > 0:
            self._edge, self.period_ns, self._count = float(now), gap, 2
        elif not period:
            self._begin(now)
        else:
            steps = round(gap / period)
            error = gap - steps * period
            self._missed = self._missed + steps - 1 if steps > 1 else 0  # in a row: of another period by now
            if steps < 1 or self._missed > _MOST_MISSED or abs(error) >= 0.45 * period:
                self._begin(now)
            else:
                self._follow(steps, error, now)

    def _follow(self, steps: int, error: float, now: int) -> None:
        count = self._count
        if count < _MEMORY:
            self._count = count = count + 1
        both = count * (count + 1)
        self._edge = edge = self._edge + (steps * self.period_ns + error * 2 * (2 * count - 1) / both)
        self.period_ns += error * 6 / both / steps
        self.late_ns = late = now - edge
        latest = self._latest * (1.0 - _FORGETS)
        self._latest = latest if latest > late else late
