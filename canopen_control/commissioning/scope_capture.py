"""Capture memory and trigger of a scope, and captures as CSV, PNG and bags.

The memory is sans-IO; times are arguments in seconds of any one clock. A sample has a value for each signal, None while
the value is unknown; a value is valid until the next sample. While the scope waits for a trigger it stores `before`
seconds and at most `MAX` samples, so that it can wait for days. An edge needs known values on both sides of the level;
a level fires as soon as the condition is true, and again only after the condition was false.
"""

from __future__ import annotations

import csv
import io
import math
from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.state import decode_statusword
from canopen_control.errors import ConfigError
from canopen_control.trace.values import is_faulty

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from canopen_control.commissioning.scope_signals import Signal


MAX: Final = 1_000_000  # maximum number of samples in a capture; older samples are dropped

Row = tuple[float, tuple[float | None, ...]]


class Condition(Enum):
    """Kinds of trigger conditions."""

    RISING = "rising"
    FALLING = "falling"
    ABOVE = "above"
    BELOW = "below"
    FAULT = "fault"


@dataclass(frozen=True, slots=True)
class Trigger:
    """Trigger condition on the signals at `places`, or on statuswords (without `level`) for a fault."""

    condition: Condition
    places: tuple[int, ...]
    level: float = 0.0

    def fires(self, before: tuple[float | None, ...] | None, now: tuple[float | None, ...]) -> bool:
        """Whether a new sample fires the trigger; `before` is the previous sample, or None for the first."""
        return any(self._fires(None if before is None else before[place], now[place]) for place in self.places)

    def _fires(self, before: float | None, now: float | None) -> bool:
        if now is None or math.isnan(now):
            return False
        holds = _HOLDS[self.condition]
        if not holds(now, self.level):
            return False
        is_known = before is not None and not math.isnan(before)
        if is_known and before is not None and holds(before, self.level):
            return False
        return is_known or self.condition in _WITHOUT_A_BEFORE


def _has_fault(value: float, _level: float) -> bool:
    return is_faulty(decode_statusword(int(value)))


_HOLDS: Final = {
    Condition.RISING: lambda value, level: value >= level,
    Condition.FALLING: lambda value, level: value <= level,
    Condition.ABOVE: lambda value, level: value > level,
    Condition.BELOW: lambda value, level: value < level,
    Condition.FAULT: _has_fault,
}
_WITHOUT_A_BEFORE: Final = (Condition.ABOVE, Condition.BELOW)


def parse_trigger(text: str, signals: int) -> Trigger:
    """Parse `1:rising:1000` or `fault`; raise ConfigError for other texts or a signal above `signals`."""
    if text == Condition.FAULT.value:
        return Trigger(Condition.FAULT, ())
    place, _, rest = text.partition(":")
    word, _, level = rest.partition(":")
    conditions = {condition.value: condition for condition in Condition if condition is not Condition.FAULT}
    try:
        number, at = int(place), float(level)
    except ValueError:
        number, at = 0, math.nan
    if word not in conditions or not 1 <= number <= signals or not math.isfinite(at):
        raise ConfigError(
            f"--trigger {text}: write SIGNAL:CONDITION:LEVEL, the signals counted from 1 to {signals}, as in "
            f"1:rising:1000; conditions: {', '.join(conditions)}; or `fault`"
        )
    return Trigger(conditions[word], (number - 1,), at)


@dataclass(frozen=True, slots=True)
class Measures:
    """Minimum, maximum, time-weighted mean and root mean square of one signal in a capture."""

    least: float
    most: float
    mean: float
    rms: float


@dataclass(frozen=True, slots=True)
class CursorReading:
    """Values of one signal at two cursors, and the root mean square between them."""

    first: float
    second: float
    rms: float

    @property
    def difference(self) -> float:
        return self.second - self.first


