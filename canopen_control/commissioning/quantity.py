"""Parsing of numbers within bounds, and of quantities with units such as 20rpm, 90deg or 500pps.

Quantities in counts depend on the drive: the EDS or the drive gives the counts per revolution (0x608F, 0x6091, 0x6092),
or they are guessed. With a guess, only quantities in counts or pps are right. A number without a unit is in SI
units, as everywhere in this package.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.duration import seconds_of
from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable


LONGEST_S: Final = 1e9  # about thirty years


def whole_between(low: int, high: int, noun: str) -> Callable[[str], int]:
    """Return a parser of integers from `low` to `high`, decimal or hexadecimal (0x), with `noun` in its ConfigError."""

    def read(text: str) -> int:
        try:
            value = int(text, 0)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise ConfigError(f"{text!r} is not a {noun}")
        return value

    return read


def number_that(accept: Callable[[float], bool], noun: str) -> Callable[[str], float]:
    """Return a parser of finite numbers that `accept` approves, with `noun` in its ConfigError."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and accept(value)):
            raise ConfigError(f"{text!r} is not a {noun}")
        return value

    return read


def seconds_above_0(text: str) -> float:
    """Parse a number of seconds or a duration with a unit; raise ConfigError unless it is valid and above 0."""
    try:
        value = float(text)
    except ValueError:
        try:
            value = seconds_of(text)
        except ValueError:
            value = math.nan
    if not 0.0 < value < LONGEST_S:
        raise ConfigError(f"{text!r} is not a time in seconds above 0, or with a unit: 500ms, 30s, 5min, 1h")
    return value


_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf(?:inity)?)"
_TEXT: Final = re.compile(rf"({_NUMBER})\s*([a-zA-Z°/]*)", re.IGNORECASE)
POSITIONS: Final = {"": 1.0, "rad": 1.0, "deg": math.radians(1.0), "°": math.radians(1.0), "turns": math.tau}
VELOCITIES: Final = {"": 1.0, "rad/s": 1.0, "rpm": math.tau / 60.0, "deg/s": math.radians(1.0)}
COUNTS: Final = {"position": ("counts",), "velocity": ("pps", "counts/s")}
_KNOWN: Final = {"position": POSITIONS, "velocity": VELOCITIES}


class Quantity(NamedTuple):
    """Number with the unit typed by the user in lower case; `kind` is "position" or "velocity"."""

    value: float
    unit: str
    kind: str

    @property
    def in_counts(self) -> bool:
        """Whether the unit is counts or counts per second."""
        return self.unit in COUNTS[self.kind]

    def __str__(self) -> str:
        return f"{self.value:g}{self.unit}"


def parse_quantity(text: str, kind: str) -> Quantity:
    """Parse a number with a unit of position or velocity; raise ConfigError, with the valid units, if this fails."""
    units = [*filter(None, _KNOWN[kind]), *COUNTS[kind]]
    match = _TEXT.fullmatch(text.strip())
    if match is None:
        raise ConfigError(f"{text!r} is not a {kind}: a number and its unit, such as 10{units[0]} ({', '.join(units)})")
    unit = match[2].lower()
    if unit and unit not in units:
        raise ConfigError(f"{text!r}: {match[2]!r} is not a unit of {kind}; units: {', '.join(units)}")
    value = float(match[1])
    if not math.isfinite(value):
        raise ConfigError(f"{text!r} is not a {kind} that a drive could reach; give a finite number")
    return Quantity(value, unit, kind)


class JogScale(NamedTuple):
    """Number of position counts per revolution of the shaft; `is_known` is False for a guess.

    `of_joint` means that the position is that of a joint of a running robot, in rad. Then `counts` only converts units,
    and the resolution is unknown.
    """

    counts: float
    is_known: bool
    of_joint: bool = False

    @property
    def resolution(self) -> float:
        """Resolution of the position in rad; 0.0 if unknown."""
        return 0.0 if self.of_joint else math.tau / self.counts

    def si(self, quantity: Quantity) -> float:
        """Convert to rad or rad/s; raise ConfigError if the counts per revolution are needed but only guessed."""
        if quantity.in_counts:
            return quantity.value * math.tau / self.counts
        if not self.is_known:
            raise ConfigError(
                f"{quantity}: neither the EDS nor the drive gives the counts per turn (0x608F); give it with "
                f"--counts N, or use raw units: {' or '.join(COUNTS[quantity.kind])}"
            )
        return quantity.value * _KNOWN[quantity.kind][quantity.unit]

    def position_words(self, radians: float) -> str:
        """Format a position in degrees, or in counts if the counts per revolution are guessed."""
        if not self.is_known:
            return f"{radians * self.counts / math.tau:.0f} counts"
        return f"{math.degrees(radians):.1f} deg"

    def velocity_words(self, speed: float) -> str:
        """Format a velocity in rad/s and rpm, or in counts/s if the counts per revolution are guessed."""
        if not self.is_known:
            return f"{speed * self.counts / math.tau:.0f} pps"
        return f"{_rounded(speed, 2)} rad/s ({_rounded(speed * 60.0 / math.tau, 1)} rpm)"


def _rounded(value: float, places: int) -> str:
    """Format a value with `places` decimals, without a minus sign for zero."""
    return f"{round(value, places) + 0.0:.{places}f}"
