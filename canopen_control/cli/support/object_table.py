"""Objects of a node as tables, trees, CSV and JSON: what the EDS says of them, and what they hold, in words.

The law of this file: values come one by one through the session, and through a running robot no faster than
`READS_PER_S`, so that its own requests to the node never wait behind them; heartbeats and process data go beside SDO.
"""

from __future__ import annotations

import csv
import io
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.object_values import printable
from canopen_control.cli.support.output import Progress, Table
from canopen_control.od.eds_values import format_value
from canopen_control.od.model import SCALAR_CODES
from canopen_control.rpc.messages.declare import Document
from canopen_control.service.object_selection import has_changed, is_scanned, object_name
from canopen_control.service.object_units import unit_of
from canopen_control.service.read_parameters import read_values
from canopen_control.trace.network_description import NodeDescription
from canopen_control.trace.values import NodeWords

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from canopen_control.od.model import Address, Entry, ObjectDictionary, Value
    from canopen_control.service.node_session import NodeSession

__all__ = ["LiveObject", "ObjectRow", "csv_text", "live_objects", "rows_of", "table_lines", "tree_lines", "values_of"]

READS_PER_S: Final = 60.0
_WIDEST: Final = 60  # of a value in words


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


def live_objects(session: NodeSession, entries: Sequence[Entry], *, what: str = "reading") -> list[LiveObject]:
    """Read those of the entries that a look at everything reads; RemoteProtocolError where the node is silent."""
    read = [entry for entry in entries if is_scanned(entry)]
    with Progress(f"{what} {session}", "objects") as progress:
        values, refused = read_values(session, _paced(read, session, progress))
    why = {each.entry.address: each.why for each in refused}
    return [LiveObject(entry, values.get(entry.address), why.get(entry.address, "")) for entry in entries]


def _paced(entries: Sequence[Entry], session: NodeSession, progress: Progress) -> Iterator[Entry]:
    """Yield them no faster than a running robot should be asked; as fast as they are read on a bare bus."""
    gap = 1.0 / READS_PER_S if session.robot else 0.0
    due = time.monotonic()
    for number, entry in enumerate(entries):
        if (wait := due - time.monotonic()) > 0:
            time.sleep(wait)
        due = time.monotonic() + gap
        progress.at(number, len(entries))
        yield entry


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


def table_lines(rows: Sequence[ObjectRow], *, live: bool) -> list[str]:
    """Return a table: `*` before a value that is not the default; the value and its meaning only of a live look."""
    headings = ["address", "name", "type", "access", "PDO", "default"]
    table = Table([*headings, *(["", "value", "unit", "meaning"] if live else ["unit"])])
    for row in rows:
        cells = [
            f"{row.index}:{row.subindex:02X}",
            row.name,
            row.type,
            row.access,
            row.mappable or "-",
            row.default or "-",
        ]
        table.add([*cells, *(_live_cells(row) if live else [row.unit])])
    return table.lines()


def _live_cells(row: ObjectRow) -> list[str]:
    return [
        "*" if row.changed else "",
        _cut(row.value or "-"),
        row.unit if row.value else "",
        f"({text})" if (text := row.meaning or row.error) else "",
    ]


def tree_lines(od: ObjectDictionary, rows: Sequence[ObjectRow], *, live: bool) -> Iterator[str]:
    """Yield the objects with their subindices below them."""
    last = ""
    for row in rows:
        info = od.objects.get(int(row.index, 16))
        single = info is None or info.code in SCALAR_CODES
        if not single and row.index != last:
            yield f"{row.index} {info.name if info is not None else ''}"
        last = row.index
        name = row.name.rpartition(": ")[2] if not single else row.name
        place = row.index if single else f"  :{row.subindex:02X}"
        yield f"{place} {name}{_told(row, live=live)}"


def _told(row: ObjectRow, *, live: bool) -> str:
    """Return what stands behind a name in a tree."""
    shown = row.value if live else row.default
    unit = f" {row.unit}" if row.unit and shown else ""
    value = f" = {_cut(shown)}{unit}" if shown is not None else ""
    meaning = f" ({row.meaning})" if live and row.meaning else f" ({row.error})" if live and row.error else ""
    default = f", by default {row.default}" if row.changed else ""
    return f"{value}{meaning}{default}  [{row.type} {row.access}]"


def _cut(text: str) -> str:
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 3]}..."


def csv_text(rows: Sequence[ObjectRow]) -> str:
    """Return CSV (RFC 4180, with LF) with a line of headings."""
    out = io.StringIO()
    names = ObjectRow.__struct_fields__
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow(["" if (value := getattr(row, name)) is None else value for name in names])
    return out.getvalue()


def values_of(objects: Iterable[LiveObject]) -> Mapping[Address, Value]:
    """Return the values that can be written back, by address: what a DCF has ParameterValues for."""
    return {each.entry.address: each.value for each in objects if each.value is not None and each.entry.writable}
