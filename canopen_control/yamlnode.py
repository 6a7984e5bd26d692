"""Places in a YAML file, and the mistakes found at them: what `yamltree` reads text into.

The law of the file: a mistake is collected, never raised on its own, so that a user sees all of them at once; each is
told as `path:line:column: where: what`, with its line of the file and a caret.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import BusConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.errors import ConfigError

__all__ = ["LINE_END", "NOWHERE", "Node", "Problem", "Problems", "nearest"]

LINE_END: Final = re.compile("\r\n|[\n\r\x85\u2028\u2029]")
"""What ends a line in YAML 1.1, so that our lines are those of the parser."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Return `, did you mean 'x'?`, or the list of what there is, or nothing when there is nothing."""
    names = [str(each) for each in known]
    close = difflib.get_close_matches(name, names, 1, 0.6)
    if close:
        return f", did you mean {close[0]!r}?"
    return f"; known: {', '.join(names)}" if names else ""


@dataclass(frozen=True, slots=True, order=True)
class Problem:
    """One mistake: `where` is the dotted way through the file, `source` the line it stands on; lines count from 1."""

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
    """Collects the mistakes of one file, so that all are told at once.

    `error` makes a file unusable, `warning` does not. With `strict` false, a repeated or unknown key is a warning.
    """

    def __init__(self, path: str, text: str = "", *, strict: bool = True) -> None:
        self.path, self.strict = path, strict
        self.lines = LINE_END.split(text)
        self._errors: dict[Problem, None] = {}
        self._warnings: dict[Problem, None] = {}

    @property
    def errors(self) -> list[Problem]:
        """The errors in the order of their lines; each once, however often an alias repeats it."""
        return sorted(self._errors)

    @property
    def warnings(self) -> list[Problem]:
        """The warnings in the order of their lines."""
        return sorted(self._warnings)

    def at(self, line: int, column: int, where: str, message: str) -> Problem:
        """Return a problem at a position counted from 1; line 0 is the file as a whole."""
        source = self.lines[line - 1][:200] if 0 < line <= len(self.lines) else ""
        return Problem(line, column, self.path, where, message, source)

    def error(self, node: Node, message: str) -> None:
        """Add an error at the node."""
        self._errors[self.at(node.line, node.column, node.where, message)] = None

    def warning(self, node: Node, message: str) -> None:
        """Add a warning at the node."""
        self._warnings[self.at(node.line, node.column, node.where, message)] = None

    def suspect(self, node: Node, message: str) -> None:
        """Add an error if strict, else a warning."""
        (self.error if self.strict else self.warning)(node, message)

    def file_error(self, line: int, column: int, message: str) -> None:
        """Add an error that belongs to no node."""
        self._errors[self.at(line, column, "", message)] = None

    def raise_if_any(self, error: type[ConfigError] = BusConfigError) -> None:
        """Raise `error` with every error's paragraph, if there is one."""
        found = self.errors
        if not found:
            return
        count = f"\n{len(found)} errors" if len(found) > 1 else ""
        reason = "\n".join(str(each) for each in found) + count
        if issubclass(error, BusConfigError):
            raise error(self.path, found[0].line, found[0].where, reason)
        raise error(reason)


class Node:
    """A place in a YAML file: its value, and where it stands.

    `kind` is "mapping", "sequence", "scalar" or "null"; `text` a scalar as it is written, `quoted` whether in quotes
    or as a block; `where` the dotted way to it; `line` and `column` count from 1, line 0 stands in no file.
    Reading a wrong kind gives nothing, never an exception: `items()` of a scalar is empty.
    """

    __slots__ = ("_elements", "_pairs", "_scalar", "column", "kind", "line", "problems", "quoted", "text", "where")

    def __init__(self, kind: str, line: int, column: int, where: str, problems: Problems) -> None:
        self.kind, self.line, self.column, self.where, self.problems = kind, line, column, where, problems
        self.text, self.quoted = "", False
        self._scalar: object = None
        self._pairs: dict[str, tuple[Node, Node]] = {}
        self._elements: list[Node] = []

    @classmethod
    def scalar(cls, place: Node, text: str, value: object, *, quoted: bool) -> Node:
        """Return `place` as a scalar."""
        place.text, place._scalar, place.quoted = text, value, quoted
        return place

    @classmethod
    def mapping(cls, place: Node, pairs: dict[str, tuple[Node, Node]]) -> Node:
        """Return `place` as a mapping of (key node, value node) by the key as written."""
        place._pairs = pairs
        return place

    @classmethod
    def sequence(cls, place: Node, elements: list[Node]) -> Node:
        """Return `place` as a sequence."""
        place._elements = elements
        return place

    def __repr__(self) -> str:
        return f"Node({self.path}:{self.line}:{self.column} {self.where})"

    @property
    def path(self) -> str:
        """The file."""
        return self.problems.path

    @property
    def value(self) -> Any:  # noqa: ANN401 - what stands there
        """The plain Python value, with dicts (keys as they are written) and lists."""
        if self.kind == "mapping":
            return {key: child.value for key, child in self.items()}
        if self.kind == "sequence":
            return [child.value for child in self._elements]
        return self._scalar

    def pairs(self) -> list[tuple[Node, Node]]:
        """Return key and value nodes in the order of the file: merge keys followed, of a repeated key the last."""
        return list(self._pairs.values())

    def items(self) -> list[tuple[str, Node]]:
        """Return (key as written, node) in the order of the file."""
        return [(key, value) for key, (_, value) in self._pairs.items()]

    def keys(self) -> dict[str, Node]:
        """Return the key nodes by name, to point at a key instead of its value."""
        return {key: node for key, (node, _) in self._pairs.items()}

    def get(self, key: str) -> Node | None:
        """Return the value node of a key, None if it is absent."""
        pair = self._pairs.get(key)
        return pair[1] if pair else None

    def elements(self) -> list[Node]:
        """Return the nodes of a sequence."""
        return list(self._elements)

    def error(self, message: str) -> None:
        """Report a mistake here; `problems.raise_if_any()` tells it with all others."""
        self.problems.error(self, message)

    def warning(self, message: str) -> None:
        """Report something here that does not make the file unusable."""
        self.problems.warning(self, message)


NOWHERE: Final = Node("null", 0, 0, "", Problems(""))
"""The node of what was made in Python instead of being read."""
