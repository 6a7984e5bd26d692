"""Command of a jog, by held keys or for a motion with an end, within limits of speed, travel and torque; units.

Sans-IO, time is `now` in monotonic ns. The drive moves only while a key is held, or until the motion's own end; any
other key, a limit, or a drive that is no longer enabled ends it. `ended` is the reason. Positions are those of the
drive's shaft since the start of the jog.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import Enum
from typing import Final

from canopen_control.client.teleop_keys import Teleop
from canopen_control.errors import ConfigError

# Units of a jog: user input such as `20rpm`, `90deg`, `500pps` to rad and rad/s of the drive's shaft, and back.
#
# The units are those of the drive's own counts. The EDS or the drive gives the counts per revolution (0x608F, 0x6091,
# 0x6092), else they are a guess, with which only counts and counts per second (pps) are correct. A number without a
# unit is in SI units, as everywhere here.


_NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf(?:inity)?)"
_TEXT: Final = re.compile(rf"({_NUMBER})\s*([a-zA-Z°/]*)", re.IGNORECASE)
POSITIONS: Final = {"": 1.0, "rad": 1.0, "deg": math.radians(1.0), "°": math.radians(1.0), "turns": math.tau}
VELOCITIES: Final = {"": 1.0, "rad/s": 1.0, "rpm": math.tau / 60.0, "deg/s": math.radians(1.0)}
COUNTS: Final = {"position": ("counts",), "velocity": ("pps", "counts/s")}
_KNOWN: Final = {"position": POSITIONS, "velocity": VELOCITIES}


@dataclass(frozen=True, slots=True)
class Quantity:
    """Number with its unit as typed; `kind` is "position" or "velocity"."""

    value: float
    unit: str
    kind: str

    @property
    def in_counts(self) -> bool:
        """Whether the unit is the drive's counts, or counts per second."""
        return self.unit in COUNTS[self.kind]

    def __str__(self) -> str:
        return f"{self.value:g}{self.unit}"


def parse_quantity(text: str, kind: str) -> Quantity:
    """Parse a number with a unit of position or velocity; ConfigError with the valid units."""
    units = [*filter(None, _KNOWN[kind]), *COUNTS[kind]]
    match = _TEXT.fullmatch(text.strip())
    if match is None:
        raise ConfigError(f"{text!r} is not a {kind}: a number and its unit, such as 10{units[0]} ({', '.join(units)})")
    unit = match[2].lower()
    if unit and unit not in units:
        raise ConfigError(f"{text!r}: there is no unit {match[2]!r} of a {kind}; there are: {', '.join(units)}")
    value = float(match[1])
    if not math.isfinite(value):
        raise ConfigError(f"{text!r} is not a {kind} that a drive could reach; give a finite number")
    return Quantity(value, unit, kind)


@dataclass(frozen=True, slots=True)
class JogScale:
    """Position counts per revolution of the shaft; `told` is false for a guess.

    `of_joint`: the position is that of a joint of a running robot, in rad. Then `counts` are for units only, and the
    resolution is unknown.
    """

    counts: float
    told: bool
    of_joint: bool = False

    @property
    def resolution(self) -> float:
        """Resolution of the position in rad; 0.0 if unknown."""
        return 0.0 if self.of_joint else math.tau / self.counts

    def si(self, quantity: Quantity) -> float:
        """Return rad or rad/s; ConfigError if the counts per revolution are unknown."""
        if quantity.in_counts:
            return quantity.value * math.tau / self.counts
        if not self.told:
            raise ConfigError(
                f"{quantity}: neither the EDS nor the drive gives the counts per turn (0x608F); give it with "
                f"--counts N, or use raw units: {' or '.join(COUNTS[quantity.kind])}"
            )
        return quantity.value * _KNOWN[quantity.kind][quantity.unit]

    def position_words(self, radians: float) -> str:
        """Return a position as text: degrees if the counts per revolution are known, counts otherwise."""
        if not self.told:
            return f"{radians * self.counts / math.tau:.0f} counts"
        return f"{math.degrees(radians):.1f} deg"

    def velocity_words(self, speed: float) -> str:
        """Return a velocity as text: rad/s and rpm if the counts per revolution are known, counts/s otherwise."""
        if not self.told:
            return f"{speed * self.counts / math.tau:.0f} pps"
        return f"{_rounded(speed, 2)} rad/s ({_rounded(speed * 60.0 / math.tau, 1)} rpm)"


