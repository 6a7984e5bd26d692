"""One measured quantity, its peer or limit, and the assessment.

A figure that is checked is checked by one number alone, the median of its rounds, and a round
compares what was measured right after another. A ratio is robust on a loaded machine, and so is a count of what may
not happen at all; a time is not, so that `quick` runs look at what is `steady` only.
"""

from __future__ import annotations

import statistics
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


AT_MOST, AT_LEAST = "at most", "at least"
OWN_CPU = "CPU"  # peer of a figure that is a quantity per second of this process's CPU time: the ratio is the result
_POINTS = (("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("p99.9", 0.999), ("max", 1.0))


@dataclass(frozen=True, slots=True)
class Figure:
    """One row of the table.

    `ours` and `peer` are medians in `unit`; `peer` is None where there is nobody to compare with, and `ratio` is then
    None too. `limit` is what the ratio must not pass in `direction`, or, without a peer, what `ours` must not pass;
    None: only shown. `absolutes` holds whatever else was seen, by name.
    """

    name: str
    unit: str
    ours: float
    peer: float | None = None
    ratio: float | None = None
    limit: float | None = None
    direction: str = AT_MOST
    peer_name: str = ""
    absolutes: Mapping[str, float | str] = field(default_factory=dict)
    counted: bool = False

    @property
    def steady(self) -> bool:
        """Whether a busy machine does not affect it: a ratio, or a count instead of a time."""
        return self.ratio is not None or self.counted

    @property
    def judged(self) -> float:
        """The value that is compared with the limit: the ratio, or the measured value if there is no peer."""
        return self.ours if self.ratio is None else self.ratio

    @property
    def good(self) -> bool:
        """Whether it meets its limit; true if it is only shown. NaN is never good."""
        if self.limit is None:
            return True
        return self.judged <= self.limit if self.direction == AT_MOST else self.judged >= self.limit

    def as_dict(self) -> dict[str, Any]:
        """Return it as a JSON-compatible dict."""
        return {**asdict(self), "good": self.good}


def compared(
    name: str,
    unit: str,
    rounds: Sequence[tuple[float, float]],
    *,
    peer_name: str,
    limit: float | None = None,
    direction: str = AT_MOST,
    absolutes: Mapping[str, float | str] | None = None,
) -> Figure:
    """Return the figure for rounds of (ours, the peer's): the medians, and the median of the ratios per round."""
    ours, peer = (statistics.median(values) for values in zip(*rounds, strict=True))
    ratio = statistics.median(mine / theirs for mine, theirs in rounds)
    return Figure(name, unit, ours, peer, ratio, limit, direction, peer_name, dict(absolutes or {}))


def limited(
    name: str,
    unit: str,
    rounds: Sequence[float],
    *,
    limit: float | None = None,
    direction: str = AT_MOST,
    absolutes: Mapping[str, float | str] | None = None,
    counted: bool = False,
) -> Figure:
    """Return the figure for rounds of one quantity that is compared with a limit."""
    ours, told = statistics.median(rounds), dict(absolutes or {})
    return Figure(name, unit, ours, limit=limit, direction=direction, absolutes=told, counted=counted)


def percentile(values: Sequence[float], part: float) -> float:
    """Return the value below which the `part` (0 to 1) of the values lies; 0.0 if empty."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(part * len(ordered)))] if ordered else 0.0


def percentiles(values: Sequence[float], scale: float = 1.0) -> dict[str, float]:
    """Return p50, p90, p99, p99.9 and max of the values, each times `scale`."""
    return {name: percentile(values, part) * scale for name, part in _POINTS}
