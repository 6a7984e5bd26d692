"""Tree of the nodes of a YAML file, each with its value, line, column and dotted path."""

from __future__ import annotations

from typing import Any, Final

from canopen_control.yamlfile.problems import Problems


class Node:
    """Node of a YAML file, with its value and its position in the file.

    `kind` is "mapping", "sequence", "scalar" or "null"; `text` is a scalar as written, `quoted` whether it is quoted or
    a block; `where` is the dotted path; `line` and `column` count from 1, and line 0 means that the node is in no file.
    Methods for another kind return nothing and never raise: `items()` of a scalar is empty.
    """

    __slots__ = ("_elements", "_pairs", "_scalar", "column", "kind", "line", "problems", "quoted", "text", "where")

    def __init__(self, kind: str, line: int, column: int, place: str, problems: Problems) -> None:
        self.kind, self.line, self.column, self.where, self.problems = kind, line, column, place, problems
        self.text, self.quoted = "", False
        self._scalar: object = None
        self._pairs: dict[str, tuple[Node, Node]] = {}
        self._elements: list[Node] = []

    @classmethod
    def scalar(cls, place: Node, text: str, value: object, *, quoted: bool) -> Node:
        """Make the node `place` a scalar and return it."""
        place.text, place._scalar, place.quoted = text, value, quoted
        return place

    @classmethod
    def mapping(cls, place: Node, pairs: dict[str, tuple[Node, Node]]) -> Node:
        """Make the node `place` a mapping of (key node, value node) pairs by key and return it."""
        place._pairs = pairs
        return place

    @classmethod
    def sequence(cls, place: Node, elements: list[Node]) -> Node:
        """Make the node `place` a sequence and return it."""
        place._elements = elements
        return place

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
        """Return the key and value nodes in the order of the file, keys from merges last.

        Of a repeated key, only the last pair is included.
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

    def over(self, below: Node) -> Node:
        """Return this node with the additional keys of `below`, recursively for mappings in both nodes."""
        if self.kind == "null" and below.kind == "mapping":
            return below
        if self.kind != "mapping" or below.kind != "mapping":
            return self
        pairs = dict(below._pairs)
        for name, (key, value) in self._pairs.items():
            pairs[name] = (key, value.over(pairs[name][1]) if name in pairs else value)
        return Node.mapping(Node(self.kind, self.line, self.column, self.where, self.problems), pairs)

    def error(self, message: str) -> None:
        """Report an error at this node; `problems.raise_if_any()` raises it with all others."""
        self.problems.error(self, message)

    def warning(self, message: str) -> None:
        """Report a warning at this node; the file remains usable."""
        self.problems.warning(self, message)


NOWHERE: Final = Node("null", 0, 0, "", Problems(""))
"""Node of an object that was created in Python instead of read from a file."""
