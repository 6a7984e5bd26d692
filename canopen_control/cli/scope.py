"""Plot up to eight objects over time, with triggers: on the terminal, as CSV, as a picture (PNG), as a bag (MCAP).

NODE:OBJECT is an object by address or by its name in the EDS; JOINT:position (velocity, effort, command) is the state
of a joint of a running robot. In a running robot objects in TPDOs are sampled with every cycle, other objects are
polled by SDO, one at a time and slowly. On a bare bus (--can, --eds) all objects are polled. A capture begins at once,
or with --trigger: SIGNAL:rising:LEVEL, falling, above, below, with the signals counted from 1; or fault, which watches
the statusword of all nodes. It can wait for a trigger for days. --overlay draws an earlier capture (CSV) underneath the
new one, --cursors prints dt, dv and RMS between two times. Nothing is written to a node.

Exit codes: 0 good; 1 nothing was captured, or the node is gone; 2 wrong usage, no such object.
"""

from __future__ import annotations

import math
import signal
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.arguments import add_duration, number, seconds, whole_number
from canopen_control.cli.support.open_session import add_session_arguments, open_sessions
from canopen_control.cli.support.output import Table, json_text
from canopen_control.commissioning.scope_capture import (
    Condition,
    ScopeCapture,
    ScopeState,
    csv_of,
    named_shot,
    parse_csv,
    parse_trigger,
    picture_of,
    refuse_without_pictures,
    write_bag,
)
from canopen_control.commissioning.scope_signals import (
    MOST_SIGNALS,
    PolledSource,
    RobotSource,
    SignalValues,
    joint_signal_of,
    node_of,
    signal_of,
    statuswords_of,
)
from canopen_control.errors import ConfigError
from canopen_control.host.files import write_whole
from canopen_control.host.signals import on_signals

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence
    from typing import TextIO

    from canopen_control.commissioning.scope_capture import NamedShot, Shot, Trigger
    from canopen_control.commissioning.scope_signals import ScopeSource, Signal


# What becomes of a scope's shots: measures and a curve of characters for people, and files (CSV, PNG, MCAP).


CSV, BAG, PICTURE = ".csv", ".mcap", ".png"
_BLOCKS: Final = " ▁▂▃▄▅▆▇█"
_WIDTH: Final = 60


def check_output(text: str) -> Path:
    """Return the file, or the folder of a bag; ConfigError for another suffix or a missing folder."""
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
    """Read a capture from CSV; ConfigError if it is invalid."""
    path = Path(text).expanduser()
    try:
        content = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"--overlay {text} cannot be read: {getattr(error, 'strerror', None) or 'no text'}") from None
    return parse_csv(content, path.name)


def numbered(path: Path, number: int, *, several: bool) -> Path:
    """Return the path of a capture by its `number` (from 1): scope.csv, or scope_1.csv of several."""
    return path.with_name(f"{path.stem}_{number}{path.suffix}") if several else path


def write_shot(
    path: Path,
    shot: Shot,
    signals: Sequence[Signal],
    overlay: NamedShot | None = None,
    cursors: tuple[float, float] | None = None,
) -> Path:
    """Write a capture; return its file, or the folder of the bag; ConfigError and DiskFull."""
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
    """Yield measurements and a curve for each signal, and those of the overlay."""
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


def _shot_document(
    shot: Shot, signals: Sequence[Signal], cursors: tuple[float, float] | None, written: Path | None
) -> dict[str, object]:
    """Return a capture for --json: measurements, cursors and samples of each signal, times from the trigger."""
    return {
        "triggered": shot.triggered,
        "signals": [
            {
                "name": other.name,
                "label": other.label,
                "unit": other.unit,
                "measured": shot.measure(place),
                "cursors": None if cursors is None else shot.cursors(place, *cursors),
            }
            for place, other in enumerate(signals)
        ],
        "samples": [[time - shot.zero, *row[: len(signals)]] for time, row in shot.rows],
        "file": None if written is None else str(written),
    }


def _measured(shot: Shot, place: int) -> list[str]:
    measured, numbers = shot.measure(place), ["-"] * 4
    if measured is not None:
        numbers = [f"{value:.6g}" for value in (measured.least, measured.most, measured.mean, measured.rms)]
    return [*numbers, f"|{curve(shot, place)}|"]


