"""Tree of the nodes of a YAML file, each with its value, line, column and dotted path, and the problems of the file.

Errors are collected instead of raised one by one, so that a user sees all of them at once. Each error is reported as
`path:line:column: where: what`, with the line of the file and a caret.
"""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

from canopen_control.errors import BusConfigError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator

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
        self.repeated: list[Problem] = []  # keys that occur twice in a mapping

    @property
    def errors(self) -> list[Problem]:
        """Errors in the order of their lines, without duplicates."""
        return sorted(self._errors)

    @property
    def warnings(self) -> list[Problem]:
        """Warnings in the order of their lines, without duplicates."""
        return sorted(self._warnings)

    def at(self, line: int, column: int, where: str, message: str) -> Problem:
        """Return a problem at a position counted from 1; line 0 means the file as a whole."""
        source = self.lines[line - 1][:200] if 0 < line <= len(self.lines) else ""
        return Problem(line, column, self.path, where, message, source)

    def error(self, place: Place, message: str) -> None:
        self._errors[self.at(place.line, place.column, place.where, message)] = None

    def warning(self, place: Place, message: str) -> None:
        self._warnings[self.at(place.line, place.column, place.where, message)] = None

    def deviation(self, place: Place, message: str) -> None:
        """Add an error if `strict`, otherwise a warning."""
        (self.error if self.strict else self.warning)(place, message)

    def discard_below(self, where: str) -> None:
        """Remove the errors below a dotted path, since they result from another error."""
        self._errors = {error: None for error in self._errors if not error.where.startswith(f"{where}.")}

    def take_errors(self, others: dict[Problem, None]) -> dict[Problem, None]:
        """Exchange the errors for others, and return them."""
        errors, self._errors = self._errors, others
        return errors

    def file_error(self, line: int, column: int, message: str) -> None:
        """Add an error at a position without a node."""
        self._errors[self.at(line, column, "", message)] = None

    def raise_if_any(self, error: type[ConfigError] = BusConfigError) -> None:
        """Raise `error` with the texts of all errors, if any."""
        raise_all([self], error)


def raise_all(files: Iterable[Problems], error: type[ConfigError]) -> None:
    """Raise `error` with the texts of all errors in several files, if any."""
    errors = [problem for file in files for problem in file.errors]
    if not errors:
        return
    count = f"\n{len(errors)} errors" if len(errors) > 1 else ""
    reason = "\n".join(str(problem) for problem in errors) + count
    if issubclass(error, BusConfigError):
        raise error(errors[0].path, errors[0].line, errors[0].where, reason)
    raise error(reason)


@contextlib.contextmanager
def raising(files: Collection[Problems], error: type[ConfigError]) -> Iterator[None]:
    """Raise `error` at the end of the context if errors were added to the files in it."""
    before = [(file, file.take_errors({})) for file in files]
    try:
        yield
        raise_all(files, error)
    finally:
        for file, errors in before:
            file.take_errors(errors)


class Node:
    """Node of a YAML file, with its value and its position in the file.

    `kind` is "mapping", "sequence", "scalar" or "null"; `text` is a scalar as written, `quoted` whether it is quoted or
    a block; `where` is the dotted path; `line` and `column` count from 1, and line 0 means that the node is in no file.
    Methods for another kind return an empty result and never raise: `items()` of a scalar is empty.
    """

    __slots__ = ("_elements", "_pairs", "_scalar", "column", "kind", "line", "problems", "quoted", "text", "where")

    def __init__(self, kind: str, line: int, column: int, where: str, problems: Problems) -> None:
        self.kind, self.line, self.column, self.where, self.problems = kind, line, column, where, problems
        self.text, self.quoted = "", False
        self._scalar: object = None
        self._pairs: dict[str, tuple[Node, Node]] = {}
        self._elements: list[Node] = []

    @classmethod
    def scalar(cls, node: Node, text: str, value: object, *, quoted: bool) -> Node:
        """Set the text and value of a scalar node, and return the node."""
        node.text, node._scalar, node.quoted = text, value, quoted
        return node

    @classmethod
    def mapping(cls, node: Node, pairs: dict[str, tuple[Node, Node]]) -> Node:
        """Set the (key node, value node) pairs of a mapping node, by key, and return the node."""
        node._pairs = pairs
        return node

    @classmethod
    def sequence(cls, node: Node, elements: list[Node]) -> Node:
        """Set the elements of a sequence node, and return the node."""
        node._elements = elements
        return node

    def __repr__(self) -> str:
        return f"Node({self.path}:{self.line}:{self.column} {self.where})"

    @property
    def path(self) -> str:
        return self.problems.path

    @property
    def value(self) -> Any:  # noqa: ANN401 - a file may hold anything
        """Value as plain Python objects, with dicts (keys as written) and lists."""
        if self.kind == "mapping":
            return {key: child.value for key, child in self.items()}
        if self.kind == "sequence":
            return [child.value for child in self._elements]
        return self._scalar

    def pairs(self) -> list[tuple[Node, Node]]:
        """Return the key and value nodes in the order of the file, with keys from merges last.

        Of a repeated key only the last pair is included; its mapping contains the other ones too if that is an error.
        """
        return list(self._pairs.values())

    def items(self) -> list[tuple[str, Node]]:
        """Return pairs of the key as written and the value node, in the order of the file."""
        return [(key, value) for key, (_, value) in self._pairs.items()]

    def keys(self) -> dict[str, Node]:
        """Return the key nodes by name, for messages about a key instead of its value."""
        return {key: node for key, (node, _) in self._pairs.items()}

    def get(self, key: str) -> Node | None:
        """Return the value node of a key, or None."""
        pair = self._pairs.get(key)
        return pair[1] if pair else None

    def elements(self) -> list[Node]:
        """Return the nodes of a sequence; empty for other nodes."""
        return list(self._elements)

    def merged_over(self, defaults: Node) -> Node:
        """Return this node with the additional keys of `defaults`, recursively for mappings in both nodes."""
        if self.kind == "null" and defaults.kind == "mapping":
            return defaults
        if self.kind != "mapping" or defaults.kind != "mapping":
            return self
        pairs = dict(defaults._pairs)
        for name, (key, value) in self._pairs.items():
            pairs[name] = (key, value.merged_over(pairs[name][1]) if name in pairs else value)
        return Node.mapping(Node(self.kind, self.line, self.column, self.where, self.problems), pairs)

    def error(self, message: str) -> None:
        """Report an error at this node; `problems.raise_if_any()` raises it with all others."""
        self.problems.error(self, message)

    def warning(self, message: str) -> None:
        """Report a warning at this node; the file remains usable."""
        self.problems.warning(self, message)


NOWHERE: Final = Node("null", 0, 0, "", Problems(""))
"""Node of an object that was created in Python instead of read from a file."""
