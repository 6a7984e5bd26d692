"""The cycle's clock: absolute deadlines, and an honest account of the ones that were missed.

The law of this file: the n-th edge is start + n * period, whatever happened before it. A cycle that comes more than a
period late skips the edges it missed, counts them, and goes on with the next one on the grid: SYNCs are never sent in
a burst to catch up. Another clock of the same period may lead the grid (`sync_phase`); without its ticks it goes on by
itself.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import TYPE_CHECKING

from canopen_control.runtime.sync_phase import SyncPhase

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.host.reactor import Reactor, Timer

__all__ = ["LATE_EDGES_NS", "Pacer"]

LATE_EDGES_NS = tuple(1000 * us for us in (10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000))


class Pacer:
    """Calls `on_edge(now)` on every edge; times in ns.

    Meanwhile `edge` is the edge that the cycle is of, the newest one, and `skipped` how many before it were missed.
    `phase` is where another clock's ticks want the edges, half a period after them unless it is told otherwise.
    `told` is how many of the `missed` edges were told. `late_max` is the worst lateness, `work_max` what the longest
    cycle took, `work` what the newest one did.
    `late_counts[i]` counts the cycles that came at most `LATE_EDGES_NS[i]` late, and later than the edge before it; the
    last one counts the rest.
    """

    def __init__(self, reactor: Reactor, period_ns: int, on_edge: Callable[[int], None] = lambda _now: None) -> None:
        self.period_ns = period_ns
        self.count = self.missed = 0
        self.late_max = self.work_max = self.work = 0
        self.late_counts = [0] * (len(LATE_EDGES_NS) + 1)
        self.edge = self.skipped = 0
        self.phase = SyncPhase(period_ns, period_ns // 2)
        self.on_edge, self._reactor = on_edge, reactor
        self._edge = self.told = self._tell_at = 0
        self._timer: Timer | None = None

    @property
    def running(self) -> bool:
        """Whether edges are coming."""
        return self._timer is not None

    def newly_missed(self, now: int) -> int:
        """Return how many edges were missed since it was last told, at most once a second; 0 for none to tell."""
        missed = self.missed - self.told
        if not missed or now < self._tell_at:
            return 0
        self.told, self._tell_at = self.missed, now + 1_000_000_000
        return missed

    def start(self) -> None:
        """Begin with an edge one period from now."""
        if self._timer is None:
            self._arm(self._reactor.now() + self.period_ns)

    def stop(self) -> None:
        """Stop; a second call does nothing."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def lead(self, tick: int) -> None:
        """Keep the grid in phase with another clock, of which a tick was seen at `tick`."""
        if self._timer is None:
            return
        if shift := self.phase.heard(tick, self._edge):
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
        self._arm(edge + self.period_ns + self.phase.step())  # armed first: work may stop the pacer, or fail
        self.on_edge(now)
        self.work = work = self._reactor.now() - now
        if work > self.work_max:
            self.work_max = work