def cursor_lines(shot: Shot, signals: Sequence[Signal], cursors: tuple[float, float]) -> Iterator[str]:
    """Yield the signals at two times, their differences, and the RMS between them."""
    first, second = cursors
    apart = second - first
    often = f" ({1 / abs(apart):.4g} Hz)" if apart else ""
    yield f"cursors at {first:g} s and {second:g} s: dt {apart:.6g} s{often}"
    table = Table(("signal", "unit", f"at {first:g} s", f"at {second:g} s", "dv", "RMS between"))
    for place, other in enumerate(signals):
        read = shot.cursors(place, first, second)
        values = [] if read is None else [read.first, read.second, read.difference, read.rms]
        table.add([other.name, other.unit, *([f"{value:.9g}" for value in values] or ["-"] * 4)])
    yield from table.lines()


def curve(shot: Shot, place: int, width: int = _WIDTH) -> str:
    """Return a signal as a line of block characters, scaled to its maximum, each the mean of an equal time span."""
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
        if count:  # else the last value holds
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

_RATE: Final = 50.0  # Hz
_FASTEST: Final = 1000.0
_LOOK_S: Final = 0.1
_LINE_S: Final = 0.5
_ENDS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "signals",
        nargs="+",
        metavar="NODE:OBJECT",
        help="signals such as 3:0x6064, left_drive:0x606C, left_joint:velocity",
    )
    add_session_arguments(parser, node=False)
    rate = number("rate in Hz above 0, at most 1000", lambda value: 0 < value <= _FASTEST)
    parser.add_argument("--rate", type=rate, default=_RATE, metavar="HZ", help="polling rate (default: 50)")
    add_duration(parser, "length of a capture (default: 5)", former="--length", dest="length", default=5.0)
    parser.add_argument(
        "--trigger", metavar="T", help="start of a capture: SIGNAL:rising|falling|above|below:LEVEL, or fault"
    )
    parser.add_argument(
        "--before", type=seconds, metavar="S", help="part of the capture before the trigger (default: a fifth)"
    )
    shots = whole_number("number of shots: 1 or more", range(1, 1_000_000))
    parser.add_argument("--shots", type=shots, default=1, metavar="N", help="number of captures (default: 1)")
    parser.add_argument("--rolling", action="store_true", help="capture repeatedly, until Ctrl-C")
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
    if len(args.signals) > MOST_SIGNALS:
        raise ConfigError(f"{len(args.signals)} signals are too many for one look; {MOST_SIGNALS} at most")
    if args.before is not None and args.trigger is None:
        raise ConfigError("--before is of a trigger; give --trigger too")
    output = _Output(
        None if args.output is None else check_output(args.output),
        overlay=None if args.overlay is None else read_overlay(args.overlay),
        cursors=None if args.cursors is None else _cursors(args.cursors),
    )
    trigger = None if args.trigger is None else parse_trigger(args.trigger, len(args.signals))
    joints = [joint_signal_of(text) for text in args.signals]
    nodes = [node_of(text) for text, joint in zip(args.signals, joints, strict=True) if joint is None]
    with open_sessions(args, nodes) as (sessions, client):
        if client is None and any(joints):
            raise ConfigError("joints are of a running robot; on a bare bus a scope shows objects: NODE:OBJECT")
        signals: list[Signal] = [
            joint or signal_of(text, sessions[node_of(text)]) for text, joint in zip(args.signals, joints, strict=True)
        ]
        by_id = {session.node_id: session for session in sessions.values()}
        is_fault = trigger is not None and trigger.condition is Condition.FAULT
        extra: list[Signal] = [*statuswords_of(signals, by_id)] if is_fault else []
        capture = _capture(args, trigger, len(signals), len(extra))
        values = SignalValues([*signals, *extra])
        source: ScopeSource = (
            PolledSource(values, by_id, args.rate) if client is None else RobotSource(client, values, by_id, args.rate)
        )
        return _ScopeLoop(
            capture, source, signals, output, wait=args.wait, several=args.rolling or args.shots > 1, as_json=args.json
        ).run()


