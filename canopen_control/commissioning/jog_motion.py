"""Command of a jog by held keys or with a defined end, within limits on speed, travel and current.

Sans-IO; times are monotonic nanoseconds. The drive moves only while a key is held, or until the end of the motion.
Ctrl-C, the current limit, or a drive that is not enabled any more ends the jog; `ended` is the reason. A motion with a
defined end is also ended by any key, and a motion with a duration by the travel limit, at which a jog by keys can only
turn back. Positions are angles of the shaft since the start of the jog.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final

from canopen_control.client.teleop_keys import Teleop

if TYPE_CHECKING:
    from canopen_control.commissioning.jobs import MotionOptions
    from canopen_control.commissioning.quantity import JogScale, Quantity


HELP: Final = """\
  up, right (i, l)     forward while the key is held      q/z  faster/slower by 10 %
  down, left (k .. m)  backward                           any other key stops; Ctrl-C ends"""
_FORWARD: Final = frozenset(("up", "right", "i", "l"))
_BACKWARD: Final = frozenset(("down", "left", ",", "j"))
_SETTLED: Final = 0.002  # fraction of a turn within which a target counts as reached
_TURNED: Final = 0.02  # fraction of the commanded distance; a blocked shaft with backlash moves less
_COUNTS: Final = 2.0  # position counts; the noise at standstill is less


class JogKind(Enum):
    """Quantities that a jog can command; the values are names of command interfaces."""

    VELOCITY = "velocity"
    POSITION = "position"
    TORQUE = "effort"


class JogEnd(Enum):
    """Reasons for the end of a jog; the values are texts for users."""

    NONE = ""
    REQUESTED = "ended by a key"
    INTERRUPTED = "interrupted by a signal"
    TERMINAL_CLOSED = "the terminal was closed"
    SUSPENDED = "this program was suspended"
    OVER = "duration elapsed"
    THERE = "target position reached"
    TRAVEL = "the travel limit is reached"
    SPEED = "the speed limit is reached"
    CURRENT = "the current limit is reached"
    BLIND = "the drive reports neither position nor velocity, so no limit can be monitored"
    STATE = "the drive is not enabled any more"

    @property
    def failed(self) -> bool:
        """Whether a suspension, a limit of speed or current, missing feedback or the drive's state ended the jog."""
        return self in (JogEnd.SUSPENDED, JogEnd.SPEED, JogEnd.CURRENT, JogEnd.BLIND, JogEnd.STATE)


@dataclass(frozen=True, slots=True)
class JogLimits:
    """Limits of `speed` in rad/s, `travel` in rad per direction, and `current` in per mille of the rated current."""

    speed: float
    travel: float
    current: float


BLIND_S: Final = 0.1  # time without feedback after which a torque ends, because a free shaft accelerates without limit
MAX_SPEED: Final = math.tau  # default in rad/s
_MAX_TRAVEL: Final = 10.0 * math.tau  # default in rad


def limits_of(options: MotionOptions, scale: JogScale, speed: float = MAX_SPEED) -> JogLimits:
    """Return the limits of a motion; raise ConfigError for a unit that needs an unknown scale.

    `speed` is the default speed in rad/s.
    """

    def limit(quantity: Quantity | None, otherwise: float) -> float:
        return otherwise if quantity is None else abs(scale.si(quantity))

    return JogLimits(limit(options.max_speed, speed), limit(options.max_travel, _MAX_TRAVEL), options.max_current)


