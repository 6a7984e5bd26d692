"""The last 30 seconds of a few numbers, at an even pace, ready to be plotted.

The law of this file: memory is taken once; where there was no sample, or a value was not known, nothing is made up.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = ["SPAN_S", "History"]

Row = np.ndarray[tuple[int], np.dtype[np.float64]]

SPAN_S: Final = 30.0
_RATE: Final = 10  # samples that are kept of a second
_SIZE: Final = round(SPAN_S * _RATE) + 1


class History:
    """Rows of `names`; the newest sample is the last column. Times are Unix seconds."""

    def __init__(self, names: Sequence[str]) -> None:
        self._rows = {name: np.full(_SIZE, np.nan) for name in names}
        self._slot: int | None = None
        self.ages = np.linspace(-SPAN_S, 0.0, _SIZE)
        """Seconds before the newest sample, for the x axis."""

    def add(self, time: float, values: Mapping[str, float | None]) -> bool:
        """Take a sample; False if it falls into the slot of the one before, whose values it then replaces."""
        slot = math.floor(time * _RATE + 1e-6)
        steps = _SIZE if self._slot is None or slot < self._slot else min(slot - self._slot, _SIZE)
        self._slot = slot
        for name, row in self._rows.items():
            if steps:
                row[:-steps] = row[steps:]
                row[-steps:] = np.nan
            value = values.get(name)
            row[-1] = np.nan if value is None else value
        return steps > 0

    def columns(self, names: Sequence[str]) -> tuple[Row, ...]:
        """Return ages and rows, copied, of the samples where all of these have a value; a plot knows no nan.

        Without any such sample it is a single zero, now.
        """
        rows = [self._rows[name] for name in names]
        there = np.isfinite(rows).all(axis=0)
        if not there.any():
            return tuple(np.zeros(1) for _ in range(len(rows) + 1))
        return self.ages[there], *(row[there] for row in rows)

    def clear(self) -> None:
        """Forget everything."""
        for row in self._rows.values():
            row.fill(np.nan)