def _capture(args: argparse.Namespace, trigger: Trigger | None, signals: int, extra: int) -> ScopeCapture:
    if trigger is not None and trigger.condition is Condition.FAULT:
        trigger = replace(trigger, places=tuple(range(signals, signals + extra)))
    before = 0.0 if trigger is None else args.length / 5 if args.before is None else args.before
    return ScopeCapture(trigger, length=args.length, before=before, shots=None if args.rolling else args.shots)


def _cursors(text: str) -> tuple[float, float]:
    """Read `0.1,0.25`; ConfigError."""
    try:
        first, second = map(float, text.split(","))
    except ValueError:
        first = second = math.nan
    if not (math.isfinite(first) and math.isfinite(second)):
        raise ConfigError(f"--cursors {text}: write two times in s, as in 0.1,0.25 (or --cursors=-0.1,0.25)")
    return first, second


@dataclass(frozen=True, slots=True)
class _Output:
    """Output of captures: files, overlay and cursors."""

    path: Path | None
    overlay: NamedShot | None = None
    cursors: tuple[float, float] | None = None


class _ScopeLoop:
    """Main loop of a scope: receives samples and outputs captures until it is complete or stopped."""

    def __init__(
        self,
        capture: ScopeCapture,
        source: ScopeSource,
        signals: Sequence[Signal],
        output: _Output,
        *,
        wait: float | None,
        several: bool,
        as_json: bool,
    ) -> None:
        self._capture, self._source, self._signals, self._output = capture, source, signals, output
        self._wait, self._several, self._as_json = wait, several, as_json
        self._ended = False
        self._taken = 0
        self._shown = 0.0

    def run(self) -> int:
        """Capture until complete; 1 without a capture."""
        begin = time.monotonic()
        before = self._source.cycles()
        with on_signals(_ENDS, self._end):
            while not (self._capture.done or self._ended):
                for moment, row in self._source.samples(_LOOK_S):
                    self._capture.feed(moment, row)
                    self._show(row)
                    if self._capture.done:
                        break
                self._capture.tick(time.time())
                self._report()
                waits = self._capture.state is ScopeState.WAITING and self._wait is not None
                if waits and time.monotonic() - begin > (self._wait or 0.0):
                    break
            self._capture.stop()
            self._report()
        _print_missed(before, self._source.cycles(), sys.stderr if self._as_json else sys.stdout)
        if not self._taken:
            print("canopen-control: no shot was taken: the trigger did not come", file=sys.stderr)
        return 0 if self._taken else 1

    def _end(self) -> None:
        self._ended = True

    def _report(self) -> None:
        """Print and write the completed captures."""
        for shot in self._capture.take():
            self._taken += 1
            self._wipe()
            output, written = self._output, None
            if output.path is not None:
                path = numbered(output.path, self._taken, several=self._several)
                written = write_shot(path, shot, self._signals, output.overlay, output.cursors)
            if self._as_json:
                print(json_text(_shot_document(shot, self._signals, output.cursors, written), indent=None), flush=True)
                continue
            print("\n".join(shot_lines(shot, self._signals, output.overlay)), flush=True)
            if output.cursors is not None:
                print("\n".join(cursor_lines(shot, self._signals, output.cursors)), flush=True)
            if written is not None:
                print(f"written: {written}", flush=True)

    def _show(self, row: Sequence[float | None]) -> None:
        """Show the newest values on one line of a terminal."""
        now = time.monotonic()
        if not sys.stderr.isatty() or now - self._shown < _LINE_S:
            return
        self._shown = now
        pairs = zip(self._signals, row, strict=False)
        values = ", ".join(f"{chosen.name} {'-' if value is None else f'{value:g}'}" for chosen, value in pairs)
        print(f"\r{self._capture.state.value}: {values}\x1b[K", end="", file=sys.stderr, flush=True)

    def _wipe(self) -> None:
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)


def _print_missed(before: tuple[int, int] | None, after: tuple[int, int] | None, file: TextIO) -> None:
    """Print the number of cycles of a running robot, and of missed cycles."""
    if before is not None and after is not None:
        print(f"the robot made {after[0] - before[0]} cycles meanwhile and missed {after[1] - before[1]}", file=file)
