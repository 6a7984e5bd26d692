"""Targets of a position controller's sliders: what nobody has set is where the joint is, and a drive does not move it.

A slider that somebody sets keeps that target until the drive that follows has ended; all others follow their joints,
whoever moves those. While somebody drives, a joint that was not set stays where it was at first.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

__all__ = ["Targets"]

_DRIVEN_S: Final = 0.5  # without a word of a held button the drive has ended


class Targets:
    """A controller's sliders: `limits` are their ends, `clock` gives s. Positions in rad or m, None if unknown."""

    def __init__(self, limits: Mapping[str, tuple[float, float]], clock: Callable[[], float] = time.monotonic) -> None:
        self._limits, self._clock = limits, clock
        self.values = {joint: min(max(0.0, low), high) for joint, (low, high) in limits.items()}
        self._set: set[str] = set()
        self._rest: dict[str, float] = {}
        self._held_at: float | None = None

    def set(self, joint: str, value: float) -> None:
        """Take note that somebody has set a slider."""
        low, high = self._limits[joint]
        self.values[joint] = min(max(value, low), high)
        self._set.add(joint)

    def follow(self, positions: Mapping[str, float | None]) -> dict[str, float]:
        """Return the sliders that have to move because their joints did."""
        now = self._clock()
        if self._driven(now):
            return {}
        if self._held_at is not None:
            self._held_at = None
            self._set.clear()
        moved = {}
        for joint, (low, high) in self._limits.items():
            at = positions.get(joint)
            if at is None or joint in self._set:
                continue
            shown = min(max(at, low), high)
            if abs(shown - self.values[joint]) >= (high - low) / 400:  # less could not be seen
                self.values[joint] = moved[joint] = shown
        return moved

    def targets(self, positions: Mapping[str, float | None]) -> list[float]:
        """Return what a held button sends, by the order of the sliders."""
        now = self._clock()
        if not self._driven(now):
            self._rest = {joint: at for joint, at in positions.items() if at is not None}
        self._held_at = now
        return [value if joint in self._set else self._rest.get(joint, value) for joint, value in self.values.items()]

    def rest(self, positions: Mapping[str, float | None]) -> list[float]:
        """Return what ends the drive: where the joints are, as far as that is known."""
        found = {**self.values, **self._rest}
        found |= {joint: at for joint, at in positions.items() if at is not None}
        return [found[joint] for joint in self.values]

    @property
    def driven(self) -> bool:
        """Whether a button is held now."""
        return self._driven(self._clock())

    def _driven(self, now: float) -> bool:
        return self._held_at is not None and now - self._held_at < _DRIVEN_S
