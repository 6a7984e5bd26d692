"""Units of a jog: `20rpm`, `90deg`, `500pps` as people write them, to rad and rad/s of the drive's shaft and back.

The units are those of the drive's own counts: how many make a turn is what the EDS or the drive tells (0x608F, 0x6091,
0x6092), else a guess, by which counts and counts per second (pps) are right all the same, and nothing else is. A
number without a unit is in SI, as everywhere here.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final

from canopen_control.errors import ConfigError

__all__ = ["JogScale", "Quantity", "parse_quantity"]

_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf(?:inity)?)"
_TEXT: Final = re.compile(rf"({_NUMBER})\s*([a-zA-Z°/]*)", re.IGNORECASE)
POSITIONS: Final = {"": 1.0, "rad": 1.0, "deg": math.radians(1.0), "°": math.radians(1.0), "turns": math.tau}
VELOCITIES: Final = {"": 1.0, "rad/s": 1.0, "rpm": math.tau / 60.0, "deg/s": math.radians(1.0)}
COUNTS: Final = {"position": ("counts",), "velocity": ("pps", "counts/s")}
_KNOWN: Final = {"position": POSITIONS, "velocity": VELOCITIES}


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number with its unit, as it was written; `kind` is "position" or "velocity"."""

    value: float
    unit: str
    kind: str

    @property
    def in_counts(self) -> bool:
        """Whether it is in the drive's own counts, or counts per second."""
        return self.unit in COUNTS[self.kind]

    def __str__(self) -> str:
        return f"{self.value:g}{self.unit}"


def parse_quantity(text: str, kind: str) -> Quantity:
    """Read a number with a unit of positions or velocities; ConfigError names the units there are."""
    units = [*filter(None, _KNOWN[kind]), *COUNTS[kind]]
    match = _TEXT.fullmatch(text.strip())
    if match is None:
        raise ConfigError(f"{text!r} is no {kind}: a number and its unit, such as 10{units[0]} ({', '.join(units)})")
    unit = match[2].lower()
    if unit and unit not in units:
        raise ConfigError(f"{text!r}: there is no unit {match[2]!r} of a {kind}; there are: {', '.join(units)}")
    value = float(match[1])
    if not math.isfinite(value):
        raise ConfigError(f"{text!r} is no {kind} that a drive could reach; give a finite number")
    return Quantity(value, unit, kind)


@dataclass(frozen=True, slots=True)
class JogScale:
    """Position counts of one turn of the shaft; `told` is False where they are a guess.

    `of_joint`: the position is that of a joint of a running robot, in rad. Then `counts` are for units alone, and how
    finely the drive counts is not known.
    """

    counts: float
    told: bool
    of_joint: bool = False

    @property
    def resolution(self) -> float:
        """The step of the position in rad; 0.0 where it is not known."""
        return 0.0 if self.of_joint else math.tau / self.counts

    def si(self, quantity: Quantity) -> float:
        """Return rad or rad/s; ConfigError for what cannot be, since nobody knows what a turn is."""
        if quantity.in_counts:
            return quantity.value * math.tau / self.counts
        if not self.told:
            raise ConfigError(
                f"{quantity}: neither the EDS nor the drive gives the counts per turn (0x608F); give it with "
                f"--counts N, or use raw units: {' or '.join(COUNTS[quantity.kind])}"
            )
        return quantity.value * _KNOWN[quantity.kind][quantity.unit]

    def position_words(self, radians: float) -> str:
        """Return a position for people: degrees where a turn is known, counts elsewhere."""
        if not self.told:
            return f"{radians * self.counts / math.tau:.0f} counts"
        return f"{math.degrees(radians):.1f} deg"

    def velocity_words(self, speed: float) -> str:
        """Return a velocity for people: rad/s and rpm where a turn is known, counts per second elsewhere."""
        if not self.told:
            return f"{speed * self.counts / math.tau:.0f} pps"
        return f"{_rounded(speed, 2)} rad/s ({_rounded(speed * 60.0 / math.tau, 1)} rpm)"


def _rounded(value: float, places: int) -> str:
    """Return a number without the sign of a zero."""
    return f"{round(value, places) + 0.0:.{places}f}"
