"""The points of a trajectory as they come on a socket, piece by piece: packed into arrays, and surveyed on the way.

The law of the file: what a request brings costs a time that is bounded by its size, and so does the end, however many
points there are: to judge them, to begin with them, to drop them. No point is an object before it is followed.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from itertools import chain
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.controllers.trajectory.point import Point, Points
from canopen_control.controllers.trajectory.survey import Survey, Values
from canopen_control.errors import ControlError

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["PackedPoints", "SurveyedPoints", "TimedValues"]

_FARTHEST_S: Final = 1e9
"""No trajectory goes there; what is beyond does not fit the clock."""


class TimedValues(Values, Protocol):
    """A point as it comes on a socket."""

    @property
    def time_from_start(self) -> float:
        """In s."""
        ...


class _Column:
    """One quantity of the points of a piece: as many values for each, or whatever each has."""

    __slots__ = ("_odd", "_values", "_width")

    def __init__(self, vectors: list[list[float]]) -> None:
        self._width = len(vectors[0])
        even = set(map(len, vectors)) == {self._width}
        self._values = array("d", list(chain.from_iterable(vectors)) if even else ())
        self._odd = None if even else vectors

    def at(self, index: int) -> Sequence[float]:
        """Return the values of one point."""
        if self._odd is not None:
            return self._odd[index]
        return self._values[index * self._width : (index + 1) * self._width]


class SurveyedPoints(Points):
    """Points of which is known what they come to: `survey`."""

    survey: Survey


class PackedPoints(SurveyedPoints):
    """Points that are added as they come, and made again when they are asked for; `survey` is what they come to."""

    def __init__(self) -> None:
        self.times: array[int] = array("q")
        self.survey = Survey()
        self._begins: list[int] = []
        self._pieces: list[tuple[_Column, _Column, _Column, _Column]] = []

    def add(self, points: Sequence[TimedValues]) -> None:
        """Take the next points; ControlError, and none is taken, for a time that no clock can hold."""
        seconds = [each.time_from_start for each in points]
        for index, time in enumerate(seconds, len(self)):
            if not -_FARTHEST_S <= time <= _FARTHEST_S:
                given = f"a time_from_start of {time:g} s"
                raise ControlError(f"point {index} has {given}; give at most {_FARTHEST_S:g}")
        times = array("q", [round(each * 1e9) for each in seconds])
        if not points:
            return
        self.survey.add(points, times)
        self._begins.append(len(self))
        self.times += times
        self._pieces.append(
            (
                _Column([each.positions for each in points]),
                _Column([each.velocities for each in points]),
                _Column([each.accelerations for each in points]),
                _Column([each.effort for each in points]),
            )
        )

    def positions(self, begin: int, end: int) -> list[Sequence[float]]:
        """Return the positions of the points from `begin` to before `end`."""
        found: list[Sequence[float]] = []
        piece = bisect_right(self._begins, begin) - 1
        while begin < end:
            after = self._begins[piece + 1] if piece + 1 < len(self._begins) else len(self)
            until, first = min(end, after), self._begins[piece]
            found += map(self._pieces[piece][0].at, range(begin - first, until - first))
            begin, piece = until, piece + 1
        return found

    def __getitem__(self, index: int) -> Point:
        """Return a point of its own."""
        if index < 0:
            index += len(self)
        time = self.times[index]
        piece = bisect_right(self._begins, index) - 1
        at = index - self._begins[piece]
        positions, velocities, accelerations, effort = self._pieces[piece]
        return Point(positions.at(at), velocities.at(at), accelerations.at(at), effort.at(at), time)
