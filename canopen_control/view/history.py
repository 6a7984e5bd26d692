"""The last 30 seconds of a few numbers, ten a second: what a page that is opened shows of the time before.

Where there was no sample, or a value was not known, nothing is made up.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = ["RATE", "SPAN_S", "History", "Row"]

SPAN_S: Final = 30.0
RATE: Final = 10  # samples that are kept of a second
_SIZE: Final = round(SPAN_S * RATE) + 1
Row = list[float | None]
"""The time, then a value for each name; None where nobody knew."""


class History:
    """Rows of `names`; times are Unix seconds."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._rows: deque[Row] = deque(maxlen=_SIZE)
        self._slot: int | None = None
        self._new = 0

    def add(self, time: float, values: Mapping[str, float | None]) -> None:
        """Take a sample; of those within a tenth of a second the last is kept."""
        slot = math.floor(time * RATE + 1e-6)
        if self._slot is not None and slot < self._slot:
            self.clear()  # the clock was set back
        if slot == self._slot:
            self._rows.pop()
        else:
            self._new += 1
        self._slot = slot
        self._rows.append([time, *(_finite(values.get(name)) for name in self.names)])

    def rows(self) -> list[Row]:
        """Return everything, oldest first."""
        return list(self._rows)

    def take_new_rows(self) -> list[Row]:
        """Return the rows that are finished and have not been taken, oldest first."""
        rows, count = list(self._rows), min(self._new, len(self._rows))
        if count < 2:
            return []
        self._new = 1
        return rows[-count:-1]

    def clear(self) -> None:
        """Forget everything."""
        self._rows.clear()
        self._slot, self._new = None, 0


def _finite(value: float | None) -> float | None:
    return round(value, 6) if value is not None and math.isfinite(value) else None
