"""Step response metrics: delay, rise time, overshoot, settling time, steady-state error, ripple, ITAE.

Rise is from 10 to 90 % of the step, settling is into a band around the final value for the rest of the record, the
final value is the mean of its last fifth. Times are seconds since the step was commanded, so they hold the dead time of
the bus; between two samples the response is a straight line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from canopen_control.errors import DriveError

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["StepMetrics", "step_metrics"]

BAND: Final = 0.02  # of the step
_FEWEST: Final = 10  # samples behind the step
_TAIL: Final = 5  # the last part of the record in which it is to stand
_LEAST: Final = 0.2  # of the step has to arrive, else there is nothing to measure


@dataclass(frozen=True, slots=True)
class StepMetrics:
    """A step from `before` to `wanted` that came to `final`; times in s, `settling` None where it never settles.

    `overshoot` is a part of what was reached, `error` what is missing, `ripple` the root mean square around the final
    value and `itae` the integral of time times absolute error; in the unit of the response.
    """

    wanted: float
    final: float
    delay: float
    rise: float
    overshoot: float
    settling: float | None
    error: float
    ripple: float
    itae: float


def step_metrics(times: Sequence[float], values: Sequence[float], wanted: float, *, band: float = BAND) -> StepMetrics:
    """Measure the response to a step from 0 to `wanted` at time 0; earlier samples say where it began.

    DriveError where it did not follow.
    """
    before = [value for time, value in zip(times, values, strict=True) if time < 0.0]
    rows = [(time, value) for time, value in zip(times, values, strict=True) if time >= 0.0]
    if len(rows) < _FEWEST:
        raise DriveError(f"{len(rows)} samples of the step are too few to judge it; take a longer one: --for S")
    base = before[-1] if before else rows[0][1]
    tail = [value for _, value in rows[-max(1, len(rows) // _TAIL) :]]
    final = sum(tail) / len(tail)
    height = final - base
    if abs(height) < _LEAST * abs(wanted - base) or height * (wanted - base) <= 0.0:
        raise DriveError(
            f"the drive did not follow the step: {wanted - base:g} was asked for and {height:g} came; "
            "look at its limits, ramps and load"
        )
    shares = [(time, (value - base) / height) for time, value in rows]
    rise_begin, rise_end = _crossing(shares, 0.1), _crossing(shares, 0.9)
    return StepMetrics(
        wanted=wanted,
        final=final,
        delay=_crossing(shares, 0.05),
        rise=rise_end - rise_begin,
        overshoot=max(0.0, max(share for _, share in shares) - 1.0),
        settling=_settling(shares, band),
        error=wanted - final,
        ripple=math.sqrt(sum((value - final) ** 2 for value in tail) / len(tail)),
        itae=_itae(rows, wanted),
    )


def _crossing(shares: Sequence[tuple[float, float]], level: float) -> float:
    """Return when a level is passed for the first time."""
    last: tuple[float, float] | None = None
    for time, share in shares:
        if share >= level:
            if last is None or share == last[1]:
                return time
            return last[0] + (time - last[0]) * (level - last[1]) / (share - last[1])
        last = (time, share)
    return shares[-1][0]


def _settling(shares: Sequence[tuple[float, float]], band: float) -> float | None:
    """Return from when on it stays within the band; None where it leaves it in the last part of the record."""
    outside = [place for place, (_, share) in enumerate(shares) if abs(share - 1.0) > band]
    if not outside:
        return shares[0][0]
    place = outside[-1] + 1
    return None if place >= len(shares) - len(shares) // _TAIL else shares[place][0]


def _itae(rows: Sequence[tuple[float, float]], wanted: float) -> float:
    total = 0.0
    for (time, value), (after, next_value) in pairwise(rows):
        total += 0.5 * (after - time) * (time * abs(wanted - value) + after * abs(wanted - next_value))
    return total