@dataclass(frozen=True, slots=True)
class Shot:
    """Samples of one capture; `triggered` is the time of the trigger, or None."""

    rows: tuple[Row, ...]
    triggered: float | None = None

    @property
    def zero(self) -> float:
        """Time of the trigger, else of the first sample."""
        return self.rows[0][0] if self.triggered is None else self.triggered

    @property
    def time_range(self) -> tuple[float, float]:
        """Times of the first and the last sample, relative to `zero`."""
        return self.rows[0][0] - self.zero, self.rows[-1][0] - self.zero

    def between(self, first: float, second: float) -> Shot:
        """Return the part between two times relative to `zero`, with the values valid at both ends."""
        begin, end = sorted((first + self.zero, second + self.zero))
        row_before = [row for time, row in self.rows if time <= begin][-1:]
        inner = [(time, row) for time, row in self.rows if begin < time <= end]
        rows = [(begin, row) for row in row_before] + inner
        if rows and rows[-1][0] < end:
            rows.append((end, rows[-1][1]))
        return Shot(tuple(rows), self.triggered)

    def cursors(self, place: int, first: float, second: float) -> CursorReading | None:
        """Measure a signal at and between two times relative to `zero`; None if a value is unknown."""
        part = self.between(first, second)
        ends = [part.rows[at][1][place] for at in (0, -1)] if part.rows else [None]
        measured = part.measure(place) if part.rows else None
        low, high = ends[0], ends[-1]
        if low is None or high is None or measured is None or not self.time_range[0] <= min(first, second):
            return None
        return CursorReading(*((low, high) if first <= second else (high, low)), measured.rms)

    def measure(self, place: int) -> Measures | None:
        """Measure a signal, each value weighted with its duration; None if no value is known."""
        points = [(time, value) for time, row in self.rows if (value := row[place]) is not None and value == value]
        if not points:
            return None
        end = self.rows[-1][0]
        spans = [
            after - time for (time, _), after in zip(points, [*(time for time, _ in points[1:]), end], strict=True)
        ]
        weights = spans if sum(spans) > 0 else [1.0] * len(points)
        total, values = sum(weights), [value for _, value in points]
        mean = sum(weight * value for weight, value in zip(weights, values, strict=True)) / total
        square = sum(weight * value * value for weight, value in zip(weights, values, strict=True)) / total
        return Measures(min(values), max(values), mean, math.sqrt(square))


class ScopeState(Enum):
    """States of a scope capture."""

    WAITING = "waiting for the trigger"
    TAKING = "capturing"
    DONE = "done"


class ScopeCapture:
    """Capture memory for `length` s, including `before` s before the trigger.

    Without a trigger, a capture starts with the first sample. The scope is done after `shots` captures, if not None.
    """

    def __init__(self, trigger: Trigger | None, *, length: float, before: float = 0.0, shots: int | None = 1) -> None:
        if not 0.0 <= before < length:
            raise ConfigError(
                f"{before:g} s before the trigger do not fit into {length:g} s; reduce --before, or increase the length"
            )
        self.state = ScopeState.WAITING
        self._trigger, self._length, self._before, self._shots_left = trigger, length, before, shots
        self._rows: deque[Row] = deque(maxlen=MAX)
        self._begin: float | None = None  # time of the trigger, or of the first sample without a trigger
        self._newest = -math.inf
        self._last: tuple[float | None, ...] | None = None
        self._shots: list[Shot] = []

    @property
    def done(self) -> bool:
        """Whether all captures are complete or the scope was stopped."""
        return self.state is ScopeState.DONE

    @property
    def held(self) -> int:
        return len(self._rows)

    def feed(self, time: float, values: tuple[float | None, ...]) -> None:
        """Add a sample; a time before the latest sample is replaced by that sample's time."""
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
        """Advance the time, so that a capture can end without another sample."""
        if self._begin is not None and time >= self._end:
            if self._rows[-1][0] < self._end:
                self._rows.append((self._end, self._rows[-1][1]))
            self._finish()

    def next_deadline(self) -> float | None:
        """Return the time at which the current capture ends, or None without a capture in progress."""
        return None if self._begin is None else self._end

    def stop(self) -> None:
        """Stop the scope and complete the capture in progress; samples before a trigger are dropped."""
        if self._begin is not None:
            self._finish()
        self.state = ScopeState.DONE

    def take(self) -> list[Shot]:
        """Return the captures completed since the previous call."""
        shots, self._shots = self._shots, []
        return shots

    # -- inside

    @property
    def _end(self) -> float:
        assert self._begin is not None
        return self._begin + self._length - (self._before if self._trigger is not None else 0.0)

    def _forget(self, before: float) -> None:
        """Discard the samples before a time, except the last of them, whose values are still valid."""
        rows = self._rows
        while len(rows) > 1 and rows[1][0] <= before:
            rows.popleft()

    def _finish(self) -> None:
        self._shots.append(Shot(tuple(self._rows), self._begin if self._trigger is not None else None))
        self._rows.clear()
        self._begin = None
        if self._shots_left is not None:
            self._shots_left -= 1
        self.state = ScopeState.DONE if self._shots_left == 0 else ScopeState.WAITING


