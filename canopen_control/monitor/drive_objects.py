"""The objects of the drive that the monitor looks at: rows by address, live where they are in sight, search and edit.

The law of the file: nobody who draws waits. The EDS is read on a thread, objects by the reader that all screens share,
at the rate of the verb `objects`; `write` and `undo` are for threads that may wait.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Final

from canopen_control.errors import CanopenError, ConfigError
from canopen_control.monitor.monitor_content import Cell, Tone, plain
from canopen_control.service.live_reader import LiveReader
from canopen_control.service.node_objects import NodeObjects
from canopen_control.service.object_edit import EditHistory
from canopen_control.service.object_rows import LiveObject, rows_of
from canopen_control.service.object_selection import select_objects

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from canopen_control.od.model import Address, Entry, ObjectDictionary
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.service.object_rows import ObjectRow

__all__ = ["OBJECT_COLUMNS", "DriveObjects"]

OBJECT_COLUMNS: Final = ("address", "name", "value", "unit", "meaning", "default", "type", "access")
_SCREEN: Final = "monitor"
_WIDEST: Final = 40


class DriveObjects:
    """The objects of one node at a time; `title` says which and what keeps it from being read."""

    def __init__(self, source: str) -> None:
        self._source, self._reader = source, LiveReader()
        self._nodes: dict[tuple[str, str], NodeObjects] = {}
        self._node: NodeObjects | None = None
        self._edits: dict[NodeObjects, EditHistory] = {}
        self._editing = threading.Lock()  # keys come faster than a drive answers
        self._od: ObjectDictionary | None = None
        self._why = "no drive is selected"
        self._words = ""
        self._entries: dict[str, Entry] = {}
        self._cells: dict[str, tuple[Cell, ...]] = {}
        self._sent = 0

    def choose(self, robot: str, place: NodePlace | None) -> None:
        """Look at a node, None: at nothing."""
        if place is None:
            self.leave()
            self._node, self._why = None, "no drive is selected"
            return
        node = self._nodes.setdefault((robot, place.name), NodeObjects(robot, place, self._source))
        if node is not self._node:
            self.leave()
            self._node, self._od, self._why = node, None, "reading the EDS"
            self._entries, self._cells, self._sent = {}, {}, 0
            threading.Thread(target=self._read_eds, args=(node,), name="eds", daemon=True).start()

    def _read_eds(self, node: NodeObjects) -> None:
        try:
            od, why = node.dictionary(), ""
        except CanopenError as error:
            od, why = None, str(error)
        if node is self._node:
            self._why = why or ("" if od is not None else "bus.yml names no EDS for it")
            self._od = od

    def search(self, words: str) -> None:
        """Show what these words mean, as those of the verb `objects`; ConfigError where they mean none."""
        if self._od is not None and words:
            select_objects(self._od, words.split(","))
        self._words, self._entries, self._cells, self._sent = words, {}, {}, 0

    def write(self, text: str) -> str:
        """Write an object, as in 0x6081=1000, and return what it changed; CanopenError with the reason. Waits."""
        node, od = self._node, self._od
        address, equals, value = text.partition("=")
        if node is None or od is None:
            raise ConfigError(f"set: {self._why}")
        if not (equals and address.strip() and value.strip()):
            raise ConfigError(f"set {text}: write an object and its value, as in 0x6081=1000")
        entry, *others = select_objects(od, [address.strip()])
        if others:
            raise ConfigError(
                f"set {text}: {address} is {1 + len(others)} objects; name one, as {_address(entry.address)}"
            )
        with self._editing, node.session() as session:
            return self._history(node).write(session, entry, value).words

    def undo(self) -> str:
        """Undo the newest write at this node, and return what that changed; CanopenError with the reason. Waits."""
        if (node := self._node) is None:
            raise ConfigError(f"undo: {self._why}")
        with self._editing, node.session() as session:
            return self._history(node).undo(session).words

    def _history(self, node: NodeObjects) -> EditHistory:
        return self._edits.setdefault(node, EditHistory())

    @property
    def title(self) -> str:
        """Which node it is, and what is to be known of it."""
        if self._node is None:
            return self._why
        place = self._node.place
        notes = [self._why, self._node.lost, f"search: {self._words}" if self._words else ""]
        return "  ·  ".join([f"{place.name}, node {place.node_id}", *filter(None, notes)])

    def rows(self) -> Mapping[str, tuple[Cell, ...]]:
        """Return the rows by address."""
        node, od = self._node, self._od
        if node is None or od is None:
            return {}
        if not self._cells:
            self._list(od, node.place.node_id)
        known = [each for each in list(node.live.values()) if each[0] > self._sent]
        if known:
            self._sent = max(number for number, _ in known)
            self._show(od, node.place.node_id, [live for _, live in known])
        return self._cells

    def look(self, addresses: Iterable[str]) -> None:
        """Have these rows read, and no others."""
        if self._node is not None:
            entries = [self._entries[each] for each in addresses if each in self._entries]
            self._reader.watch(_SCREEN, self._node, entries)

    def leave(self) -> None:
        """Read no more."""
        if self._node is not None:
            self._reader.watch(_SCREEN, self._node, ())

    def _list(self, od: ObjectDictionary, node_id: int) -> None:
        try:
            entries = select_objects(od, self._words.split(",") if self._words else ())
        except ConfigError as error:
            self._why, entries = str(error), []
        self._entries = {_address(entry.address): entry for entry in entries}
        self._show(od, node_id, [LiveObject(entry) for entry in entries])

    def _show(self, od: ObjectDictionary, node_id: int, objects: list[LiveObject]) -> None:
        wanted = [each for each in objects if _address(each.entry.address) in self._entries]
        for each, row in zip(wanted, rows_of(od, wanted, node_id), strict=True):
            self._cells[_address(each.entry.address)] = _cells(row)


def _address(address: Address) -> str:
    return f"0x{address[0]:04X}:{address[1]:02X}"


def _cells(row: ObjectRow) -> tuple[Cell, ...]:
    """Return the cells of an object; what is not as by default has a sign, as what a node refuses has."""
    value = Cell(_cut(row.value or "-"), Tone.WARN if row.changed else Tone.PLAIN)
    if row.error:
        value = Cell("refused", Tone.BAD)
    texts = (row.unit if row.value else "", _cut(row.meaning or row.error or ""), _cut(row.default or "-"))
    return (
        plain(f"{row.index}:{row.subindex:02X}"),
        plain(_cut(row.name)),
        value,
        *map(plain, (*texts, row.type, row.access)),
    )


def _cut(text: str) -> str:
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 3]}..."
