"""Errors and warnings about a YAML file, with their positions.

Errors are collected instead of raised one by one, so that a user sees all of them at once. Each error is reported as
`path:line:column: where: what`, with the line of the file and a caret.
"""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.errors import BusConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.errors import ConfigError


LINE_END: Final = re.compile("\r\n|[\n\r\x85\u2028\u2029]")
"""Line ends of YAML 1.1, so that line numbers agree with those of the parser."""


class Place(Protocol):
    """Position in a file: line and column from 1, and the dotted path."""

    line: int
    column: int
    where: str


@dataclass(frozen=True, slots=True, order=True)
class Problem:
    """Error or warning in a file: `where` is the dotted path, `source` the text of the line."""

    line: int
    column: int
    path: str
    where: str
    message: str
    source: str = ""

    def __str__(self) -> str:
        place = f"{self.path}:{self.line}:{self.column}: " if self.line else f"{self.path}: "
        text = place + (f"{self.where}: " if self.where else "") + self.message
        if not self.source.strip() or self.column > len(self.source) + 1:
            return text
        margin = "".join("\t" if char == "\t" else " " for char in self.source[: self.column - 1])
        return f"{text}\n    {self.source}\n    {margin}^"


class Problems:
    """Collected errors and warnings of one file.

    An `error` makes a file unusable, a `warning` does not. If `strict` is False, a repeated or unknown key is a
    warning.
    """

    def __init__(self, path: str, text: str = "", *, strict: bool = True) -> None:
        self.path, self.strict = path, strict
        self.lines = LINE_END.split(text)
        self._errors: dict[Problem, None] = {}
        self._warnings: dict[Problem, None] = {}

    @property
    def errors(self) -> list[Problem]:
        """Errors in the order of their lines, without duplicates."""
        return sorted(self._errors)

    @property
    def warnings(self) -> list[Problem]:
        """Warnings in the order of their lines, without duplicates."""
        return sorted(self._warnings)

    def at(self, line: int, column: int, place: str, message: str) -> Problem:
        """Return a problem at a position counted from 1; line 0 means the file as a whole."""
        source = self.lines[line - 1][:200] if 0 < line <= len(self.lines) else ""
        return Problem(line, column, self.path, place, message, source)

    def error(self, place: Place, message: str) -> None:
        self._errors[self.at(place.line, place.column, place.where, message)] = None

    def warning(self, place: Place, message: str) -> None:
        self._warnings[self.at(place.line, place.column, place.where, message)] = None

    def deviation(self, place: Place, message: str) -> None:
        """Add an error if `strict`, otherwise a warning."""
        (self.error if self.strict else self.warning)(place, message)

    def forget(self, where: str) -> None:
        """Remove the errors below a dotted path, since they result from another error."""
        self._errors = {error: None for error in self._errors if not error.where.startswith(f"{where}.")}

    def file_error(self, line: int, column: int, message: str) -> None:
        """Add an error at a position without a node."""
        self._errors[self.at(line, column, "", message)] = None

    @contextlib.contextmanager
    def raising(self, error: type[ConfigError]) -> Iterator[None]:
        """Raise `error` at the end of the context if errors were added in the context."""
        before, self._errors = self._errors, {}
        try:
            yield
            self.raise_if_any(error)
        finally:
            self._errors = before

    def raise_if_any(self, error: type[ConfigError] = BusConfigError) -> None:
        """Raise `error` with the texts of all errors, if any."""
        errors = self.errors
        if not errors:
            return
        count = f"\n{len(errors)} errors" if len(errors) > 1 else ""
        reason = "\n".join(str(problem) for problem in errors) + count
        if issubclass(error, BusConfigError):
            raise error(self.path, errors[0].line, errors[0].where, reason)
        raise error(reason)
