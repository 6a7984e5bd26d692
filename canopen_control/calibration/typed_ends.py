"""Where a base ended, as somebody measured it: typed when asked, or from a file; X and Y in m, one end a line."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError, ControlError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from canopen_control.calibration.base_link import Driven


def parse_end(text: str) -> tuple[float, float]:
    """Return X and Y of ``0.012 -0.034``, with or without a comma; ConfigError with what to write instead."""
    words = text.replace(",", " ").split()
    try:
        x, y = (float(word) for word in words)
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ConfigError(f"{text.strip()!r} is no end: write X Y, metres ahead and to the left, as in 0.012 -0.034")
    return x, y


class TypedEnds:
    """Asks somebody at a terminal; `ask` shows a text and returns a line, or raises EOFError."""

    def __init__(self, ask: Callable[[str], str], say: Callable[[str], object]) -> None:
        self._ask, self._say = ask, say

    def before(self, text: str) -> None:
        """Wait for Enter."""
        self._say(text)
        self._line("  put the base at its start, keep clear, and press Enter: it drives ")

    def end(self, text: str, driven: Driven) -> tuple[float, float]:  # noqa: ARG002 - of the others
        """Ask until an end is typed that can be read."""
        while True:
            try:
                return parse_end(self._line("  where did it end? X Y, m ahead and to the left of its start: "))
            except ConfigError as error:
                self._say(f"  {error}")

    def _line(self, prompt: str) -> str:
        try:
            return self._ask(prompt)
        except EOFError:
            raise ControlError("nobody answers any more; the calibration has ended") from None


class FiledEnds:
    """Ends of a file, in their order."""

    def __init__(self, ends: Sequence[tuple[float, float]], say: Callable[[str], object]) -> None:
        self._ends, self._say = list(ends), say

    def before(self, text: str) -> None:
        """Tell it, and go on."""
        self._say(text)

    def end(self, text: str, driven: Driven) -> tuple[float, float]:  # noqa: ARG002 - of the others
        """Return the next one."""
        return self._ends.pop(0)


def read_ends(path: Path, wanted: int, say: Callable[[str], object]) -> FiledEnds:
    """Read a file of ends, empty lines and ``# comments`` aside; ConfigError with every mistake and its line."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} cannot be read: {error}") from error
    ends, problems = [], []
    for number, line in enumerate(lines, 1):
        if text := line.partition("#")[0].strip():
            try:
                ends.append(parse_end(text))
            except ConfigError as error:
                problems.append(f"{path}:{number}: {error}")
    if not problems and len(ends) < wanted:
        problems.append(f"{path} has {len(ends)} ends, and {wanted} squares are driven; give one for each")
    if problems:
        raise ConfigError("\n".join(problems))
    return FiledEnds(ends, say)
