"""What becomes of a scope's shots: measures and a curve of characters for people, and files (CSV, PNG, MCAP)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.output import Table
from canopen_control.errors import ConfigError
from canopen_control.host.files import write_whole
from canopen_control.service.scope_files import (
    csv_of,
    named_shot,
    parse_csv,
    picture_of,
    refuse_without_pictures,
    write_bag,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.service.scope_capture import Shot
    from canopen_control.service.scope_files import NamedShot
    from canopen_control.service.scope_signals import Signal

__all__ = ["check_output", "cursor_lines", "curve", "numbered", "read_overlay", "shot_lines", "write_shot"]

CSV, BAG, PICTURE = ".csv", ".mcap", ".png"
_BLOCKS: Final = " ▁▂▃▄▅▆▇█"
_WIDTH: Final = 60


def check_output(text: str) -> Path:
    """Return the file or the folder of a bag; ConfigError for another ending or a place that is not there."""
    path = Path(text).expanduser()
    if path.suffix not in (CSV, BAG, PICTURE):
        raise ConfigError(
            f"-o {text}: write NAME{CSV} for a table, NAME{PICTURE} for a picture, or NAME{BAG} for the folder of a bag"
        )
    if not path.parent.is_dir():
        raise ConfigError(f"-o {text}: no folder {path.parent}")
    if path.suffix == PICTURE:
        refuse_without_pictures()
    return path


def read_overlay(text: str) -> NamedShot:
    """Read a shot that was written as CSV; ConfigError for what is none."""
    path = Path(text).expanduser()
    try:
        content = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"--overlay {text} cannot be read: {getattr(error, 'strerror', None) or 'no text'}") from None
    return parse_csv(content, path.name)


def numbered(path: Path, number: int, *, several: bool) -> Path:
    """Return the place of the shot `number`, from 1: scope.csv, or of several scope_1.csv."""
    return path.with_name(f"{path.stem}_{number}{path.suffix}") if several else path


def write_shot(
    path: Path,
    shot: Shot,
    signals: Sequence[Signal],
    overlay: NamedShot | None = None,
    cursors: tuple[float, float] | None = None,
) -> Path:
    """Write a shot, and return the file or the folder of the bag; ConfigError and DiskFull."""
    if path.suffix == CSV:
        write_whole(path, csv_of(named_shot(shot, signals)).encode())
        return path
    if path.suffix == PICTURE:
        write_whole(path, picture_of(named_shot(shot, signals), overlay, cursors))
        return path
    folder = path.with_suffix("")
    write_bag(folder, shot, signals)
    return folder


def shot_lines(shot: Shot, signals: Sequence[Signal], overlay: NamedShot | None = None) -> Iterator[str]:
    """Yield measures and a curve for each signal, and below it those of the same signal of an overlay."""
    begin, end = shot.span
    yield f"{len(shot.rows)} samples from {begin:.3f} s to {end:.3f} s" + (
        "" if shot.triggered is None else " of the trigger"
    )
    table = Table(("signal", "name", "unit", "min", "max", "mean", "RMS", "curve"))
    for place, signal in enumerate(signals):
        table.add([signal.name, signal.label, signal.unit, *_measured(shot, place)])
        other = None if overlay is None else overlay.place(signal.name)
        if overlay is not None and other is not None:
            table.add(["", overlay.label, "", *_measured(overlay.shot, other)])
    yield from table.lines()


def _measured(shot: Shot, place: int) -> list[str]:
    measured, numbers = shot.measure(place), ["-"] * 4
    if measured is not None:
        numbers = [f"{each:.6g}" for each in (measured.least, measured.most, measured.mean, measured.rms)]
    return [*numbers, f"|{curve(shot, place)}|"]


def cursor_lines(shot: Shot, signals: Sequence[Signal], cursors: tuple[float, float]) -> Iterator[str]:
    """Yield what the signals are at two times, the differences, and the RMS between them."""
    first, second = cursors
    apart = second - first
    often = f" ({1 / abs(apart):.4g} Hz)" if apart else ""
    yield f"cursors at {first:g} s and {second:g} s: dt {apart:.6g} s{often}"
    table = Table(("signal", "unit", f"at {first:g} s", f"at {second:g} s", "dv", "RMS between"))
    for place, signal in enumerate(signals):
        read = shot.cursors(place, first, second)
        values = [] if read is None else [read.first, read.second, read.difference, read.rms]
        table.add([signal.name, signal.unit, *([f"{each:.9g}" for each in values] or ["-"] * 4)])
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