# Captures as files: CSV, which can be read again for an overlay, a picture (PNG) and a bag (MCAP).
#
# Pictures are drawn by matplotlib (extra `plot`), which is imported only when a picture is needed.


_TIME, _FROM_ZERO = "time", "t"
_WIDTH, _ROW, _DPI = 10.0, 1.7, 110  # inches, inches for each signal, pixels an inch
_OVERLAY: Final = "#9aa5b1"
_CURSOR: Final = "#16324f"


@dataclass(frozen=True, slots=True)
class NamedShot:
    """Capture with the names and units of its signals ("" for an unknown unit), and the title `label`."""

    shot: Shot
    names: tuple[str, ...]
    units: tuple[str, ...] = ()
    label: str = ""

    def place(self, name: str) -> int | None:
        """Return the column of the signal with this name, or None."""
        return self.names.index(name) if name in self.names else None


def named_shot(shot: Shot, signals: Sequence[Signal], label: str = "") -> NamedShot:
    """Combine a capture with the names and units of its signals."""
    return NamedShot(shot, tuple(signal.name for signal in signals), tuple(signal.unit for signal in signals), label)


def csv_of(named: NamedShot) -> str:
    """Format a capture as CSV: Unix time, time relative to the trigger or the first sample, and the values."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([_TIME, _FROM_ZERO, *named.names])
    zero = named.shot.zero
    for time, row in named.shot.rows:
        values = ["" if value is None else f"{value:.9g}" for value in row[: len(named.names)]]
        writer.writerow([f"{time:.6f}", f"{time - zero:.6f}", *values])
    return out.getvalue()


def parse_csv(text: str, place: str) -> NamedShot:
    """Parse the text of a file written by `csv_of`; raise ConfigError, naming the file `place`, if it is invalid."""
    lines = list(csv.reader(io.StringIO(text)))
    if len(lines) < 2 or lines[0][:2] != [_TIME, _FROM_ZERO] or len(lines[0]) < 3:
        raise ConfigError(f"{place} is not a capture of a scope, which begins with time,t and the names of signals")
    names = tuple(lines[0][2:])
    try:
        rows = tuple(
            (float(cells[0]), tuple(None if cell == "" else float(cell) for cell in cells[2:])) for cells in lines[1:]
        )
        zero = float(lines[1][0]) - float(lines[1][1])
    except (ValueError, IndexError):
        raise ConfigError(f"{place}: a cell is not a number; give a file written by `scope -o`") from None
    if any(len(row) != len(names) for _, row in rows):
        raise ConfigError(f"{place}: a row has more or fewer cells than the first line")
    first = rows[0][0]
    return NamedShot(Shot(rows, None if zero == first else zero), names, ("",) * len(names), place)


def refuse_without_pictures() -> None:
    """Raise ConfigError if matplotlib is not installed."""
    from importlib.util import find_spec

    if find_spec("matplotlib") is None:
        raise ConfigError("a picture needs matplotlib: pip install canopen-control[plot]; or write NAME.csv")


def picture_of(named: NamedShot, overlay: NamedShot | None = None, cursors: tuple[float, float] | None = None) -> bytes:
    """Draw a capture as PNG, one plot per signal, with an overlay of the same signals and two cursors."""
    figure, axes = _figure(len(named.names))
    for place, axis in enumerate(axes):
        name = named.names[place]
        if overlay is not None and (overlay_place := overlay.place(name)) is not None:
            _line(axis, overlay.shot, overlay_place, color=_OVERLAY, label=overlay.label or "overlay")
        _line(axis, named.shot, place, color=f"C{place}", label=name)
        unit = named.units[place] if place < len(named.units) else ""
        axis.set_ylabel(unit, fontsize=8)
        axis.grid(visible=True, linewidth=0.4)
        if named.shot.triggered is not None:
            axis.axvline(0.0, color=_CURSOR, linewidth=0.8, linestyle=":")
        for at in cursors or ():
            axis.axvline(at, color=_CURSOR, linewidth=0.9)
        axis.legend(loc="upper right", fontsize=8)
    axes[-1].set_xlabel(_time_words(named.shot, cursors), fontsize=8)
    return _png(figure)


def _figure(rows: int) -> tuple[Figure, list[Axes]]:
    refuse_without_pictures()
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, 0.7 + _ROW * rows), dpi=_DPI, layout="constrained")
    axes = list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])
    for axis in axes:
        axis.tick_params(labelsize=8)
    return figure, axes


def _png(figure: Figure) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    out = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(out, format="png")
    return out.getvalue()


def plotted(
    rows: Sequence[tuple[str, Sequence[float], Sequence[float]]],
    unit: str,
    *,
    logarithmic: bool = False,
    mark: float | None = None,
) -> bytes:
    """Draw plots below each other as PNG; a row has a label, x values in `unit`, and y values.

    `mark` is the x value of a vertical line.
    """
    figure, axes = _figure(len(rows))
    for axis, (label, places, values) in zip(axes, rows, strict=True):
        axis.plot(places, values, linewidth=1.1)
        axis.set_ylabel(label, fontsize=8)
        axis.grid(visible=True, which="both", linewidth=0.4)
        if logarithmic:
            axis.set_xscale("log")
        if mark is not None:
            axis.axvline(mark, color=_CURSOR, linewidth=0.8, linestyle=":")
    axes[-1].set_xlabel(unit, fontsize=8)
    return _png(figure)


def _line(axis: Axes, shot: Shot, place: int, *, color: str, label: str) -> None:
    """Draw a signal as steps: each value is valid until the next sample."""
    times = [time - shot.zero for time, _ in shot.rows]
    values = [math.nan if (value := row[place]) is None else value for _, row in shot.rows]
    axis.step(times, values, where="post", color=color, linewidth=1.1, label=label)


def _time_words(shot: Shot, cursors: tuple[float, float] | None) -> str:
    words = "s from the trigger" if shot.triggered is not None else "s"
    if cursors is not None:
        words += f"      cursors at {cursors[0]:g} s and {cursors[1]:g} s, dt {cursors[1] - cursors[0]:g} s"
    return words


def write_bag(folder: Path, shot: Shot, signals: Sequence[Signal]) -> None:
    """Write a bag with a topic per signal, such as /scope/left_drive/o6064_00 or /scope/left_wheel_joint/velocity."""
    from canopen_control.trace.bag import BagWriter

    with BagWriter(folder, "scope") as bag:
        for time, row in shot.rows:
            for signal, value in zip(signals, row, strict=False):
                if value is not None:
                    bag.number(_topic(signal), time, value)


def _topic(signal: Signal) -> str:
    owner = signal.name.partition(":")[0]
    return f"/scope/{f'node_{owner}' if owner.isdecimal() else owner}/{signal.topic}"
