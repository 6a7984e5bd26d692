"""Trapezoidal position profile for modes in which the drive computes none: one step per cycle.

A set-point of a trajectory is where the axis is to be in this cycle; a place is where it is to come to in the end,
and a drive in CSP or IP would be asked to be there at once.

A way begins with the speed that there is, ends at rest, and is never faster than `most`; the speed
rises by `rise` at most, also where a new place lies behind, and falls as late as that lets it. Counts, counts/s and
counts/s^2; nothing is allocated. Who stops on the way does not step any more, and lets it `rest`.
"""

from __future__ import annotations

import math
from typing import Final

_LEAST: Final = 1  # count in a cycle: slower than this is not told to the drive


class TrapezoidalProfile:
    """Profile of one axis; `speed` is the present one, negative downwards; `limited` is whether it has limits."""

    __slots__ = ("_most", "_rise", "limited", "speed")

    def __init__(self) -> None:
        self.speed = 0.0
        self.limit(math.inf, math.inf)

    def limit(self, most: float, rise: float) -> None:
        """Set the limits from the next step on."""
        self._most, self._rise = most, rise
        self.limited = most < math.inf or rise < math.inf

    def rest(self) -> None:
        """Start the next motion at rest."""
        self.speed = 0.0

    def step(self, way: int, period: float, largest: float = math.inf) -> int:
        """Return the distance of this cycle of `period` s; `largest` is the drive's own limit.

        A way is made in steps of one count at least, so that it ends.
        """
        side, far = (1 if way >= 0 else -1), abs(way)
        speed = min(self._most, largest, self.speed * side + self._rise * period, math.sqrt(2 * self._rise * far))
        step = min(far, max(_LEAST, round(speed * period))) if speed >= 0 else round(speed * period)
        self.speed = speed * side if step != far else 0.0
        return step * side
