"""Plot up to eight objects over time, with triggers: in the terminal, as CSV, picture (PNG) or bag (MCAP).

NODE:OBJECT is an object by address or by its name in the EDS; JOINT:position (velocity, effort, command) is the state
of a joint of a running robot. In a running robot objects in TPDOs are sampled with every cycle, other objects are
polled by SDO, one at a time and slowly. On a bare bus (--can, --eds) all objects are polled. A capture begins at once,
or with --trigger: SIGNAL:rising:LEVEL, falling, above, below, with the signals counted from 1; or fault, which watches
the statusword of all nodes. It can wait for a trigger for days. --overlay draws an earlier capture (CSV) underneath the
new one; --cursors prints dt, dv and RMS between two times. Nothing is written to a node.

Exit codes: 0 success; 1 nothing was captured, or the node is gone; 2 wrong usage, no such object.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.arguments import seconds
from canopen_control.cli.support.job_verb import add_job_options, job_options
from canopen_control.cli.support.open_session import add_session_arguments, open_sessions
from canopen_control.cli.support.output import Table, json_text
from canopen_control.commissioning.jobs import SCOPE
from canopen_control.commissioning.scope_capture import (
    ScopeState,
    csv_of,
    named_shot,
    parse_csv,
    picture_of,
    refuse_without_pictures,
    write_bag,
)
from canopen_control.commissioning.scope_run import Scope, capture_of
from canopen_control.commissioning.scope_signals import joint_signal_of, node_of
from canopen_control.data_files import read_utf8
from canopen_control.errors import ConfigError
from canopen_control.host.files import write_whole
from canopen_control.host.signals import ENDING, on_signals

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence

    from canopen_control.commissioning.jobs import ScopeOptions
    from canopen_control.commissioning.scope_capture import CursorReading, Measures, NamedShot, Shot
    from canopen_control.commissioning.scope_signals import Signal


# Output of captures: measurements and curves of block characters as text, and files (CSV, PNG, MCAP).


CSV, BAG, PICTURE = ".csv", ".mcap", ".png"
_BLOCKS: Final = " ▁▂▃▄▅▆▇█"
_WIDTH: Final = 60


def check_output(text: str) -> Path:
    """Return the path of --output; raise ConfigError for an unknown suffix or a missing folder."""
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
    """Read an earlier capture from a CSV file; raise ConfigError if the file is invalid."""
    path = Path(text).expanduser()
    try:
        content = read_utf8(path)
    except (OSError, ValueError) as error:
        raise ConfigError(f"--overlay {text} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    return parse_csv(content, path.name)


def numbered(path: Path, number: int, *, several: bool) -> Path:
    """Return the path for a capture; if there are several, `number` (from 1) is appended to the name."""
    return path.with_name(f"{path.stem}_{number}{path.suffix}") if several else path


def write_shot(
    path: Path,
    shot: Shot,
    signals: Sequence[Signal],
    overlay: NamedShot | None = None,
    cursors: tuple[float, float] | None = None,
) -> Path:
    """Write a capture as CSV, PNG or bag; return the file, or the folder of the bag."""
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
    """Yield a table of all signals with measurements and curves, including the signals of an overlay."""
    begin, end = shot.time_range
    yield f"{len(shot.rows)} samples from {begin:.3f} s to {end:.3f} s" + (
        "" if shot.triggered is None else " of the trigger"
    )
    table = Table(("signal", "name", "unit", "min", "max", "mean", "RMS", "curve"))
    for place, shown in enumerate(signals):
        table.add([shown.name, shown.label, shown.unit, *_measured(shot, place)])
        overlay_place = None if overlay is None else overlay.place(shown.name)
        if overlay is not None and overlay_place is not None:
            table.add(["", overlay.label, "", *_measured(overlay.shot, overlay_place)])
    yield from table.lines()


@dataclass(frozen=True, slots=True)
class SignalReport:
    """Signal of a capture in `scope --json`."""

    name: str
    label: str
    unit: str
    measured: Measures | None
    cursors: CursorReading | None


@dataclass(frozen=True, slots=True)
class ShotReport:
    """Capture in `scope --json`; a sample is the time in s from the trigger or the start, and the signal values."""

    triggered: float | None
    signals: list[SignalReport]
    samples: list[list[float | None]]
    file: str | None


def _shot_report(
    shot: Shot, signals: Sequence[Signal], cursors: tuple[float, float] | None, written: Path | None
) -> ShotReport:
    rows = [
        SignalReport(
            other.name,
            other.label,
            other.unit,
            shot.measure(place),
            None if cursors is None else shot.cursors(place, *cursors),
        )
        for place, other in enumerate(signals)
    ]
    samples: list[list[float | None]] = [[time - shot.zero, *row[: len(signals)]] for time, row in shot.rows]
    return ShotReport(shot.triggered, rows, samples, None if written is None else str(written))


def _measured(shot: Shot, place: int) -> list[str]:
    measured, numbers = shot.measure(place), ["-"] * 4
    if measured is not None:
        numbers = [f"{value:.6g}" for value in (measured.least, measured.most, measured.mean, measured.rms)]
    return [*numbers, f"|{curve(shot, place)}|"]


def cursor_lines(shot: Shot, signals: Sequence[Signal], cursors: tuple[float, float]) -> Iterator[str]:
    """Yield a table of the signals at two times in s, their differences, and the RMS in between."""
    first, second = cursors
    interval = second - first
    frequency = f" ({1 / abs(interval):.4g} Hz)" if interval else ""
    yield f"cursors at {first:g} s and {second:g} s: dt {interval:.6g} s{frequency}"
    table = Table(("signal", "unit", f"at {first:g} s", f"at {second:g} s", "dv", "RMS between"))
    for place, other in enumerate(signals):
        reading = shot.cursors(place, first, second)
        values = [] if reading is None else [reading.first, reading.second, reading.difference, reading.rms]
        table.add([other.name, other.unit, *([f"{value:.9g}" for value in values] or ["-"] * 4)])
    yield from table.lines()


def curve(shot: Shot, place: int, width: int = _WIDTH) -> str:
    """Draw a signal with `width` block characters, scaled from its minimum to its maximum."""
    measured = shot.measure(place)
    if measured is None:
        return " " * width
    begin, span = shot.rows[0][0], (shot.rows[-1][0] - shot.rows[0][0]) or 1.0
    sums, counts = [0.0] * width, [0] * width
    for at_s, row in shot.rows:
        if (value := row[place]) is not None:
            at = min(int((at_s - begin) / span * width), width - 1)
            sums[at], counts[at] = sums[at] + value, counts[at] + 1
    height, shown, text = (measured.most - measured.least) or 1.0, _BLOCKS[0], ""
    for total, count in zip(sums, counts, strict=True):
        if count:  # otherwise the last level is repeated
            level = (total / count - measured.least) / height
            shown = _BLOCKS[1 + min(int(level * 7.999), 7)]
        text += shown
    return text


EXAMPLE = """canopen-control scope left_drive:0x6064 left_drive:0x606C --for 2
         canopen-control scope 5:0x606C --can can0 --eds my_drive.eds --rate 50 -o step.csv
         canopen-control scope 3:0x6064 3:0x606C --trigger 2:rising:100 --before 0.5 --for 3
         canopen-control scope left_wheel_joint:command left_wheel_joint:velocity --for 2 -o step.png
         canopen-control scope 3:0x606C --trigger 1:rising:100 --overlay step.csv --cursors 0,0.25 -o both.png
         canopen-control scope 3:0x6041 3:0x606C --trigger fault --before 2 --for 4"""

_LINE_S: Final = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "signals",
        nargs="+",
        metavar="NODE:OBJECT",
        help="signals such as 3:0x6064, left_drive:0x606C, left_joint:velocity",
    )
    add_session_arguments(parser, node=False)
    add_job_options(parser, SCOPE)
    parser.add_argument("--wait", type=seconds, metavar="S", help="wait S seconds for a trigger, then give up")
    parser.add_argument("--cursors", metavar="T1,T2", help="two times of a capture in s, from its trigger or its start")
    parser.add_argument("--overlay", metavar="FILE.csv", help="an earlier capture, drawn underneath the new one")
    parser.add_argument(
        "--json", action="store_true", help="print each capture as a line of JSON: measures, cursors, samples"
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        help="file to write: NAME.csv, NAME.png, or NAME.mcap for a bag in the folder NAME",
    )


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    options: ScopeOptions = job_options(args, SCOPE)
    capture_of(options, len(args.signals))  # wrong options are refused before anything is opened
    output = _Output(
        None if args.output is None else check_output(args.output),
        overlay=None if args.overlay is None else read_overlay(args.overlay),
        cursors=None if args.cursors is None else _cursors(args.cursors),
    )
    nodes = [node_of(text) for text in args.signals if joint_signal_of(text) is None]
    with open_sessions(args, nodes) as (sessions, client):
        scope = Scope(args.signals, sessions, client, options)
        return _ScopeLoop(scope, output, args, several=options.rolling or options.shots > 1).run()


def _cursors(text: str) -> tuple[float, float]:
    """Return the two times in s of a text such as `0.1,0.25`; raise ConfigError for another form."""
    try:
        first, second = map(float, text.split(","))
    except ValueError:
        first = second = math.nan
    if not (math.isfinite(first) and math.isfinite(second)):
        raise ConfigError(f"--cursors {text}: write two times in s, as in 0.1,0.25 or -0.1,0.25")
    return first, second


@dataclass(frozen=True, slots=True)
class _Output:
    """Output options of captures; `path` is the output file, `cursors` are two times in s."""

    path: Path | None
    overlay: NamedShot | None = None
    cursors: tuple[float, float] | None = None


class _ScopeLoop:
    """Main loop of a scope; it outputs captures until all are complete, the wait is over or the user ends it."""

    def __init__(self, scope: Scope, output: _Output, args: argparse.Namespace, *, several: bool) -> None:
        self._scope, self._signals, self._output = scope, scope.signals, output
        self._wait, self._as_json, self._several = args.wait, args.json, several
        self._ended = False
        self._captures = 0
        self._shown = 0.0

    def run(self) -> int:
        """Run the loop to its end; return 0, or 1 without a capture."""
        begin, capture = time.monotonic(), self._scope.capture
        with on_signals(ENDING, self._end):
            for shots in self._scope.captures(lambda: self._ended):
                self._report(shots)
                self._show(self._scope.values.row)
                waits = capture.state is ScopeState.WAITING and self._wait is not None
                if waits and time.monotonic() - begin > (self._wait or 0.0):
                    self._ended = True
        self._erase_line()
        if words := self._scope.cycle_words():
            print(words, file=sys.stderr if self._as_json else sys.stdout)
        if not self._captures:
            print("canopen-control: no capture, as the trigger condition was not met", file=sys.stderr)
        return 0 if self._captures else 1

    def _end(self) -> None:
        self._ended = True

    def _report(self, shots: Sequence[Shot]) -> None:
        for shot in shots:
            self._captures += 1
            self._erase_line()
            output, written = self._output, None
            if output.path is not None:
                path = numbered(output.path, self._captures, several=self._several)
                written = write_shot(path, shot, self._signals, output.overlay, output.cursors)
            if self._as_json:
                print(json_text(_shot_report(shot, self._signals, output.cursors, written), indent=None), flush=True)
                continue
            print("\n".join(shot_lines(shot, self._signals, output.overlay)), flush=True)
            if output.cursors is not None:
                print("\n".join(cursor_lines(shot, self._signals, output.cursors)), flush=True)
            if written is not None:
                print(f"written: {written}", flush=True)

    def _show(self, row: Sequence[float | None]) -> None:
        now = time.monotonic()
        if not sys.stderr.isatty() or now - self._shown < _LINE_S:
            return
        self._shown = now
        pairs = zip(self._signals, row, strict=False)
        values = ", ".join(f"{chosen.name} {'-' if value is None else f'{value:g}'}" for chosen, value in pairs)
        print(f"\r{self._scope.capture.state.value}: {values}\x1b[K", end="", file=sys.stderr, flush=True)

    def _erase_line(self) -> None:
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
