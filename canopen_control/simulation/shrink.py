"""Shrinks a schedule that breaks an invariant to the smallest that still does: acts are dropped, times halved.

First parts of the schedule are left out, halves before single acts (delta debugging); then what is left lasts half as
long and comes earlier, as long as the same rule still breaks. The number of tries is bounded.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.simulation.acts import Act

    Acts = tuple[Act, ...]

__all__ = ["MOST_TRIES", "Shrinker"]

MOST_TRIES: Final = 150
_FIRST_NS: Final = 600_000_000  # a robot boots until then
_SHORT_NS: Final = 20_000_000


class Shrinker:
    """Looks for the smallest schedule for which `breaks(acts)` is true; `tries` counts how often that was asked."""

    def __init__(self, breaks: Callable[[Acts], bool], most: int = MOST_TRIES) -> None:
        self.tries = 0
        self._breaks, self._most = breaks, most

    def shrink(self, acts: Sequence[Act]) -> Acts:
        """Return the smallest that was found; the acts themselves where nothing smaller breaks."""
        smallest = tuple(acts)
        while (smaller := self._round(smallest)) != smallest:
            smallest = smaller
        return smallest

    def _round(self, acts: Acts) -> Acts:
        return self._shorten(self._drop(acts))

    def _still(self, acts: Acts) -> bool:
        if self.tries >= self._most:
            return False
        self.tries += 1
        return self._breaks(acts)

    def _drop(self, acts: Acts) -> Acts:
        """Leave out ever smaller parts."""
        size = max(1, len(acts) // 2)
        while acts:
            at = 0
            while at < len(acts):
                fewer = acts[:at] + acts[at + size :]
                if self._still(fewer):
                    acts = fewer
                else:
                    at += size
            if size == 1:
                break
            size //= 2
        return acts

    def _shorten(self, acts: Acts) -> Acts:
        """Halve how long each act lasts, and the time before it."""
        for number in range(len(acts)):
            for changed in self._shorter(acts, number):
                if self._still(changed):
                    acts = changed
        return acts

    def _shorter(self, acts: Acts, number: int) -> Iterator[Acts]:
        act = acts[number]
        if act.for_ns is not None and act.for_ns > _SHORT_NS:
            yield (*acts[:number], replace(act, for_ns=_whole(act.for_ns // 2)), *acts[number + 1 :])
        before = acts[number - 1].at_ns if number else _FIRST_NS
        gap = act.at_ns - before
        if gap > _SHORT_NS:
            cut = _whole(gap // 2)
            yield (*acts[:number], *(replace(each, at_ns=each.at_ns - cut) for each in acts[number:]))


def _whole(time_ns: int) -> int:
    """Return whole ms."""
    return time_ns // 1_000_000 * 1_000_000
