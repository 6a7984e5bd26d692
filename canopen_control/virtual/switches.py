"""The simulated switches and the index of an axis, at fixed places of the plant.

A switch is a place, never an event; whether it is active follows from the position. The limit switches belong to a
homing rig and are seen by homing alone, unless `wired`: then they stop every motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_control.virtual.trajectory import Trajectory

__all__ = ["Switches"]

NEGATIVE, POSITIVE, HOME = 1, 2, 4  # 0x60FD
_LIMIT, _HOME_LOW, _HOME_HIGH = 50_000.0, 10_000.0, 12_000.0
_OUT_OF_REACH = 1e12


@dataclass(slots=True)
class Switches:
    """Places in plant counts; the home switch is active from `home_low` to `home_high`.

    The index comes every `index_period`. The limit switches are there for homing, or, `wired`, for every motion.
    """

    negative: float = -_LIMIT
    positive: float = _LIMIT
    home_low: float = _HOME_LOW
    home_high: float = _HOME_HIGH
    index_period: float = 4096.0
    wired: bool = False
    homing: bool = False

    def inputs(self, position: float) -> int:
        """Return the low bits of 0x60FD: negative limit, positive limit, home switch."""
        if not (self.wired or self.homing):
            return 0
        home = HOME if self.home_low <= position <= self.home_high else 0
        return home | (NEGATIVE if position <= self.negative else 0) | (POSITIVE if position >= self.positive else 0)

    def next_hit(self, demand: Trajectory, now: int) -> int | None:
        """Return when `demand` runs into a wired limit switch, None: it does not."""
        if not self.wired:
            return None
        position = demand.at(now)[0]
        if self.negative < position < self.positive:
            times = [demand.time_of(place, now) for place in (self.negative, self.positive)]
            return min((time for time in times if time is not None), default=None)
        return None

    def bounds(self, position: float) -> tuple[float, float]:
        """Return how far a motion may go from `position` while a limit switch is active."""
        if not self.wired:
            return -float("inf"), float("inf")
        low = position if position <= self.negative else -float("inf")
        high = position if position >= self.positive else float("inf")
        return low, high

    # -- seams

    def close_positive(self, position: float) -> None:
        """Wire the limit switches, the positive one at `position` (a fault)."""
        self.wired, self.positive, self.negative = True, position, -_OUT_OF_REACH

    def open_positive(self) -> None:
        """Have limit switches for homing alone again."""
        self.wired, self.positive, self.negative = False, _LIMIT, -_LIMIT

    def place(self, *, reachable: bool) -> None:
        """Put the switches where they are, or out of homing's way (a fault)."""
        far = 0.0 if reachable else _OUT_OF_REACH
        self.negative, self.positive = -_LIMIT - far, _LIMIT + far
        self.home_low, self.home_high = _HOME_LOW + far, _HOME_HIGH + far
