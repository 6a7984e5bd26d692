"""A twist and its limits: what is wanted of each axis, and what the limiters leave of it against the last two steps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.controllers.limiter import Limits, RateLimiter
from canopen_control.errors import RobotConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.base_params import AxisLimits

__all__ = ["LimitedTwist", "fill"]

_FREE: Final = RateLimiter(Limits())


class LimitedTwist:
    """Of each axis what is `wanted`, nan without a twist, and `limited`; in m/s and rad/s."""

    def __init__(self, axes: Sequence[str]) -> None:
        self._axes = tuple(axes)
        count = len(self._axes)
        self.wanted, self.limited = [math.nan] * count, [0.0] * count
        self._previous, self._before = [0.0] * count, [0.0] * count
        self._limiters = [_FREE] * count

    def set_limits(self, controller: str, limits: Sequence[AxisLimits]) -> None:
        """Limit each axis from now on; RobotConfigError, and nothing changed, where a minimum is above its maximum."""
        axes = zip(self._axes, limits, strict=True)
        self._limiters = [_limiter(controller, axis, each.limits()) for axis, each in axes]

    @property
    def known(self) -> bool:
        """Whether there is a twist."""
        return not math.isnan(sum(self.wanted))

    @property
    def stands(self) -> bool:
        """Whether the limits have left nothing that moves."""
        return not any(self.limited)

    def limit(self, period: float) -> None:
        """Limit what is wanted against the last two steps; `period` in s."""
        limited, wanted, previous, before = self.limited, self.wanted, self._previous, self._before
        for index, limiter in enumerate(self._limiters):
            limited[index] = limiter.limit(wanted[index], previous[index], before[index], period)

    def step(self) -> None:
        """Let the limited twist be the one before the next."""
        self._before[:] = self._previous
        self._previous[:] = self.limited

    def forget(self) -> None:
        """Have no twist, and stand still before the next."""
        fill(self.wanted, math.nan)
        fill(self._previous, 0.0)
        fill(self._before, 0.0)


def _limiter(controller: str, axis: str, limits: Limits) -> RateLimiter:
    try:
        return RateLimiter(limits)
    except ValueError as error:
        raise RobotConfigError(f"{controller}: {axis}: {error}: a minimum is above its maximum") from error


def fill(values: list[float], value: float) -> None:
    """Make all of them this value."""
    for index in range(len(values)):
        values[index] = value
