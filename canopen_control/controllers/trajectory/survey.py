"""What the points of a trajectory come to, gathered piece by piece: all that the rules of taking it ask for.

The law of the file: a piece costs a time that is bounded by its size, and then the whole is judged at once: where its
times do not increase, where sizes change, where a number is none, and the extremes of each joint.
"""

from __future__ import annotations

import math
import operator
from itertools import chain
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["NONE", "Extremes", "Range", "Survey", "Values"]

NONE: Final = -1
"""In the place of the index of a point: there is none."""


class Values(Protocol):
    """The values of a point, as `Point` has them and what comes on a socket."""

    @property
    def positions(self) -> list[float]:
        """In rad or m, one for each joint or none."""
        ...

    @property
    def velocities(self) -> list[float]:
        """In rad/s or m/s."""
        ...

    @property
    def accelerations(self) -> list[float]:
        """In rad/s2 or m/s2."""
        ...

    @property
    def effort(self) -> list[float]:
        """In Nm or N."""
        ...


class Range:
    """The extremes of each joint in the points from `begin` to before `end`."""

    __slots__ = ("begin", "end", "highest", "lowest")

    def __init__(self, begin: int, end: int, columns: Sequence[Sequence[float]]) -> None:
        self.begin, self.end = begin, end
        self.lowest, self.highest = list(map(min, columns)), list(map(max, columns))


class Extremes:
    """The extremes of each joint in all points, and in the `ranges` that they came in."""

    __slots__ = ("highest", "lowest", "ranges")

    def __init__(self) -> None:
        self.ranges: list[Range] = []
        self.lowest: list[float] = []
        self.highest: list[float] = []

    def add(self, found: Range) -> None:
        """Take those of the next points."""
        self.ranges.append(found)
        if len(found.lowest) != len(self.lowest):
            self.lowest, self.highest = found.lowest, found.highest
        else:
            self.lowest = list(map(min, self.lowest, found.lowest))
            self.highest = list(map(max, self.highest, found.highest))


class Survey:
    """Where points break the rules, as indices of the first ones that do; `count` is how many there are.

    `not_increasing` is not after the point before it, `empty` has neither positions nor velocities nor accelerations,
    `infinite` has a number that is none. `sizes` are the first points by the number of values that they have, of
    positions, velocities, accelerations and efforts; `positions` and `velocities` are their extremes, `means` those of
    the mean velocity on the way from the point before, per s.
    """

    def __init__(self) -> None:
        self.count = 0
        self.not_increasing = self.empty = self.infinite = NONE
        self.sizes: tuple[dict[int, int], ...] = ({}, {}, {}, {})
        self.positions = Extremes()
        self.velocities = Extremes()
        self.means = Extremes()
        self._last = 0
        self._place: Sequence[float] = ()  # where the last point is

    def add(self, points: Sequence[Values], times: Sequence[int]) -> None:
        """Look at the next points; `times` are theirs from start in ns."""
        if not points:
            return
        begin, before = self.count, self._last
        self._look_at_times(times)
        columns = (
            [each.positions for each in points],
            [each.velocities for each in points],
            [each.accelerations for each in points],
            [each.effort for each in points],
        )
        empty = True
        for quantity, vectors in enumerate(columns):
            found = self._look_at_sizes(quantity, vectors)
            empty = empty and (quantity > 2 or 0 in found)
            if self.infinite == NONE or self.infinite >= begin:
                self._look_at_numbers(vectors)
            if quantity < 2 and len(found - {0}) == 1:
                extremes = self.velocities if quantity else self.positions
                extremes.add(Range(begin, begin + len(points), list(zip(*filter(None, vectors), strict=True))))
        if empty and self.empty == NONE:
            none = (index for index, three in enumerate(zip(*columns[:3], strict=True)) if not any(three))
            self.empty = begin + next(none, NONE - begin)
        self.count += len(points)
        if self.not_increasing == self.infinite == NONE and len(self.sizes[0]) == 1:
            self._look_at_ways(begin, columns[0], before, times)

    def _look_at_ways(self, begin: int, places: list[list[float]], before: int, times: Sequence[int]) -> None:
        """Take the mean velocities up to the next points, all of which have positions."""
        last, self._place = self._place, places[-1]
        whens = [each * 1e-9 for each in ((before, *times) if last else times)]
        seconds = list(map(operator.sub, whens[1:], whens))
        if seconds and places[0]:
            columns = zip(*([last, *places] if last else places), strict=True)
            ways = (map(operator.sub, column[1:], column) for column in columns)
            first = begin if last else begin + 1
            self.means.add(
                Range(first, first + len(seconds), [list(map(operator.truediv, each, seconds)) for each in ways])
            )

    def sized(self, quantity: int, allowed: tuple[int, ...]) -> int:
        """Return the first point that has another number of values of a quantity than these, NONE if none has."""
        return min((at for size, at in self.sizes[quantity].items() if size not in allowed), default=NONE)

    def _look_at_times(self, times: Sequence[int]) -> None:
        if self.not_increasing == NONE:
            if self.count and times[0] <= self._last:
                self.not_increasing = self.count
            elif not all(map(operator.lt, times, times[1:])):
                late = (index for index in range(1, len(times)) if times[index] <= times[index - 1])
                self.not_increasing = self.count + next(late)
        self._last = times[-1]

    def _look_at_sizes(self, quantity: int, vectors: list[list[float]]) -> set[int]:
        sizes = list(map(len, vectors))
        found = set(sizes)
        known = self.sizes[quantity]
        for size in found:
            if size not in known:
                known[size] = self.count + sizes.index(size)
        return found

    def _look_at_numbers(self, vectors: list[list[float]]) -> None:
        if math.isfinite(sum(chain.from_iterable(vectors))):
            return
        for index, values in enumerate(vectors, self.count):
            if not all(map(math.isfinite, values)):
                self.infinite = index if self.infinite == NONE else min(index, self.infinite)
                return
