"""Pacer of the control cycle with absolute deadlines; counts missed and late cycles.

The n-th edge is start + n * period, independent of earlier cycles. A cycle that is more than a period late skips and
counts the missed edges, and continues on the grid: SYNCs are never sent in a burst to catch up. The SYNC of another
clock with the same period may lead the grid (`SyncPhase`); without SYNC the grid continues by itself.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.host.reactor import Reactor
    from canopen_control.host.timer import Timer


# Phase lock of the cycle to the SYNC of another clock, such as the kernel or a drive. Without I/O, all times in ns.
#
# Between two SYNCs there is exactly one edge of the cycle, so that no set-point is lost or repeated by the drift of the
# two oscillators. In the locked state an edge is shifted by at most 1/64 of a period; the jump that locks the
# phase makes a period longer, never shorter. A SYNC can be received late, but never early: of sixteen SYNCs the second
# earliest counts, so that neither a busy process nor an adapter that delivers frames in bunches shifts the cycle. The
# difference between the two periods is estimated: the kernel's broadcast manager measures each period from the end of
# its transmission, so that its SYNC period is longer by its own latency, thousands of ppm at 1 kHz.


_STEP_DIVISOR: Final = 64  # a correction is at most a period divided by this
_WINDOW: Final = 16  # SYNCs that are evaluated together
_RATE_GAIN: Final = 4 * _WINDOW  # divisor of a window's phase error for the correction of the period
_EARLY: Final = 8  # a SYNC early by more than this fraction of a period was received almost a period late
_NONE: Final = 1 << 62


class SyncPhase:
    """Phase lock that keeps the edges of a cycle `behind_ns` after the received SYNCs.

    While not `locked`, the next SYNC shifts the edges at once.
    """

    __slots__ = (
        "_count",
        "_first",
        "_off",
        "_outliers",
        "_phase_left",
        "_rate_step",
        "_second",
        "behind_ns",
        "locked",
        "period_ns",
    )

    def __init__(self, period_ns: int, behind_ns: int) -> None:
        self.period_ns, self.behind_ns = period_ns, behind_ns
        self.locked = False
        self._phase_left = self._rate_step = self._off = self._outliers = self._count = 0
        self._first = self._second = _NONE

    def receive_sync(self, tick: int, edge: int) -> int:
        """Process a SYNC received at `tick`; return the shift in ns of the next edge, due until now at `edge`."""
        period = self.period_ns
        if not self.locked:
            self.locked = True
            self._phase_left = self._rate_step = self._off = self._outliers = 0
            self._begin()
            return (tick + self.behind_ns - edge) % period
        half = period // 2
        error = (tick + self.behind_ns - edge + half) % period - half
        if error < -(period // _EARLY):
            self._outliers += 1
            self.locked = self._outliers < _WINDOW
            return 0
        self._outliers = 0
        if error < self._first:
            self._first, self._second = error, self._first
        elif error < self._second:
            self._second = error
        self._count += 1
        if self._count >= _WINDOW:
            self._correct_rate(self._second)
            self._begin()
        return 0

    def step(self) -> int:
        """Return and consume the correction of the current period in ns; a negative value shortens the period."""
        phase_left, rate_step = self._phase_left, self._rate_step
        if not phase_left:
            return rate_step
        limit = self.period_ns // _STEP_DIVISOR
        step = max(-limit - rate_step, min(limit - rate_step, phase_left))
        self._phase_left = phase_left - step
        self._first -= step  # these were measured against the uncorrected edges
        self._second -= step
        return rate_step + step

    def _correct_rate(self, off: int) -> None:
        """Set the phase error `off` of a window of SYNCs, and correct the estimate of the period difference."""
        previous, was_corrected = self._off, not self._phase_left
        self._off = self._phase_left = off
        persistent = min(abs(previous), abs(off)) if previous * off > 0 and was_corrected else 0
        limit = self.period_ns // _STEP_DIVISOR
        rate_step = persistent // _RATE_GAIN if off > 0 else -(persistent // _RATE_GAIN)
        self._rate_step = max(-limit, min(limit, self._rate_step + rate_step))

    def _begin(self) -> None:
        self._count = 0
        self._first = self._second = _NONE


LATE_EDGES_NS = tuple(1000 * us for us in (10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000))


class Pacer:
    """Pacer that calls `on_edge(now)` at the start of each cycle; all times are in ns.

    During the call, `edge` is the nominal time of the newest edge and `skipped` the number of edges missed just before.
    `phase` locks the edges to the SYNCs passed to `lead`, half a period behind these by default. `reported` is how many
    of the `missed` edges were reported. `late_max` is the maximum lateness, `work_max` the maximum duration of a cycle,
    `work` the duration of the last cycle. `late_counts[i]` is the number of cycles that were at most `LATE_EDGES_NS[i]`
    late, and later than the previous limit; the last count is for all later cycles.
    """

    def __init__(self, reactor: Reactor, period_ns: int, on_edge: Callable[[int], None] = lambda _now: None) -> None:
        self.period_ns = period_ns
        self.count = self.missed = 0
        self.late_max = self.work_max = self.work = 0
        self.late_counts = [0] * (len(LATE_EDGES_NS) + 1)
        self.edge = self.skipped = 0
        self.phase = SyncPhase(period_ns, period_ns // 2)
        self.on_edge, self._reactor = on_edge, reactor
        self._edge = self.reported = self._report_at = 0
        self._timer: Timer | None = None

    @property
    def running(self) -> bool:
        """Whether the pacer has been started, so that edges are scheduled."""
        return self._timer is not None

    def newly_missed(self, now: int) -> int:
        """Return the number of edges missed since the last report, or 0 within a second of that report."""
        missed = self.missed - self.reported
        if not missed or now < self._report_at:
            return 0
        self.reported, self._report_at = self.missed, now + 1_000_000_000
        return missed

    def start(self) -> None:
        """Start the pacer if stopped; the first edge is one period from now."""
        if self._timer is None:
            self._arm(self._reactor.now() + self.period_ns)

    def stop(self) -> None:
        """Stop the pacer; a second call does nothing."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def lead(self, tick: int) -> None:
        """Shift the edges to stay in phase with another clock whose SYNC was received at `tick`."""
        if self._timer is None:
            return
        if shift := self.phase.receive_sync(tick, self._edge):
            self._timer.cancel()
            self._arm(self._edge + shift)

    def _arm(self, edge: int) -> None:
        self._edge = edge
        self._timer = self._reactor.call_at(edge, self._on_edge)

    def _on_edge(self) -> None:
        now = self._reactor.now()
        late = now - self._edge
        self.skipped = skipped = late // self.period_ns
        self.edge = edge = self._edge + skipped * self.period_ns
        self.missed += skipped
        self.count += 1
        self.late_max = max(self.late_max, late)
        self.late_counts[bisect_left(LATE_EDGES_NS, late)] += 1
        self._arm(edge + self.period_ns + self.phase.step())  # first: `on_edge` may stop the pacer or fail
        self.on_edge(now)
        self.work = work = self._reactor.now() - now
        if work > self.work_max:
            self.work_max = work
