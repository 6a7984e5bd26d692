"""A scope's shot as a file: CSV, which is read back too, to lay one shot over another, a picture (PNG), a bag (MCAP).

The picture is drawn by matplotlib (the extra `plot`), which nothing else needs and which is loaded when a picture is
asked for: axes with sensible ticks, legends and fonts for any name are work that nobody should do twice.
"""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError
from canopen_control.service.scope_capture import Shot

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes

    from canopen_control.service.scope_signals import Signal

__all__ = ["NamedShot", "csv_of", "named_shot", "parse_csv", "picture_of", "refuse_without_pictures", "write_bag"]

_TIME, _FROM_ZERO = "time", "t"
_WIDTH, _ROW, _DPI = 10.0, 1.7, 110  # inches, inches for each signal, pixels an inch
_OVERLAY: Final = "#9aa5b1"
_CURSOR: Final = "#16324f"


@dataclass(frozen=True, slots=True)
class NamedShot:
    """A shot with the names of its signals and their units, "" where nobody knows; `label` is what it is called."""

    shot: Shot
    names: tuple[str, ...]
    units: tuple[str, ...] = ()
    label: str = ""

    def place(self, name: str) -> int | None:
        """Return where a signal is; None where it is not one of these."""
        return self.names.index(name) if name in self.names else None


def named_shot(shot: Shot, signals: Sequence[Signal], label: str = "") -> NamedShot:
    """Return a shot with the names of its signals."""
    return NamedShot(shot, tuple(each.name for each in signals), tuple(each.unit for each in signals), label)


def csv_of(named: NamedShot) -> str:
    """Return a row for each sample: Unix time, time from the trigger or the first sample, the values."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([_TIME, _FROM_ZERO, *named.names])
    zero = named.shot.zero
    for time, row in named.shot.rows:
        values = ["" if value is None else f"{value:.9g}" for value in row[: len(named.names)]]
        writer.writerow([f"{time:.6f}", f"{time - zero:.6f}", *values])
    return out.getvalue()


def parse_csv(text: str, where: str) -> NamedShot:
    """Read what `csv_of` has written; ConfigError for what is none."""
    lines = list(csv.reader(io.StringIO(text)))
    if len(lines) < 2 or lines[0][:2] != [_TIME, _FROM_ZERO] or len(lines[0]) < 3:
        raise ConfigError(f"{where} is no shot of a scope: it begins with time,t and the names of signals")
    names = tuple(lines[0][2:])
    try:
        rows = tuple(
            (float(cells[0]), tuple(None if cell == "" else float(cell) for cell in cells[2:])) for cells in lines[1:]
        )
        zero = float(lines[1][0]) - float(lines[1][1])
    except (ValueError, IndexError):
        raise ConfigError(f"{where}: a cell is no number; give a file that `scope -o` has written") from None
    if any(len(row) != len(names) for _, row in rows):
        raise ConfigError(f"{where}: a row has more or fewer cells than the first line")
    first = rows[0][0]
    return NamedShot(Shot(rows, None if zero == first else zero), names, ("",) * len(names), where)


def refuse_without_pictures() -> None:
    """Raise ConfigError where the extra is not installed, before anything is looked at."""
    from importlib.util import find_spec

    if find_spec("matplotlib") is None:
        raise ConfigError("a picture needs matplotlib: pip install canopen-control[plot]; or write NAME.csv")


def picture_of(named: NamedShot, overlay: NamedShot | None = None, cursors: tuple[float, float] | None = None) -> bytes:
    """Draw each signal over the time from the trigger, an overlay of the same signals below it, and two cursors."""
    refuse_without_pictures()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    count = len(named.names)
    figure = Figure(figsize=(_WIDTH, 0.7 + _ROW * count), dpi=_DPI, layout="constrained")
    axes = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    for place, axis in enumerate(axes):
        name = named.names[place]
        if overlay is not None and (other := overlay.place(name)) is not None:
            _line(axis, overlay.shot, other, color=_OVERLAY, label=overlay.label or "overlay")
        _line(axis, named.shot, place, color=f"C{place}", label=name)
        unit = named.units[place] if place < len(named.units) else ""
        axis.set_ylabel(unit, fontsize=8)
        axis.tick_params(labelsize=8)
        axis.grid(visible=True, linewidth=0.4)
        if named.shot.triggered is not None:
            axis.axvline(0.0, color=_CURSOR, linewidth=0.8, linestyle=":")
        for at in cursors or ():
            axis.axvline(at, color=_CURSOR, linewidth=0.9)
        axis.legend(loc="upper right", fontsize=8)
    axes[-1].set_xlabel(_time_words(named.shot, cursors), fontsize=8)
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
    """Draw rows of a label, places (in `unit`) and values, one below the other, as PNG; `mark` is one of the places."""
    refuse_without_pictures()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, 0.7 + _ROW * len(rows)), dpi=_DPI, layout="constrained")
    axes = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for axis, (label, places, values) in zip(axes, rows, strict=True):
        axis.plot(places, values, linewidth=1.1)
        axis.set_ylabel(label, fontsize=8)
        axis.tick_params(labelsize=8)
        axis.grid(visible=True, which="both", linewidth=0.4)
        if logarithmic:
            axis.set_xscale("log")
        if mark is not None:
            axis.axvline(mark, color=_CURSOR, linewidth=0.8, linestyle=":")
    axes[-1].set_xlabel(unit, fontsize=8)
    out = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(out, format="png")
    return out.getvalue()


def _line(axis: Axes, shot: Shot, place: int, *, color: str, label: str) -> None:
    """Draw a signal as it was known: a value holds until the next one."""
    times = [time - shot.zero for time, _ in shot.rows]
    values = [math.nan if (value := row[place]) is None else value for _, row in shot.rows]
    axis.step(times, values, where="post", color=color, linewidth=1.1, label=label)


def _time_words(shot: Shot, cursors: tuple[float, float] | None) -> str:
    words = "s from the trigger" if shot.triggered is not None else "s"
    if cursors is not None:
        words += f"      cursors at {cursors[0]:g} s and {cursors[1]:g} s, dt {cursors[1] - cursors[0]:g} s"
    return words


def write_bag(folder: Path, shot: Shot, signals: Sequence[Signal]) -> None:
    """Write a bag with a topic for each signal: /scope/left_drive/o6064_00, /scope/left_wheel_joint/velocity."""
    from canopen_control.trace.bag import BagWriter

    with BagWriter(folder, "scope") as bag:
        for time, row in shot.rows:
            for signal, value in zip(signals, row, strict=False):
                if value is not None:
                    bag.number(_topic(signal), time, value)


def _topic(signal: Signal) -> str:
    owner = signal.name.partition(":")[0]
    return f"/scope/{f'node_{owner}' if owner.isdecimal() else owner}/{signal.topic}"