def _rounded(value: float, places: int) -> str:
    """Return a number as text, without the sign of a zero."""
    return f"{round(value, places) + 0.0:.{places}f}"


HELP: Final = """\
  up, right (i, l)     forward while the key is held      q/z  faster/slower by 10 %
  down, left (k .. m)  backward                           any other key stops; Ctrl-C ends"""
_FORWARD: Final = frozenset(("up", "right", "i", "l"))
_BACKWARD: Final = frozenset(("down", "left", ",", "j"))
_SETTLED: Final = 0.002  # of a turn, a target is reached
_TURNED: Final = 0.02  # of what was commanded: less is the play of a shaft that is held
_COUNTS: Final = 2.0  # of the position: fewer are the noise of one that stands


class JogKind(Enum):
    """Quantity that a jog commands."""

    VELOCITY = "velocity"
    POSITION = "position"
    TORQUE = "effort"


class JogEnd(Enum):
    """Reason for the end of a jog; those other than success are failures."""

    NONE = ""
    ASKED = "ended by a key"
    GONE = "the terminal is gone"
    OVER = "duration elapsed"
    THERE = "there"
    TRAVEL = "the travel limit is reached"
    SPEED = "the speed limit is reached"
    CURRENT = "the current limit is reached"
    STATE = "the drive is not enabled any more"

    @property
    def failed(self) -> bool:
        """Whether a cause other than the user ended it."""
        return self in (JogEnd.SPEED, JogEnd.CURRENT, JogEnd.STATE)


@dataclass(frozen=True, slots=True)
class JogLimits:
    """Limits: `speed` in rad/s, `travel` in rad in each direction, `current` in 1/1000 of the rated current."""

    speed: float
    travel: float
    current: float


