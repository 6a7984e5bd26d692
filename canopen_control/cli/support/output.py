"""Output of verbs: JSON, tables and progress.

Progress goes to standard error, so that results stay clean; short work prints none. The line on a terminal is erased
before anything else is printed. Without a terminal (a log, a pipe) there are no control characters. JSON is ASCII, and
nan and infinite numbers become null.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import re
import sys
import time

from canopen_control.errors import CanopenError

TYPE_CHECKING = False  # the module typing takes longer to import than this one
if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from typing import Final, TextIO


SOON_S: Final = 0.5  # on a terminal, shorter work shows no progress
REDRAW_S: Final = 0.2
PLAIN_S: Final = 5.0  # time between two lines, if the stream is not a terminal


def json_text(document: object, *, indent: int | None = 2) -> str:
    """Return a document as JSON, indented, or on one line if `indent` is None."""
    from canopen_control.rpc.wire import plain  # imports msgspec, which a table does not need

    return json.dumps(plain(document), indent=indent)


def print_result(args: argparse.Namespace, document: object, text: str = "") -> None:
    """Print the result of a verb: `document` as JSON with --json, otherwise `text` unless empty."""
    if args.json:
        print(json_text(document))
    elif text:
        print(text)


@contextlib.contextmanager
def json_alone(args: argparse.Namespace) -> Iterator[None]:
    """Context that, with --json, redirects standard output to standard error, so that JSON is printed alone."""
    with contextlib.redirect_stdout(sys.stderr) if args.json else contextlib.nullcontext():
        yield


def json_line(document: object) -> str:
    """Return a document as compact JSON on one line, faster than `json_text`."""
    from canopen_control.rpc.wire import plain, text_of

    line = text_of(document)
    return line.decode() if line.isascii() else json.dumps(plain(document), separators=(",", ":"))


class Progress:
    """Progress display of the task `title`: a rewritten line on a terminal, otherwise occasional lines.

    Use as a context manager, or call `end`; `quiet` prints nothing, `rate` adds speed and remaining time.
    """

    def __init__(
        self,
        title: str,
        unit: str = "",
        *,
        quiet: bool = False,
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
        rate: bool = False,
    ) -> None:
        self._title, self._unit, self._clock = title, f" {unit}" if unit else "", clock
        self._stream = sys.stderr if stream is None else stream
        self._live, self._rate = self._stream.isatty(), rate
        self._quiet = quiet
        self._begin = clock()
        self._rated_from = self._begin, 0  # time and amount from which the rate is computed
        self._last: tuple[int, int | None] = 0, None
        self._next_output = self._begin + (SOON_S if self._live else PLAIN_S)
        self._shown = False

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def at(self, done: int, total: int | None = None) -> None:
        """Show that `done` of `total` units are done, if an update is due."""
        now = self._clock()
        if not done or done < self._last[0] or total != self._last[1]:  # another transfer
            self._rated_from = now, done
        self._last = done, total
        if self._quiet or now < self._next_output:
            return
        self._next_output = now + (REDRAW_S if self._live else PLAIN_S)
        since, before = self._rated_from
        rate = _rate(done, total, done - before, now - since, self._unit) if self._rate else ""
        self._show(f"{self._title}{_amount(done, total, self._unit)}, {now - self._begin:.0f} s{rate}")

    def end(self) -> None:
        """Erase the progress line; a second call does nothing."""
        if self._shown and self._live:
            self._write("\r\x1b[K")
        self._shown = False

    def _show(self, line: str) -> None:
        self._write(f"\r{line}\x1b[K" if self._live else f"{line}\n")
        self._shown = True

    def _write(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # without a reader the work continues
            self._stream.write(text)
            self._stream.flush()


def _amount(done: int, total: int | None, unit: str) -> str:
    if total:
        return f": {done:,} of {total:,}{unit} ({100 * done // total} %)"
    return f": {done:,}{unit}" if done else ""


def _rate(done: int, total: int | None, gained: int, elapsed: float, unit: str) -> str:
    """Return the rate and the remaining time as text, or "" before they can be estimated."""
    if gained <= 0 or not total or elapsed <= 0.0:
        return ""
    return f", {gained / elapsed:,.0f}{unit}/s, {(total - done) * elapsed / gained:.0f} s left"


ENDS: Final = ("stopping", "stopped")
_ALWAYS: Final = ("demo", "flight", "view", *ENDS)
_CHATTER: Final = ("note", "mode", "state", "failed")  # the verb itself prints why a run failed


def is_printed(kind: str, *, notable: bool) -> bool:
    """Whether `run` prints events of this kind; `notable` is True for events of a high level."""
    return kind in _ALWAYS or (notable and kind not in _CHATTER)


def with_token(text: str) -> str:
    """Complete page addresses in a line with their access tokens, which are read from files."""
    from canopen_control.view.page_address import page_addresses

    with contextlib.suppress(CanopenError):
        for place, url in page_addresses().items():
            text = text.replace(place, url)
    return text


def painted(lines: Iterable[str]) -> list[str]:
    """Colour words in lines by level; unchanged without a terminal or with NO_COLOR."""
    if sys.stdout is None or not sys.stdout.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return list(lines)
    return [
        _coloured().sub(lambda match: f"\x1b[{_COLOURS[match.lastgroup or '']}m{match[0]}\x1b[m", line)
        for line in lines
    ]


_COLOURS: Final = {"wrong": "31", "doubtful": "33", "good": "32"}


@functools.cache
def _coloured() -> re.Pattern[str]:
    from canopen_control.rpc.messages.health import AXIS_STATES, BAD, GOOD, WARN
    from canopen_control.rpc.quick_verbs import state_name

    wrong, doubtful, good = (
        "|".join(state_name(state) for state, words in AXIS_STATES.items() if words.tone == tone)
        for tone in (BAD, WARN, GOOD)
    )
    return re.compile(
        rf"(?P<wrong>\b(?:{wrong})\b|\berrors?(?=[:,]|$)|^fault\b|^  node \d+ \(.*|\bNOTHING stops\b.*)"
        rf"|(?P<doubtful>\bwarnings?(?=[:,]|$)|\bSTOPPED\b|\b(?:{doubtful})\b|^(?:stopped|stopping|waiting)\b)"
        rf"|(?P<good>\b(?:{good})\b|^running\b|\bnothing is wrong$)"
    )


class Table:
    """Rows of text under headings: columns as wide as their widest cell, numbers right-aligned."""

    def __init__(self, headings: Sequence[str]) -> None:
        self._rows: list[Sequence[str]] = [headings]

    def add(self, row: Sequence[str]) -> None:
        self._rows.append(row)

    def lines(self, width: int | None = None, expendable: Sequence[str] = ()) -> list[str]:
        """Return the lines of the table, headings first.

        If the table is wider than `width`, `expendable` columns are hidden one by one until it fits, and a last line
        names them. Lines that are still too long are cut.
        """
        rows, hidden = self._rows, list[str]()
        lines = _aligned(rows)
        for heading in expendable if width is not None else ():
            if max(map(len, lines)) <= (width or 0):
                break
            hidden.append(heading)
            keep = [column for column, text in enumerate(self._rows[0]) if text not in hidden]
            rows = [[row[column] for column in keep] for row in self._rows]
            lines = _aligned(rows)
        if hidden:
            lines.append(f"(a wider terminal shows: {', '.join(hidden)})")
        return lines if width is None else [line[:width] for line in lines]


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return ["  ".join(_cell(text, width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _cell(text: str, width: int) -> str:
    number = text.lstrip("-")[:1].isdigit()
    return text.rjust(width) if number else text.ljust(width)


_ENTRY_WIDTH = 110


def print_entry(name: str, text: str) -> None:
    """Print the entry of a list of faults or quirks, as a name and an indented text."""
    import textwrap

    print(name)
    print(textwrap.fill(text, _ENTRY_WIDTH, initial_indent="    ", subsequent_indent="    "))
