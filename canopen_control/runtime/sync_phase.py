"""Phase lock of the cycle to the SYNC of another clock: a kernel's, a drive's. Sans-IO, all times in ns.

The law of this file: between two SYNCs there is one edge of the cycle, never none and never two, so that no set-point
is lost or doubled however far two oscillators drift apart. Once it is locked an edge is moved by at most a sixty-fourth
of a period; the jump that locks it makes a period longer, never shorter. A SYNC is seen late or in time, never early:
of sixteen the second earliest counts, so that neither a busy process nor an adapter that hands frames over in bunches
shifts the cycle. By how much the other clock's period is longer is learned: the kernel's broadcast manager counts each
period from when it has sent, so that its SYNC is later by its own latency each time, thousands of ppm at 1 kHz.
"""

from __future__ import annotations

from typing import Final

__all__ = ["SyncPhase"]

_SLOWEST: Final = 64  # a step is at most this part of a period
_WINDOW: Final = 16  # SYNCs that are judged together
_LEARNS: Final = 4 * _WINDOW  # of what a window is off, this part a period
_EARLY: Final = 8  # one that seems early by more than this part of a period was seen almost a period late
_NONE: Final = 1 << 62


class SyncPhase:
    """Keeps the edges of a cycle of `period_ns` at `behind_ns` after the SYNCs that are heard.

    `locked` is whether they are there; until then the next SYNC is believed.
    """

    __slots__ = (
        "_count",
        "_first",
        "_left",
        "_longer",
        "_off",
        "_second",
        "_strange",
        "behind_ns",
        "locked",
        "period_ns",
    )

    def __init__(self, period_ns: int, behind_ns: int) -> None:
        self.period_ns, self.behind_ns = period_ns, behind_ns
        self.locked = False
        self._left = self._longer = self._off = self._strange = self._count = 0
        self._first = self._second = _NONE

    def heard(self, tick: int, edge: int) -> int:
        """Take a SYNC seen at `tick` while the next edge is to come at `edge`; return by how much that is put off."""
        period = self.period_ns
        if not self.locked:
            self.locked = True
            self._left = self._longer = self._off = self._strange = 0
            self._begin()
            return (tick + self.behind_ns - edge) % period
        half = period // 2
        error = (tick + self.behind_ns - edge + half) % period - half
        if error < -(period // _EARLY):
            self._strange += 1
            self.locked = self._strange < _WINDOW
            return 0
        self._strange = 0
        if error < self._first:
            self._first, self._second = error, self._first
        elif error < self._second:
            self._second = error
        self._count += 1
        if self._count >= _WINDOW:
            self._learn(self._second)
            self._begin()
        return 0

    def step(self) -> int:
        """Return by how much the edge after the next one comes later than a period, negative for earlier."""
        left, longer = self._left, self._longer
        if not left:
            return longer
        most = self.period_ns // _SLOWEST
        step = max(-most - longer, min(most - longer, left))
        self._left = left - step
        self._first -= step  # what was measured against the edges before
        self._second -= step
        return longer + step

    def _learn(self, off: int) -> None:
        """Take by what a window of SYNCs was off; where that was put right before, the periods differ."""
        before, put_right = self._off, not self._left
        self._off = self._left = off
        again = min(abs(before), abs(off)) if before * off > 0 and put_right else 0
        most = self.period_ns // _SLOWEST
        longer = again // _LEARNS if off > 0 else -(again // _LEARNS)
        self._longer = max(-most, min(most, self._longer + longer))

    def _begin(self) -> None:
        self._count = 0
        self._first = self._second = _NONE
