"""What a tuning run commands now: an excitation within limits of travel, speed and current, and why it ended.

Sans-IO, time is `now` in monotonic nanoseconds. The run ends by itself where the way that is left is no longer than
what stopping takes, above the limit of speed, above that of the current for `PEAK_S`, and with a drive that is no
longer enabled; nothing is commanded then. A torque moves a free shaft as far as it likes: `STEERED` of the excitation
pushes it, both ways in turn as the identification of friction needs it, and back as soon as half of the travel or of
the speed is used up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.service.jog_motion import JogEnd, JogKind

if TYPE_CHECKING:
    from canopen_control.service.excitation import Excitation
    from canopen_control.service.jog_motion import JogLimits

__all__ = ["PEAK_S", "STEERED", "TuneMotion", "TuneRecord", "TuneSample"]

STEERED: Final = 0.6  # of the peak of the excitation
PEAK_S: Final = 0.1  # for which the current may be higher: a step asks for what the loop can give
_HALF: Final = 0.5


@dataclass(frozen=True, slots=True)
class TuneSample:
    """One cycle: its number, what was commanded in it, and what the drive showed: rad, rad/s, per mille."""

    cycle: int
    command: float
    position: float | None = None
    velocity: float | None = None
    effort: float | None = None


@dataclass(slots=True)
class TuneRecord:
    """The samples of a run in their order, `period` in s; `lost` counts the cycles of which none came."""

    period: float
    samples: list[TuneSample] = field(default_factory=list)
    lost: int = 0

    def put(self, sample: TuneSample) -> None:
        """Take the next sample; one of a cycle that was told already is no other."""
        last = self.samples[-1] if self.samples else None
        if last is not None:
            if sample.cycle <= last.cycle:
                return
            self.lost += sample.cycle - last.cycle - 1
        self.samples.append(sample)

    @property
    def begin(self) -> int:
        """The cycle of the first sample."""
        return self.samples[0].cycle if self.samples else 0

    def seconds(self, sample: TuneSample) -> float:
        """Return the time of a sample since the first one."""
        return (sample.cycle - self.begin) * self.period


class TuneMotion:
    """A run of `excitation`, `kind` velocity or torque; the drive stops with `deceleration` in rad/s^2, 0: at once."""

    def __init__(
        self, kind: JogKind, excitation: Excitation, limits: JogLimits, *, now: int, deceleration: float = 0.0
    ) -> None:
        self.kind, self.limits = kind, limits
        self.ended = JogEnd.NONE
        self._excitation, self._begin, self._now = excitation, now, now
        self._deceleration = deceleration
        self._start: float | None = None
        self._way, self._speed = math.nan, 0.0
        self._pushed = 0.0
        self._too_much_since: int | None = None

    @property
    def command(self) -> float:
        """What to send now, in rad/s or per mille; 0 once it has ended."""
        if self.ended is not JogEnd.NONE:
            return 0.0
        value = self._excitation.at((self._now - self._begin) * 1e-9)
        if self.kind is JogKind.TORQUE:
            value += self._pushed * STEERED * self._excitation.peak
        return value

    @property
    def elapsed(self) -> float:
        """How many seconds of it are over."""
        return (self._now - self._begin) * 1e-9

    @property
    def travelled(self) -> float:
        """How far the shaft is from where it began, in rad; nan while nobody knows."""
        return self._way

    def tick(self, now: int) -> None:
        """Let time pass."""
        self._now = now
        if now - self._begin >= self._excitation.seconds * 1e9:
            self.end(JogEnd.OVER)

    def see(self, position: float | None, velocity: float | None, current: float | None, *, enabled: bool) -> None:
        """Take what the drive shows: rad, rad/s, per mille, None where it does not."""
        if not enabled:
            self.end(JogEnd.STATE)
        self._judge_current(current)
        if velocity is not None and math.isfinite(velocity):
            self._speed = velocity
            if abs(velocity) > self.limits.speed:
                self.end(JogEnd.SPEED)
        if position is not None and math.isfinite(position):
            if self._start is None:
                self._start = position
            self._way = position - self._start
            if abs(self._way) + self._stopping() >= self.limits.travel:
                self.end(JogEnd.TRAVEL)
        self._steer()

    def end(self, why: JogEnd) -> None:
        """Command nothing any more; the first reason counts."""
        if self.ended is JogEnd.NONE:
            self.ended = why

    def _judge_current(self, current: float | None) -> None:
        if current is None or abs(current) <= self.limits.current:
            self._too_much_since = None
        elif self._too_much_since is None:
            self._too_much_since = self._now
        elif self._now - self._too_much_since > PEAK_S * 1e9:
            self.end(JogEnd.CURRENT)

    def _stopping(self) -> float:
        """Return the way that a stop takes, in rad, as far as it leads away from the start."""
        if not self._deceleration or self._speed * self._way <= 0.0:
            return 0.0
        return self._speed * self._speed / (2.0 * self._deceleration)

    def _steer(self) -> None:
        """Choose where a torque pushes beside the excitation: both ways in turn, back where half is used up."""
        elapsed = (self._now - self._begin) * 1e-9 / self._excitation.seconds
        self._pushed = -1.0 if 0.25 <= elapsed < 0.75 else 1.0
        way, speed = self._way / self.limits.travel, self._speed / self.limits.speed
        for share in (speed, 0.0 if math.isnan(way) else way):
            if abs(share) > _HALF:
                self._pushed = -math.copysign(1.0, share)
