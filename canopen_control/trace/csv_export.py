"""A recording as a table: a row for each value, or, wide, a row for each frame and a column for each signal.

Values as they are (numbers stay numbers), the words beside them; times in Unix seconds.
"""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from typing import TextIO

    from canopen_control.od.model import Value
    from canopen_control.trace.decoder import DecodedFrame

__all__ = ["COLUMNS", "signal_name", "write_long", "write_wide"]

COLUMNS = ("time", "id", "node", "service", "signal", "value", "text")
_NS = 1_000_000_000


def write_long(frames: Iterable[DecodedFrame], out: TextIO) -> int:
    """Write a row for each value, and one for each frame without values; return the number of rows."""
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    count = 0
    for frame in frames:
        for row in _rows(frame):
            writer.writerow(row)
            count += 1
    return count


def _rows(frame: DecodedFrame) -> Iterator[tuple[str, ...]]:
    head = _time(frame), f"0x{frame.can_id & 0x1FFFFFFF:03X}", frame.who, frame.service
    for value in frame.values:
        yield (*head, value.name, _plain(value.value), value.text)
    if not frame.values:
        yield (*head, frame.subject, frame.data.hex(), frame.text)


def write_wide(frames: Iterable[DecodedFrame], signals: Iterable[str], out: TextIO) -> int:
    """Write a row for each PDO with a column for each of `signals`, empty where the frame has none of it."""
    columns = {name: number for number, name in enumerate(signals, 1)}
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["time", *columns])
    count = 0
    for frame in frames:
        if frame.service != "pdo" or not frame.values:
            continue
        row = [_time(frame)] + [""] * len(columns)
        for value in frame.values:
            if (column := columns.get(signal_name(frame, value.name))) is not None:
                row[column] = _plain(value.value)
        writer.writerow(row)
        count += 1
    return count


def signal_name(frame: DecodedFrame, name: str) -> str:
    """Return the column of a value of `frame`: node and name."""
    return f"{frame.who}.{name}"


def _time(frame: DecodedFrame) -> str:
    seconds, ns = divmod(frame.time, _NS)
    return f"{seconds}.{ns // 1000:06d}"


def _plain(value: Value) -> str:
    return value.hex() if isinstance(value, bytes | bytearray) else str(value)
