"""Objects of a node as tables, trees and CSV, with values and meanings.

Values are read one by one; through a running robot no faster than `READS_PER_S`, so that the robot's own SDO requests
are not delayed. Heartbeats and process data are independent of SDO.
"""

from __future__ import annotations

import csv
import io
import time
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.output import Progress, Table
from canopen_control.commissioning.object_rows import READS_PER_S, LiveObject, ObjectRow, is_scanned
from canopen_control.commissioning.parameter_set import read_values
from canopen_control.od.model import SCALAR_CODES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.od.model import Address, Entry, ObjectDictionary, Value


_WIDEST: Final = 60  # maximum width of a value, in columns


def live_objects(session: NodeSession, entries: Sequence[Entry], *, title: str = "reading") -> list[LiveObject]:
    """Return the entries with the values read from the node; raise RemoteProtocolError if it does not respond."""
    read = [entry for entry in entries if is_scanned(entry)]
    with Progress(f"{title} {session}", "objects") as progress:
        values, refused = read_values(session, _paced(read, session, progress))
    why = {unread.entry.address: unread.why for unread in refused}
    return [LiveObject(entry, values.get(entry.address), why.get(entry.address, "")) for entry in entries]


def _paced(entries: Sequence[Entry], session: NodeSession, progress: Progress) -> Iterator[Entry]:
    """Yield entries, at a limited rate if a running robot reads them, and show the progress."""
    gap = 1.0 / READS_PER_S if session.robot else 0.0
    next_read = time.monotonic()
    for number, entry in enumerate(entries):
        if (wait := next_read - time.monotonic()) > 0:
            time.sleep(wait)
        next_read = time.monotonic() + gap
        progress.at(number, len(entries))
        yield entry


def table_lines(rows: Sequence[ObjectRow], *, live: bool) -> list[str]:
    """Return the lines of a table; `live` adds values, with `*` before each non-default value."""
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
    """Yield the objects, each followed by its subindices on indented lines."""
    last = ""
    for row in rows:
        info = od.objects.get(int(row.index, 16))
        single = info is None or info.code in SCALAR_CODES
        if not single and row.index != last:
            yield f"{row.index} {info.name if info is not None else ''}"
        last = row.index
        name = row.name.rpartition(": ")[2] if not single else row.name
        place = row.index if single else f"  :{row.subindex:02X}"
        yield f"{place} {name}{_suffix(row, live=live)}"


def _suffix(row: ObjectRow, *, live: bool) -> str:
    """Return the text after a name in the tree: value, unit, meaning, default, type and access."""
    shown = row.value if live else row.default
    unit = f" {row.unit}" if row.unit and shown else ""
    value = f" = {_cut(shown)}{unit}" if shown is not None else ""
    meaning = f" ({row.meaning})" if live and row.meaning else f" ({row.error})" if live and row.error else ""
    default = f", by default {row.default}" if row.changed else ""
    return f"{value}{meaning}{default}  [{row.type} {row.access}]"


def _cut(text: str) -> str:
    return text if len(text) <= _WIDEST else f"{text[: _WIDEST - 3]}..."


def csv_text(rows: Sequence[ObjectRow]) -> str:
    """Return the rows as CSV (RFC 4180, with LF), after a line of headings."""
    out = io.StringIO()
    names = ObjectRow.__struct_fields__
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow(["" if (value := getattr(row, name)) is None else value for name in names])
    return out.getvalue()


def values_of(objects: Iterable[LiveObject]) -> Mapping[Address, Value]:
    """Return the values of the writable objects by address, for the ParameterValues of a DCF."""
    return {entry.entry.address: entry.value for entry in objects if entry.value is not None and entry.entry.writable}
