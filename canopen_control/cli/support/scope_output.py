"""What becomes of a scope's shots: measures and a curve of characters for people, CSV, and a bag (MCAP)."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.output import Table
from canopen_control.errors import ConfigError
from canopen_control.host.files import write_whole

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.service.scope_capture import Shot
    from canopen_control.service.scope_signals import ScopeSignal

__all__ = ["check_output", "csv_of", "curve", "numbered", "shot_lines", "write_shot"]

CSV, BAG = ".csv", ".mcap"
_BLOCKS: Final = " ▁▂▃▄▅▆▇█"
_WIDTH: Final = 60


def check_output(text: str) -> Path:
    """Return the file or the folder of a bag; ConfigError for another ending or a place that is not there."""
    path = Path(text).expanduser()
    if path.suffix not in (CSV, BAG):
        raise ConfigError(f"-o {text}: write NAME{CSV} for a table, or NAME{BAG} for the folder of a bag")
    if not path.parent.is_dir():
        raise ConfigError(f"-o {text}: no folder {path.parent}")
    return path


def numbered(path: Path, number: int, *, several: bool) -> Path:
    """Return the place of the shot `number`, from 1: scope.csv, or of several scope_1.csv."""
    return path.with_name(f"{path.stem}_{number}{path.suffix}") if several else path


def write_shot(path: Path, shot: Shot, signals: Sequence[ScopeSignal]) -> Path:
    """Write a shot, and return the file or the folder of the bag; ConfigError and DiskFull."""
    if path.suffix == CSV:
        write_whole(path, csv_of(shot, signals).encode())
        return path
    from canopen_control.trace.bag import BagWriter

    folder = path.with_suffix("")
    with BagWriter(folder, "scope") as bag:
        for time, row in shot.rows:
            for signal, value in zip(signals, row, strict=False):
                if value is not None:
                    bag.number(_topic(signal), time, value)
    return folder


def _topic(signal: ScopeSignal) -> str:
    """Return the ROS name of a signal: /scope/left_drive/o6064_00."""
    node = signal.name.partition(":")[0]
    return f"/scope/{f'node_{node}' if node.isdecimal() else node}/o{signal.index:04X}_{signal.subindex:02X}"


def csv_of(shot: Shot, signals: Sequence[ScopeSignal]) -> str:
    """Return a row for each sample: Unix time, time from the trigger or the first sample, the values."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["time", "t", *(signal.name for signal in signals)])
    zero = _zero(shot)
    for time, row in shot.rows:
        values = ["" if value is None else f"{value:.9g}" for value in row[: len(signals)]]
        writer.writerow([f"{time:.6f}", f"{time - zero:.6f}", *values])
    return out.getvalue()


def _zero(shot: Shot) -> float:
    return shot.rows[0][0] if shot.triggered is None else shot.triggered


def shot_lines(shot: Shot, signals: Sequence[ScopeSignal]) -> Iterator[str]:
    """Yield measures and a curve for each signal."""
    begin, end = shot.rows[0][0] - _zero(shot), shot.rows[-1][0] - _zero(shot)
    yield f"{len(shot.rows)} samples from {begin:.3f} s to {end:.3f} s" + (
        "" if shot.triggered is None else " of the trigger"
    )
    table = Table(("signal", "name", "unit", "min", "max", "mean", "RMS", "curve"))
    for place, signal in enumerate(signals):
        measured = shot.measure(place)
        numbers = ["-"] * 4
        if measured is not None:
            numbers = [f"{each:.6g}" for each in (measured.least, measured.most, measured.mean, measured.rms)]
        table.add([signal.name, signal.label, signal.unit, *numbers, f"|{curve(shot, place)}|"])
    yield from table.lines()


def curve(shot: Shot, place: int, width: int = _WIDTH) -> str:
    """Return a signal as a line of blocks, its greatest value the highest, the mean of each stretch of time."""
    measured = shot.measure(place)
    if measured is None:
        return " " * width
    begin, span = shot.rows[0][0], (shot.rows[-1][0] - shot.rows[0][0]) or 1.0
    sums, counts = [0.0] * width, [0] * width
    for time, row in shot.rows:
        if (value := row[place]) is not None:
            at = min(int((time - begin) / span * width), width - 1)
            sums[at], counts[at] = sums[at] + value, counts[at] + 1
    height, shown, text = (measured.most - measured.least) or 1.0, _BLOCKS[0], ""
    for total, count in zip(sums, counts, strict=True):
        if count:  # else the last value holds
            level = (total / count - measured.least) / height
            shown = _BLOCKS[1 + min(int(level * 7.999), 7)]
        text += shown
    return text
