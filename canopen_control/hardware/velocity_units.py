"""Units of velocity that drives have, recognised by a motion that is far from the velocity they report.

Positions are taken as right, since their counts do not depend on a unit of time. A velocity is doubted where the motion
is three times as fast or as slow as it; the likely unit is the one of the table that fits the motion. Units are those
of CiA 402-2 and CiA 303-2 that drives are set to, by how many of them one turn of the motor per second is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from canopen_control.hardware.axis import Axis

__all__ = ["UnitDoubt", "doubt_unit"]

# Motion for what a unit says: of a drive that keeps its velocity, and of one that still speeds up.
_STEADY_MIN: Final = 0.7
_STEADY_MAX: Final = 1.3
_RISING_MIN: Final = 0.25
_RISING_MAX: Final = 1.5
_FAR: Final = 3.0  # how many times as fast or as slow as told a motion is that doubts the unit of velocities
_COUNTS: Final = "counts per second"
_UNITS: Final = {
    "rpm": 60.0,
    "0.1 rpm": 600.0,
    "deg/s": 360.0,
    "0.1 deg/s": 3600.0,
    "rev/s": 1.0,
    "0.001 rev/s": 1000.0,
}
_SI_UNITS: Final = {"rpm": 0x00B44700, "0.1 rpm": 0xFFB44700}
"""0x60A9 for the units that a robot can take from the drive."""


@dataclass(frozen=True, slots=True)
class UnitDoubt:
    """A doubt about the unit of a drive's velocities: a sentence, and whether it is `faster` than they say."""

    text: str
    faster: bool


def doubt_unit(axis: Axis, speed: float, raw: int, *, rising: bool) -> UnitDoubt | None:
    """Hold a motion in position counts/s against a velocity of the drive's; None where no unit would explain it.

    `rising`: the motion is that between two samples, of a drive that may still get faster.
    """
    reported = raw * axis.scale.vel_from_dev * axis.scale.pos_to_dev
    if not speed or not reported or 1.0 / _FAR < abs(speed / reported) < _FAR:
        return None
    least = _RISING_MIN if rising else _STEADY_MIN
    most = _RISING_MAX if rising else _STEADY_MAX
    fits: dict[float, tuple[str, float]] = {}
    for name, per_turn in {**_UNITS, _COUNTS: axis.turn}.items():
        ratio = abs(speed / axis.turn * per_turn / raw)
        if least < ratio < most:
            fits[abs(math.log(ratio))] = name, per_turn
    if not fits:
        return None
    faster = abs(speed) > abs(reported)
    return UnitDoubt(_words(axis, [fits[each] for each in sorted(fits)], faster=faster), faster)


def _words(axis: Axis, units: list[tuple[str, float]], *, faster: bool) -> str:
    """Say that velocities are in one of `units`, the likeliest first, and how bus.yml is told so."""
    (first, per_turn), scale = units[0], axis.scale
    to_dev = math.copysign(per_turn * abs(scale.pos_to_dev) / axis.turn, scale.vel_to_dev)
    names = " or ".join(name for name, _ in units)
    in_eds = f"by 0x60A9 in its EDS (0x{_SI_UNITS[first]:08X}), or " if first in _SI_UNITS else ""
    of_first = f" for {first}" if len(units) > 1 else ""
    instead = "another unit" if first == _COUNTS else _COUNTS
    return (
        f"it turns much {'faster' if faster else 'slower'} than its velocity (0x606C) says, as a drive does whose "
        f"velocities are in {names} and not in {instead}; say so {in_eds}by the four scales in bus.yml{of_first} "
        f"(scale_vel_to_dev: {to_dev:.7g}, scale_vel_from_dev: {1.0 / to_dev:.7g})"
    )
