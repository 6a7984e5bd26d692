"""A scope's memory and trigger: samples in, shots out, each with what was before its trigger.

The law of this file: sans-IO, time is an argument in seconds of any one clock. A sample is a value for each signal,
None where none is known yet; between two samples the last one holds. What waits for a trigger keeps `before` seconds
and no more than `MOST` samples, so that it may wait for days. An edge needs two values on either side of its level; a
level fires as soon as it is true, and anew only after it was not.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Final

from canopen_control.cia402.state import State, decode_statusword
from canopen_control.errors import ConfigError

__all__ = [
    "MOST",
    "Condition",
    "CursorReading",
    "Measures",
    "ScopeCapture",
    "ScopeState",
    "Shot",
    "Trigger",
    "parse_trigger",
]

MOST: Final = 1_000_000  # samples of one shot; older ones are dropped
_FAULTS: Final = (State.FAULT, State.FAULT_REACTION_ACTIVE)

Row = tuple[float, tuple[float | None, ...]]


class Condition(Enum):
    """What a trigger waits for."""

    RISING = "rising"
    FALLING = "falling"
    ABOVE = "above"
    BELOW = "below"
    FAULT = "fault"


@dataclass(frozen=True, slots=True)
class Trigger:
    """A condition on the signals at `places` (any of them), at a `level`; of a fault they are statuswords."""

    condition: Condition
    places: tuple[int, ...]
    level: float = 0.0

    def fires(self, before: tuple[float | None, ...] | None, now: tuple[float | None, ...]) -> bool:
        """Whether the step from one sample to the next is what is waited for; `before` None for the first."""
        return any(self._fires(None if before is None else before[place], now[place]) for place in self.places)

    def _fires(self, before: float | None, now: float | None) -> bool:
        if now is None or math.isnan(now):
            return False
        holds = _HOLDS[self.condition]
        if not holds(now, self.level):
            return False
        known = before is not None and not math.isnan(before)
        if known and before is not None and holds(before, self.level):
            return False
        return known or self.condition in _WITHOUT_A_BEFORE


def _has_fault(value: float, _level: float) -> bool:
    return decode_statusword(int(value)) in _FAULTS


_HOLDS: Final = {
    Condition.RISING: lambda value, level: value >= level,
    Condition.FALLING: lambda value, level: value <= level,
    Condition.ABOVE: lambda value, level: value > level,
    Condition.BELOW: lambda value, level: value < level,
    Condition.FAULT: _has_fault,
}
_WITHOUT_A_BEFORE: Final = (Condition.ABOVE, Condition.BELOW)


def parse_trigger(text: str, signals: int) -> Trigger:
    """Read `1:rising:1000` or `fault`; ConfigError. The places of a fault are those that follow the signals."""
    if text == Condition.FAULT.value:
        return Trigger(Condition.FAULT, ())
    place, _, rest = text.partition(":")
    word, _, level = rest.partition(":")
    known = {each.value: each for each in Condition if each is not Condition.FAULT}
    try:
        number, at = int(place), float(level)
    except ValueError:
        number, at = 0, math.nan
    if word not in known or not 1 <= number <= signals or not math.isfinite(at):
        raise ConfigError(
            f"--trigger {text}: write SIGNAL:CONDITION:LEVEL, the signals counted from 1 to {signals}, as in "
            f"1:rising:1000; conditions: {', '.join(known)}; or `fault`"
        )
    return Trigger(known[word], (number - 1,), at)


@dataclass(frozen=True, slots=True)
class Measures:
    """Of one signal in one shot: smallest, greatest, mean and root mean square over time."""

    least: float
    most: float
    mean: float
    rms: float


@dataclass(frozen=True, slots=True)
class CursorReading:
    """Of one signal at two cursors: its values there, what lies between them, and the RMS from one to the other."""

    first: float
    second: float
    rms: float

    @property
    def difference(self) -> float:
        """The second value less the first, dv."""
        return self.second - self.first


@dataclass(frozen=True, slots=True)
class Shot:
    """The samples of a shot; `triggered` is the time of its trigger, None without one."""

    rows: tuple[Row, ...]
    triggered: float | None = None

    @property
    def zero(self) -> float:
        """The time that its own times are counted from: that of its trigger, else of its first sample."""
        return self.rows[0][0] if self.triggered is None else self.triggered

    @property
    def span(self) -> tuple[float, float]:
        """From when to when it goes, counted from `zero`."""
        return self.rows[0][0] - self.zero, self.rows[-1][0] - self.zero

    def between(self, first: float, second: float) -> Shot:
        """Return the part between two times, counted from `zero`; the value that holds at each end stands there."""
        begin, end = sorted((first + self.zero, second + self.zero))
        held = [row for time, row in self.rows if time <= begin][-1:]
        inner = [(time, row) for time, row in self.rows if begin < time <= end]
        rows = [(begin, row) for row in held] + inner
        if rows and rows[-1][0] < end:
            rows.append((end, rows[-1][1]))
        return Shot(tuple(rows), self.triggered)

    def cursors(self, place: int, first: float, second: float) -> CursorReading | None:
        """Read a signal at two times, counted from `zero`; None where it is not known at both of them."""
        part = self.between(first, second)
        ends = [part.rows[at][1][place] for at in (0, -1)] if part.rows else [None]
        measured = part.measure(place) if part.rows else None
        low, high = ends[0], ends[-1]
        if low is None or high is None or measured is None or not self.span[0] <= min(first, second):
            return None
        return CursorReading(*((low, high) if first <= second else (high, low)), measured.rms)

    def measure(self, place: int) -> Measures | None:
        """Measure a signal, each value for as long as it held; None where it had none."""
        known = [(time, value) for time, row in self.rows if (value := row[place]) is not None and value == value]
        if not known:
            return None
        end = self.rows[-1][0]
        spans = [after - time for (time, _), after in zip(known, [*(time for time, _ in known[1:]), end], strict=True)]
        weights = spans if sum(spans) > 0 else [1.0] * len(known)
        total, values = sum(weights), [value for _, value in known]
        mean = sum(weight * value for weight, value in zip(weights, values, strict=True)) / total
        square = sum(weight * value * value for weight, value in zip(weights, values, strict=True)) / total
        return Measures(min(values), max(values), mean, math.sqrt(square))


class ScopeState(Enum):
    """Where a scope is."""

    WAITING = "waiting for its trigger"
    TAKING = "taking"
    DONE = "done"


class ScopeCapture:
    """Takes shots of `length` seconds, `before` of them before the trigger; without a trigger from the first sample on.

    After `shots` of them it is done; None goes on for ever.
    """

    def __init__(self, trigger: Trigger | None, *, length: float, before: float = 0.0, shots: int | None = 1) -> None:
        if not 0.0 <= before < length:
            raise ConfigError(
                f"{before:g} s before the trigger do not fit into {length:g} s; take less before, or more"
            )
        self.state = ScopeState.WAITING
        self._trigger, self._length, self._before, self._left = trigger, length, before, shots
        self._rows: deque[Row] = deque(maxlen=MOST)
        self._begin: float | None = None  # of the part behind the trigger
        self._newest = -math.inf
        self._last: tuple[float | None, ...] | None = None
        self._shots: list[Shot] = []

    @property
    def done(self) -> bool:
        """Whether all shots are taken."""
        return self.state is ScopeState.DONE

    @property
    def held(self) -> int:
        """How many samples it remembers now."""
        return len(self._rows)

    def feed(self, time: float, values: tuple[float | None, ...]) -> None:
        """Take a sample; one that comes with an older time is of the present."""
        time = self._newest = max(time, self._newest)
        if self._begin is not None and time >= self._end:
            self._finish()
        if self.state is ScopeState.DONE:
            return
        self._rows.append((time, values))
        if self.state is ScopeState.WAITING:
            self._forget(time - self._before)
            if self._trigger is None or self._trigger.fires(self._last, values):
                self.state, self._begin = ScopeState.TAKING, time
        self._last = values

    def tick(self, time: float) -> None:
        """Let time pass: a shot may be over without another sample; what came last has held until its end then."""
        if self._begin is not None and time >= self._end:
            if self._rows[-1][0] < self._end:
                self._rows.append((self._end, self._rows[-1][1]))
            self._finish()

    def next_deadline(self) -> float | None:
        """Return when the shot under way is over."""
        return None if self._begin is None else self._end

    def stop(self) -> None:
        """End it now: what was being taken is a shot, what waited is none."""
        if self._begin is not None:
            self._finish()
        self.state = ScopeState.DONE

    def take(self) -> list[Shot]:
        """Return the shots that were finished since the last call."""
        found, self._shots = self._shots, []
        return found

    # -- inside

    @property
    def _end(self) -> float:
        assert self._begin is not None
        return self._begin + self._length - (self._before if self._trigger is not None else 0.0)

    def _forget(self, before: float) -> None:
        """Drop what is too old; the last sample before `before` stays, since it holds until then."""
        rows = self._rows
        while len(rows) > 1 and rows[1][0] <= before:
            rows.popleft()

    def _finish(self) -> None:
        self._shots.append(Shot(tuple(self._rows), self._begin if self._trigger is not None else None))
        self._rows.clear()
        self._begin = None
        if self._left is not None:
            self._left -= 1
        self.state = ScopeState.DONE if self._left == 0 else ScopeState.WAITING
