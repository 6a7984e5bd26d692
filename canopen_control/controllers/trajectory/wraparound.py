"""Angles of joints that turn without end: the shortest way, and a start on the same turn as the first point."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["shortest_angular_distance", "wrap_around"]

_HALF_TURN: Final = 1e-9
"""So near to half a turn both ways are the shortest, and the sign of the difference decides; rad."""


def shortest_angular_distance(begin: float, end: float) -> float:
    """Return the angle from one direction to another, in (-pi, pi] rad; nan if either is not finite."""
    turned = end - begin + math.pi
    if not math.isfinite(turned):
        return math.nan
    rest = math.fmod(turned, 2.0 * math.pi)
    return rest + math.pi if rest <= 0.0 else rest - math.pi


def wrap_around(current: list[float], following: Sequence[float], wrap: Sequence[bool]) -> None:
    """Move the positions of joints without end by whole turns to where the next ones are the shortest way off."""
    for index in range(min(len(current), len(following), len(wrap))):
        if not wrap[index]:
            continue
        distance = shortest_angular_distance(current[index], following[index])
        if abs(abs(distance) - math.pi) < _HALF_TURN:
            distance = math.copysign(distance, following[index] - current[index] or -1.0)
        current[index] = following[index] - distance