class JogMotion:
    """Jog by held keys, for `seconds`, or to a position; `value` is in rad/s, in rad from the start, or per mille.

    `command` is the value to send; for a position it is None until the start position is known. The travel of a drive
    without a position is computed from its velocity, measured or commanded; a torque needs one of both measured.
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
        self._velocity = 0.0
        self._computed_travel = 0.0  # travel of a drive without a position
        self._now = self._before = self._seen_at = now

    @property
    def by_keys(self) -> bool:
        return self._held

    @property
    def speed(self) -> float:
        """Value commanded while a key is held, in rad/s or per mille."""
        return self._keys.speed

    @property
    def travelled(self) -> float:
        """Signed distance of the shaft from the start in rad; nan if unknown."""
        return math.nan if self._start is None else self._here - self._start

    @property
    def command(self) -> float | None:
        """Value to send: 0 for no motion, or None for a position before the start position is known."""
        if self.kind is JogKind.POSITION:
            return None if self._start is None else self._start + self._value
        if self.ended is not JogEnd.NONE:
            return 0.0
        sign = self._direction() if self._held else int(math.copysign(1, self._value))
        if sign == 0 or (self._held and self._blocked(sign)) or self._is_fast(sign):
            return 0.0
        return math.copysign(self._keys.speed, sign) if self._held else self._value

    def nothing_turned(self, resolution: float) -> str | None:
        """Return a sentence if the shaft did not turn measurably, or if that is unknown, else None.

        `resolution` is the resolution of the measured position in rad.
        """
        if math.isnan(self._farthest):
            if self._fastest > 0.0:  # False for nan
                return None
            return "unknown whether the shaft turned: the drive reports no position"
        distance = abs(self._value) if self.kind is JogKind.POSITION else 0.0
        if self.kind is JogKind.VELOCITY and self._seconds is not None and self.ended is JogEnd.OVER:
            distance = abs(self._value) * self._seconds
        if self._farthest > max(_COUNTS * resolution, _TURNED * distance):
            return None
        if self._held and not self._commanded:
            return "the shaft did not turn: no key was held"
        return (
            "the shaft did not turn although a motion was commanded; check whether the shaft is blocked, a "
            "brake is closed, the torque is too small, or the scale (--counts) is wrong"
        )

    def key(self, name: str, now: int) -> None:
        """Handle a key from `KeyDecoder`; any key ends a motion that has a defined end."""
        if name == "focus-in":
            return
        if not self._held:
            self.end(JogEnd.REQUESTED)
            return
        self.note = ""
        self._commanded = self._commanded or name in _FORWARD or name in _BACKWARD
        self._sign = 1 if name in _FORWARD else -1 if name in _BACKWARD else self._sign
        if name in _FORWARD or name in _BACKWARD:
            # one key for each direction: its repetition keeps the motion alive
            name = "up" if name in _FORWARD else "down"
        elif name in ("q", "z", "w", "x"):
            pass
        else:
            self._sign = 0
            name = name if name in ("ctrl-c", "ctrl-d", "focus-out") else "space"
        self._keys.key(name, now)
        self._bound()
        self.note = self._keys.note
        if self._keys.ended:
            self.end(JogEnd.REQUESTED)

    def tick(self, now: int) -> None:
        """Advance the time: release a key that is no longer repeated, or end a motion after its duration."""
        self._now = now
        self._keys.tick(now)
        if self._deadline is not None and now >= self._deadline:
            self.end(JogEnd.OVER)

    def next_deadline(self) -> int | None:
        """Return the time of the next `tick` that has an effect, or None."""
        deadlines = [deadline for deadline in (self._keys.next_deadline(), self._deadline) if deadline is not None]
        return min(deadlines, default=None)

    def see(self, position: float | None, velocity: float | None, current: float | None, *, enabled: bool) -> None:
        """Record measured values; end the jog above the current limit, at the target, or if the drive is not enabled.

        Values are in rad, rad/s and per mille; unknown values are None. The travel limit ends a motion with a duration.
        """
        if not enabled:
            self.end(JogEnd.STATE)
        if current is not None and abs(current) > self.limits.current:
            self.end(JogEnd.CURRENT)
        if velocity is not None and not math.isfinite(velocity):
            velocity = None
        self._velocity = velocity or 0.0
        if velocity is not None:
            self._fastest = max(abs(velocity), 0.0 if math.isnan(self._fastest) else self._fastest)
        if position is None or not math.isfinite(position):
            self._compute_travel(velocity)
            return
        self._seen_at = self._before = self._now
        if self._start is None:
            self._start = position
        self._here = position
        self._farthest = max(abs(self.travelled), 0.0 if math.isnan(self._farthest) else self._farthest)
        self._check_travel(velocity)

    def end(self, why: JogEnd) -> None:
        """End the jog with a reason; the first reason is kept."""
        if self.ended is JogEnd.NONE:
            self.ended = why
        self._keys.stop()

    # -- inside

    def _direction(self) -> int:
        return self._sign if self._keys.velocities.moving else 0

    def _compute_travel(self, velocity: float | None) -> None:
        """Compute the travel of a drive without a position, and end a torque without any feedback."""
        seconds, self._before = (self._now - self._before) * 1e-9, self._now
        if velocity is not None:
            self._seen_at = self._now
            self._computed_travel += velocity * seconds
        elif self.kind is JogKind.VELOCITY:
            self._computed_travel += (self.command or 0.0) * seconds
        elif self.kind is JogKind.TORQUE and self._now - self._seen_at > BLIND_S * 1e9:
            self.end(JogEnd.BLIND)
        if self.kind is not JogKind.POSITION:
            self._check_travel(velocity)

    def _is_fast(self, sign: int) -> bool:
        """Whether a torque in this direction would accelerate a shaft beyond the speed limit."""
        return self.kind is JogKind.TORQUE and sign * self._velocity >= self.limits.speed

    def _blocked(self, sign: int) -> bool:
        """Whether the travel in this direction is exhausted."""
        travelled = self._computed_travel if math.isnan(self.travelled) else self.travelled
        return sign * travelled >= self.limits.travel

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
            self.note = "the travel limit is reached; only the other direction is possible (--max-travel)"
        else:
            self.end(JogEnd.TRAVEL)

    def _bound(self) -> None:
        """Limit the speed selected by keys."""
        most = self.limits.current if self.kind is JogKind.TORQUE else self.limits.speed
        self._keys.speed = self._keys.turn = min(self._keys.speed, most)
