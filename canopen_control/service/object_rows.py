"""Objects of a node in words: what the EDS says of each, what it holds, and what that means; for tables and pages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.od.eds_values import format_value
from canopen_control.rpc.messages.declare import Document
from canopen_control.service.object_selection import has_changed, object_name
from canopen_control.service.object_units import unit_of
from canopen_control.service.object_values import printable
from canopen_control.trace.network_description import NodeDescription
from canopen_control.trace.values import NodeWords

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.od.model import Entry, ObjectDictionary, Value

__all__ = ["READS_PER_S", "LiveObject", "ObjectRow", "rows_of"]

READS_PER_S: Final = 60.0
"""How often a running robot is asked for an object at most: its own requests to the node never wait behind them."""


@dataclass(frozen=True, slots=True)
class LiveObject:
    """An entry with what it holds: `value`, or why there is none in `why`; neither where it was not read."""

    entry: Entry
    value: Value | None = None
    why: str = ""

    @property
    def changed(self) -> bool:
        """Whether it holds something else than the EDS's default."""
        return self.value is not None and has_changed(self.entry, self.value)


class ObjectRow(Document, frozen=True, kw_only=True):
    """An object as `objects --json` prints it; texts of values, null where there is none or it was not read."""

    index: str
    subindex: int
    name: str
    type: str
    access: str
    mappable: str
    unit: str
    default: str | None
    value: str | None
    meaning: str | None
    changed: bool
    error: str | None


def _row(od: ObjectDictionary, live: LiveObject, words: NodeWords) -> ObjectRow:
    """Return an object with its value in words."""
    entry, value = live.entry, live.value
    unit = unit_of(od, entry.index, entry.subindex)
    return ObjectRow(
        index=f"0x{entry.index:04X}",
        subindex=entry.subindex,
        name=object_name(od, entry),
        type=entry.data_type.name,
        access=entry.access,
        mappable=("R" if entry.rpdo_mappable else "") + ("T" if entry.tpdo_mappable else ""),
        unit=unit,
        default=None if entry.default is None else _text(entry, entry.default, unit),
        value=None if value is None else _text(entry, value, unit),
        meaning=None if value is None else _meaning(entry, value, words),
        changed=live.changed,
        error=live.why or None,
    )


def rows_of(od: ObjectDictionary, objects: Iterable[LiveObject], node_id: int) -> list[ObjectRow]:
    """Return the rows of many objects of a node."""
    words = NodeWords(NodeDescription("", node_id, od))
    return [_row(od, each, words) for each in objects]


def _text(entry: Entry, value: Value, unit: str) -> str:
    """Return a value on one line: what has a unit in decimal, other wide numbers in hexadecimal."""
    return str(value) if unit and isinstance(value, int) else printable(format_value(value, entry.data_type))


def _meaning(entry: Entry, value: Value, words: NodeWords) -> str | None:
    """Return what a number means beside its digits; None where it means no more."""
    if not isinstance(value, int):
        return None
    text = words.text(entry.index, entry.subindex, value)
    plain = (
        str(value),
        format_value(value, entry.data_type),
        f"0x{value & 0xFFFFFFFF:08X}",
        f"{value} ms",
        f"{value} us",
    )
    if text in plain:
        return None
    head, _, rest = text.partition(" ")
    if rest.startswith("(") and rest.endswith(")"):
        return rest[1:-1]
    return rest if head.startswith("0x") or head == str(value) else text
