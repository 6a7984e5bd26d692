"""Durations as text: `1h`, `5min`, `30s`, `500ms`, or a number of seconds."""

from __future__ import annotations

import re
from typing import Final

_TEXT: Final = re.compile(r"(\d+(?:\.\d+)?)\s*(ms|s|min|h)?")
_FACTORS: Final = {"ms": 0.001, "s": 1.0, "min": 60.0, "h": 3600.0, None: 1.0}
_LONGEST: Final = 1e6  # maximum number, in its unit


def seconds_of(value: float | str) -> float:
    """Return the seconds in `1h`, `5min`, `5s`, `500ms` or a number; raise ValueError if invalid."""
    match = _TEXT.fullmatch(str(value).strip())
    if match is None or float(match[1]) > _LONGEST:
        raise ValueError(f"{value!r} is not a time: 1h, 5min, 5s, 500ms, or a number of seconds")
    return float(match[1]) * _FACTORS[match[2]]


def nanoseconds_of(value: float | str) -> int:
    """Return a time in ns, from the same texts as `seconds_of`."""
    return round(seconds_of(value) * 1e9)