class JogMotion:
    """Jog of `value` (rad/s, rad from the start, or per mille): by held keys, or for `seconds`.

    `command` is the value to send; a position is None until the start is known.
    """

    def __init__(self, kind: JogKind, value: float, limits: JogLimits, *, seconds: float | None, now: int) -> None:
        self.kind, self.limits = kind, limits
        self.ended, self.note = JogEnd.NONE, ""
        self._value = value
        self._held = kind is not JogKind.POSITION and seconds is None
        self._deadline = None if seconds is None else now + round(seconds * 1e9)
        self._keys = Teleop(abs(value), abs(value))
        self._sign = 0
        self._commanded = False
        self._start: float | None = None
        self._here = math.nan
        self._seconds = seconds
        self._farthest = self._fastest = math.nan

    @property
    def by_keys(self) -> bool:
        """Whether held keys move the drive."""
        return self._held

    @property
    def speed(self) -> float:
        """Speed commanded by a held key."""
        return self._keys.speed

    @property
    def travelled(self) -> float:
        """Distance of the shaft from the start in rad; nan if unknown."""
        return math.nan if self._start is None else self._here - self._start

    @property
    def command(self) -> float | None:
        """Value to send; 0 at rest, None for a position that is still unknown."""
        if self.kind is JogKind.POSITION:
            return None if self._start is None else self._start + self._value
        if self.ended is not JogEnd.NONE:
            return 0.0
        if not self._held:
            return self._value
        sign = self._direction()
        return 0.0 if sign == 0 or self._blocked(sign) else math.copysign(self._keys.speed, sign)

    def nothing_turned(self, resolution: float) -> str | None:
        """Return a sentence if no rotation of the shaft was measured, None otherwise.

        `resolution` of its position in rad.
        """
        if math.isnan(self._farthest):
            if self._fastest > 0.0:  # not for nan
                return None
            return "nothing was seen to turn: the drive shows no position"
        distance = abs(self._value) if self.kind is JogKind.POSITION else 0.0
        if self.kind is JogKind.VELOCITY and self._seconds is not None and self.ended is JogEnd.OVER:
            distance = abs(self._value) * self._seconds
        if self._farthest > max(_COUNTS * resolution, _TURNED * distance):
            return None
        if self._held and not self._commanded:
            return "nothing turned: no key was held"
        return (
            "nothing turned: the drive was commanded and its position stayed; see whether the shaft is blocked, a "
            "brake is closed, the torque is too small, or the scale (--counts) is wrong"
        )

    def key(self, name: str, now: int) -> None:
        """Process a key of `KeyDecoder`; every key ends a motion with an end."""
        if name == "focus-in":
            return
        if not self._held:
            self.end(JogEnd.ASKED)
            return
        self.note = ""
        self._commanded = self._commanded or name in _FORWARD or name in _BACKWARD
        self._sign = 1 if name in _FORWARD else -1 if name in _BACKWARD else self._sign
        if name in _FORWARD or name in _BACKWARD:
            name = "up" if name in _FORWARD else "down"  # one key for each way: its repetition is what holds
        elif name in ("q", "z", "w", "x"):
            pass
        else:
            self._sign = 0
            name = name if name in ("ctrl-c", "ctrl-d", "focus-out") else "space"
        self._keys.key(name, now)
        self._bound()
        self.note = self._keys.note
        if self._keys.ended:
            self.end(JogEnd.ASKED)

    def tick(self, now: int) -> None:
        """Process time: release a key that is not repeated, complete a motion with an end."""
        self._keys.tick(now)
        if self._deadline is not None and now >= self._deadline:
            self.end(JogEnd.OVER)

    def next_deadline(self) -> int | None:
        """Return when `tick` has something to do."""
        deadlines = [deadline for deadline in (self._keys.next_deadline(), self._deadline) if deadline is not None]
        return min(deadlines, default=None)

    def see(self, position: float | None, velocity: float | None, current: float | None, *, enabled: bool) -> None:
        """Process the state of the drive: rad, rad/s, per mille, None if unknown."""
        if not enabled:
            self.end(JogEnd.STATE)
        if current is not None and abs(current) > self.limits.current:
            self.end(JogEnd.CURRENT)
        if velocity is not None and math.isfinite(velocity):
            self._fastest = max(abs(velocity), 0.0 if math.isnan(self._fastest) else self._fastest)
        if position is None or not math.isfinite(position):
            return
        if self._start is None:
            self._start = position
        self._here = position
        self._farthest = max(abs(self.travelled), 0.0 if math.isnan(self._farthest) else self._farthest)
        self._check_travel(velocity)

    def end(self, why: JogEnd) -> None:
        """End the jog; the first reason is kept."""
        if self.ended is JogEnd.NONE:
            self.ended = why
        self._keys.stop()

    # -- inside

    def _direction(self) -> int:
        return self._sign if self._keys.velocities.moving else 0

    def _blocked(self, sign: int) -> bool:
        """Return whether the travel in this direction is used up."""
        return not math.isnan(self.travelled) and sign * self.travelled >= self.limits.travel

    def _check_travel(self, velocity: float | None) -> None:
        if self.kind is JogKind.POSITION:
            near = abs(self.travelled - self._value) <= min(_SETTLED * math.tau, 0.5 * abs(self._value))
            if near and (velocity is None or abs(velocity) <= self.limits.speed / 20):
                self.end(JogEnd.THERE)
            return
        sign = self._direction() if self._held else int(math.copysign(1, self._value))
        if not sign or not self._blocked(sign):
            return
        if self._held:
            self.note = "the travel limit is reached, it goes the other way only (--max-travel)"
        else:
            self.end(JogEnd.TRAVEL)

    def _bound(self) -> None:
        """Limit the speed selected by keys."""
        most = self.limits.current if self.kind is JogKind.TORQUE else self.limits.speed
        self._keys.speed = self._keys.turn = min(self._keys.speed, most)
