"""PEAK's trace format, read line by line in its versions 1.0 to 2.1; python-can's writer makes 2.1.

A line is a table row: the version, or the file's own ``$COLUMNS``, says which column is what. Rows of errors become
error frames in the layout of linux/can/error.h: PEAK gives the kind of error, direction, place (as an SJA1000 codes
it), receive and transmit counter; changes of the status as bits of PCAN-Basic; or the two counters alone.
"""

from __future__ import annotations

import datetime
import math
import re
from typing import TYPE_CHECKING, Final

from canopen_control.bus.error_frames import (
    ACTIVE_AGAIN,
    BUS_ERROR,
    BUS_OFF,
    CONTROLLER,
    COUNTERS,
    PASSIVE,
    PROTOCOL,
    RX_OVERFLOW,
    RX_WARNING,
    TX_WARNING,
)
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, CanFrame

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import TextIO

__all__ = ["read_trc"]

_COLUMNS: Final = {  # N number, O offset in ms, T type, B bus, I identifier, d direction, R reserved, L length, D data
    "1.0": "NOILD",
    "1.1": "NOTILD",
    "1.2": "NOBTILD",
    "1.3": "NOBTIRLD",
    "2.0": "NOTIdlD",
    "2.1": "NOTBIdRLD",
}
_DAY_ZERO: Final = datetime.datetime(1899, 12, 30, tzinfo=datetime.UTC)
_DATA_TYPES: Final = {"Rx", "Tx", "DT", "RR"}
_REMOTE_TYPE: Final = "RR"
_LONGEST_STANDARD: Final = 4  # digits of an identifier
_BYTE: Final = re.compile(r"[0-9A-Fa-f]{2}")
_NS_PER_US: Final = 1000

# Rows of errors
_ERROR_TYPES: Final = {"Error", "ER"}
_STATUS_TYPES: Final = {"Warng", "ST"}
_COUNTER_TYPE: Final = "EC"
_STATUS_ID: Final = "FFFFFFFF"  # of version 1.0, which has no types
_VIOLATION: Final = {1: 0x01, 2: 0x02, 4: 0x04}  # bit, form and stuff error: PEAK's and data[2] of an error frame
_SENDING: Final = 0x80
_STATUS: Final = (  # a bit of PCAN-Basic, class, detail of the controller
    (0x00010, BUS_OFF, 0),
    (0x40000, CONTROLLER, PASSIVE),
    (0x00008, CONTROLLER, RX_WARNING | TX_WARNING),
    (0x00004, CONTROLLER, RX_WARNING | TX_WARNING),
    (0x00002, CONTROLLER, RX_OVERFLOW),
)


def read_trc(file: TextIO) -> Iterator[tuple[int, CanFrame] | None]:
    """Yield time in Unix ns and frame of each row, None for one that is no frame of classic CAN.

    EOFError for a last row that is cut. Without a start time the times count from 0.
    """
    columns, start = _COLUMNS["1.0"], 0.0
    for line in file:
        text = line.strip()
        if text.startswith(";"):
            name, _, value = text.partition("=")
            if name == ";$FILEVERSION":
                columns = _COLUMNS.get(value.strip(), columns)
            elif name == ";$COLUMNS":
                columns = value.replace(",", "").strip()
            elif name == ";$STARTTIME":
                start = _start(value)
        elif text:
            found = _parsed(text, columns)
            if found is None and not line.endswith("\n"):
                raise EOFError
            yield None if found is None else (round((start + found[0] / 1000) * 1e6) * _NS_PER_US, found[1])


def _start(days: str) -> float:
    """Return the start in Unix seconds, 0 where it is none."""
    try:
        return (_DAY_ZERO + datetime.timedelta(days=float(days))).timestamp()
    except (ValueError, OverflowError):
        return 0.0


def _parsed(text: str, columns: str) -> tuple[float, CanFrame] | None:
    """Return the offset in ms and the frame of a row."""
    words = text.split()
    try:
        offset = float(words[columns.index("O")])
        kind = words[columns.index("T")] if "T" in columns else _kind_of(words, columns)
        if kind in _DATA_TYPES:
            frame = _data_frame(dict(zip(columns, text.split(maxsplit=len(columns) - 1), strict=False)), kind)
        else:
            frame = _report(kind, words, columns)
    except (ValueError, IndexError, KeyError):
        return None
    return None if frame is None or not math.isfinite(offset) else (offset, frame)


def _kind_of(words: list[str], columns: str) -> str:
    """Return the type of a row of version 1.0, in the words of 1.1."""
    if words[columns.index("I")] == _STATUS_ID:
        return "Warng"
    return "Error" if "ERROR" in words else "Rx"


def _data_frame(row: dict[str, str], kind: str) -> CanFrame | None:
    """Return the frame of a row; ValueError, IndexError or KeyError where it is none."""
    identifier = row["I"]
    can_id = int(identifier, 16) | (EXTENDED_FLAG if len(identifier) > _LONGEST_STANDARD else 0)
    length = int(row["L"] if "L" in row else row["l"])
    words = row.get("D", "").split()
    if can_id & 0x1FFFFFFF > (0x1FFFFFFF if can_id & EXTENDED_FLAG else 0x7FF) or not 0 <= length <= 15:
        return None
    length = min(length, 8)
    if kind == _REMOTE_TYPE or words[:1] == ["RTR"]:
        return CanFrame(can_id | REMOTE_FLAG, bytes(length))
    if len(words) < length:
        raise IndexError
    return CanFrame(can_id, bytes(int(word, 16) for word in words[:length]))


def _report(kind: str, words: list[str], columns: str) -> CanFrame | None:
    """Return the error frame of a row of errors; such rows may lack the columns of identifier and length."""
    direction = next((at for at, word in enumerate(words) if word in ("Rx", "Tx")), columns.find("L"))
    data = bytes(int(word, 16) for word in words[direction + 1 :] if _BYTE.fullmatch(word))
    if kind in _ERROR_TYPES:
        if "d" not in columns:  # up to 1.3 the kind of error is the identifier
            data = bytes((int(words[columns.index("I")], 16) & 0xFF,)) + data
        what, way, place, receive, transmit = data[:5]
        detail = _VIOLATION.get(what, 0) | (0 if way else _SENDING)
        classes = PROTOCOL | BUS_ERROR | COUNTERS
        return CanFrame(ERROR_FLAG | classes, bytes((0, 0, detail, place, 0, 0, transmit, receive)))
    if kind in _STATUS_TYPES and len(data) >= 4:
        status = int.from_bytes(data[:4], "big")
        classes, detail = 0, 0
        for bit, each, more in _STATUS:
            if status & bit:
                classes, detail = classes | each, detail | more
        if not status:
            classes, detail = CONTROLLER, ACTIVE_AGAIN
        return CanFrame(ERROR_FLAG | classes, bytes((0, detail, 0, 0, 0, 0, 0, 0))) if classes else None
    if kind == _COUNTER_TYPE:
        receive, transmit = data[:2]
        return CanFrame(ERROR_FLAG | COUNTERS, bytes((0, 0, 0, 0, 0, 0, transmit, receive)))
    return None
