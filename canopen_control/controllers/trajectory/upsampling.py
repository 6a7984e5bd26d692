"""Velocities for trajectories of positions alone, as policies send them: a cubic spline through all points.

The law of the file (ros2_controllers rolling, positions_upsampling): the spline has continuous accelerations and rests
at both ends. Ours: the velocities of a few points are worked out when the joints come there, so that a long trajectory
costs neither its acceptance nor a cycle. What is farther away counts 0.27 times as much with each point where they come
evenly, and half as much at worst: `_REACH` points away 1e-14 of a velocity, at worst 1e-7.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, overload

from canopen_control.controllers.trajectory.packed import PackedPoints, SurveyedPoints
from canopen_control.controllers.trajectory.point import Point, Points
from canopen_control.controllers.trajectory.survey import NONE, Survey
from canopen_control.controllers.trajectory.validation import survey_of

if TYPE_CHECKING:
    from canopen_control.controllers.trajectory.point import JointTrajectory

__all__ = ["PolicyTimes", "UpsampledPoints", "positions_alone", "upsampled"]

_REACH: Final = 24
_BLOCK: Final = 16  # points whose velocities are worked out together

Block = list[list[float]]


def positions_alone(message: JointTrajectory) -> bool:
    """Whether the points say nothing but positions."""
    return not any(set(each) - {0} for each in survey_of(message).sizes[1:])


def upsampled(message: JointTrajectory, frequency: float) -> UpsampledPoints | None:
    """Return the points of a trajectory with the velocities of the spline through their positions, None for none.

    Without any time they have those of a policy that runs at `frequency` in Hz; 0 leaves them.
    """
    survey, points = survey_of(message), message.points
    if len(survey.sizes[0]) != 1 or 0 in survey.sizes[0]:
        return None
    times: Sequence[int] = points.times if isinstance(points, Points) else [each.time for each in points]
    if frequency > 0.0 and not any(times):
        times, survey = PolicyTimes(len(times), frequency), copy.copy(survey)
        survey.not_increasing = NONE
    return UpsampledPoints(points, times, survey) if survey.not_increasing == NONE else None


class PolicyTimes(Sequence[int]):
    """The times of a policy's points, in ns: each a period after the one before, the first after one."""

    def __init__(self, count: int, frequency: float) -> None:
        self._count, self._frequency = count, frequency

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, index: int) -> int: ...
    @overload
    def __getitem__(self, index: slice) -> list[int]: ...
    def __getitem__(self, index: int | slice) -> int | list[int]:
        """Return one of them, or some."""
        if isinstance(index, slice):
            return [self[each] for each in range(*index.indices(self._count))]
        if not -self._count <= index < self._count:
            raise IndexError(index)
        return int((index % self._count + 1) / self._frequency * 1e9)


class UpsampledPoints(SurveyedPoints):
    """Points of positions with the velocities of the spline; `source` has the positions, `times` are theirs."""

    def __init__(self, source: Sequence[Point] | Points, times: Sequence[int], survey: Survey) -> None:
        self.times, self.survey = times, survey
        self._source = source
        self._blocks: dict[int, Block] = {}  # the two that were asked for last, by their first points

    def __getitem__(self, index: int) -> Point:
        """Return a point of its own."""
        if index < 0:
            index += len(self)
        begin = index - index % _BLOCK
        block = self._blocks.get(begin)
        if block is None:
            block = self._worked_out(begin)
            if len(self._blocks) > 1:
                del self._blocks[next(iter(self._blocks))]
            self._blocks[begin] = block
        return Point(self._source[index].positions, block[index - begin], time=self.times[index])

    def _worked_out(self, begin: int) -> Block:
        """Return the velocities of a block, as if all rested beyond the reach of it."""
        last = len(self) - 1
        first, end = max(0, begin - _REACH), min(last, begin + _BLOCK - 1 + _REACH)
        if not last:
            return [[]]
        source = self._source
        if isinstance(source, PackedPoints):
            positions = source.positions(first, end + 1)
        else:
            positions = [source[index].positions for index in range(first, end + 1)]
        times = [self.times[index] for index in range(first, end + 1)]
        found = _spline(positions, [(b - a) / 1e9 for a, b in itertools.pairwise(times)])
        return found[begin - first : begin - first + _BLOCK]


def _spline(positions: Sequence[Sequence[float]], steps: Sequence[float]) -> Block:
    """Solve the tridiagonal equations of the velocities at the inner points (Thomas); those of the ends are 0."""
    still = [0.0] * len(positions[0])
    uppers, rows = [0.0], [still]
    for i, (h, k) in enumerate(itertools.pairwise(steps)):
        p0, p1, p2 = positions[i : i + 3]
        upper, before = uppers[-1], rows[-1]
        diagonal = (2.0 - upper) / h + 2.0 / k
        ahead, behind = 3.0 / (k * k), 3.0 / (h * h)
        rows.append(
            [
                (ahead * (c - b) + behind * (b - a) - r / h) / diagonal
                for a, b, c, r in zip(p0, p1, p2, before, strict=True)
            ]
        )
        uppers.append(1.0 / (k * diagonal))
    found = [still]
    for upper, row in zip(reversed(uppers), reversed(rows), strict=True):
        found.append([r - upper * v for r, v in zip(row, found[-1], strict=True)])
    found.reverse()
    found[0] = list(still)
    return found
