"""The trajectory that joints have gone, from samples of their positions: what `trajectory play` takes.

The law of the file: it begins when a joint begins to move and ends when the last one has come to rest. Velocities are
those between neighbours, at rest at both ends, so that what is played is a smooth curve through what was seen.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.errors import CanopenError
from canopen_control.rpc.messages.samples import TrajectoryPoint

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["STILL", "TrajectoryRecording"]

STILL: Final = 0.002
"""A joint that has gone less than this from where it was is at rest, in rad or m."""

_APART_S: Final = 0.045
"""So far apart the jitter of two samples counts little in the velocity between them; less than the default period."""


class TrajectoryRecording:
    """Positions of `joints` as they come, at times in s; `most` is how many a trajectory may have."""

    def __init__(self, joints: Sequence[str], most: int) -> None:
        self.joints, self._most = tuple(joints), most
        self._times: list[float] = []
        self._positions: list[list[float]] = []

    def __len__(self) -> int:
        return len(self._times)

    @property
    def is_full(self) -> bool:
        """Whether one more would be too many for a trajectory."""
        return len(self) >= self._most

    def add(self, time: float, positions: Sequence[float]) -> None:
        """Take where the joints are at a time in s; what is not later than the sample before it is left out."""
        if self._times and time <= self._times[-1]:
            return
        if len(self) == 1 and _near(positions, self._positions[0]):
            self._times[0], self._positions[0] = time, list(positions)  # it has not begun
            return
        self._times.append(time)
        self._positions.append(list(positions))

    def points(self) -> list[TrajectoryPoint]:
        """Return them as points, from the first motion to the last; CanopenError if nothing has moved."""
        end = len(self)
        while end > 1 and _near(self._positions[end - 2], self._positions[-1]):
            end -= 1
        if end < 2:
            raise CanopenError("no joint has moved meanwhile, so there is nothing to play; move one while it records")
        times, positions = self._times[:end], self._positions[:end]
        return [
            TrajectoryPoint(
                positions=[round(each, 6) for each in positions[index]],
                velocities=_velocities(times, positions, index),
                time_from_start=round(times[index] - times[0], 6),
            )
            for index in range(end)
        ]


def _near(one: Sequence[float], other: Sequence[float]) -> bool:
    return all(abs(a - b) < STILL for a, b in zip(one, other, strict=True))


def _velocities(times: Sequence[float], positions: Sequence[Sequence[float]], index: int) -> list[float]:
    """Return the velocities at a point: from one well before it to one well after it, at rest at both ends."""
    last = len(times) - 1
    if index in (0, last):
        return [0.0] * len(positions[index])
    before, after = index - 1, index + 1
    while before > 0 and times[index] - times[before] < _APART_S:
        before -= 1
    while after < last and times[after] - times[index] < _APART_S:
        after += 1
    elapsed = times[after] - times[before]
    return [round((b - a) / elapsed, 6) for a, b in zip(positions[before], positions[after], strict=True)]
