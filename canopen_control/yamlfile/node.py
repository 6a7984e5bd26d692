"""A YAML file as a tree of nodes: each place with its value, line, column and dotted path."""

from __future__ import annotations

from typing import Any, Final

from canopen_control.yamlfile.problems import Problems


class Node:
    """A place in a YAML file: its value, and where it stands.

    `kind` is "mapping", "sequence", "scalar" or "null"; `text` a scalar as it is written, `quoted` whether in quotes
    or as a block; `where` the dotted path to it; `line` and `column` count from 1, line 0 stands in no file.
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
    def value(self) -> Any:  # noqa: ANN401 - a file may hold anything
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

    def over(self, below: Node) -> Node:
        """Return this node with the keys of `below` added where it has none itself, at every depth of mappings."""
        if self.kind == "null" and below.kind == "mapping":
            return below
        if self.kind != "mapping" or below.kind != "mapping":
            return self
        pairs = dict(below._pairs)
        for name, (key, value) in self._pairs.items():
            pairs[name] = (key, value.over(pairs[name][1]) if name in pairs else value)
        return Node.mapping(Node(self.kind, self.line, self.column, self.where, self.problems), pairs)

    def error(self, message: str) -> None:
        """Report a mistake here; `problems.raise_if_any()` tells it with all others."""
        self.problems.error(self, message)

    def warning(self, message: str) -> None:
        """Report something here that does not make the file unusable."""
        self.problems.warning(self, message)


NOWHERE: Final = Node("null", 0, 0, "", Problems(""))
"""The node of what was made in Python instead of being read."""
