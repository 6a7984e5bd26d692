"""Output of decoded frames: a filter, lines for users, documents for scripts, and CSV tables."""

from __future__ import annotations

import csv
import datetime
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, MAX_NODE_ID, REMOTE_FLAG
from canopen_control.rpc.messages.declare import Document
from canopen_control.trace.decoder import SERVICES, Mark

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from typing import TextIO

    from canopen_control.od.model import Value
    from canopen_control.trace.decoder import DecodedFrame
    from canopen_control.trace.network_description import NetworkDescription


# Filters are applied after decoding, because the decoder needs all frames.


# services with periodic frames; all frames of other services count as events
_REPEATED = frozenset(("pdo", "hb", "sync", "time"))
_KNOWN = 4096  # maximum number of identifiers whose last data are stored
_ALIASES = {"heartbeat": "hb", "heartbeats": "hb", "guarding": "hb"}


@dataclass(slots=True)
class Filter:
    """Filter of decoded frames; an empty field passes all frames.

    `changes` omits a periodic frame with the same data as the previous frame with its identifier; `events` also omits
    frames that are not marked as notable, warning or error.
    """

    nodes: frozenset[int] = frozenset()
    services: frozenset[str] = frozenset()
    ids: tuple[range, ...] = ()
    changes: bool = False
    events: bool = False
    _last: dict[int, bytes] = field(default_factory=dict)

    def wants(self, decoded: DecodedFrame) -> bool:
        """Whether the frame passes; with `changes` or `events`, its data is stored for comparison with later frames."""
        if self.nodes and decoded.node_id not in self.nodes:
            return False
        if self.services and decoded.service not in self.services:
            return False
        if self.ids and not any(decoded.can_id & 0x9FFFFFFF in identifiers for identifiers in self.ids):
            return False
        if self.events and decoded.mark is Mark.PLAIN:
            return False
        return not (self.changes or self.events) or self._is_new(decoded)

    def _is_new(self, decoded: DecodedFrame) -> bool:
        if decoded.service not in _REPEATED:
            return True
        if self._last.get(decoded.can_id) == decoded.data:
            return False
        if len(self._last) < _KNOWN or decoded.can_id in self._last:
            self._last[decoded.can_id] = decoded.data
        return True


def parse_services(text: str) -> frozenset[str]:
    """Parse a list of services such as ``pdo,sdo``; raise ValueError with the valid services if one is unknown."""
    names = {_ALIASES.get(part, part) for part in text.lower().replace(" ", "").split(",") if part}
    if unknown := sorted(names - set(SERVICES)):
        raise ValueError(f"unknown service {unknown[0]!r}; services: {', '.join(SERVICES)}")
    return frozenset(names)


def parse_ids(text: str) -> range:
    """Parse a hexadecimal identifier or range, such as ``181``, ``0x181`` or ``180-1FF``.

    Raise ValueError if the text is invalid.
    """
    first, _, last = text.partition("-")
    low, high = _identifier(first), _identifier(last or first)
    if high < low:
        raise ValueError(f"{text!r}: the last identifier is below the first")
    return range(low, high + 1)


def _identifier(text: str) -> int:
    try:
        value = int(text, 16)
    except ValueError:
        raise ValueError(f"{text!r}: an identifier is hexadecimal, as in 181 or 0x181") from None
    if not 0 <= value <= 0x1FFFFFFF:
        raise ValueError(f"{text!r}: identifiers are 0 to 1FFFFFFF")
    return value | EXTENDED_FLAG if value > 0x7FF or len(text.lower().removeprefix("0x")) > 3 else value


def node_ids_of(network: NetworkDescription, names: Iterable[str]) -> frozenset[int]:
    """Return the node-IDs of names or numbers, including "master"; else raise ConfigError with the valid names."""
    node_ids = set()
    for name in names:
        by_name = next((node.node_id for node in network.nodes.values() if node.name == name), None)
        if by_name is None and name == "master":
            by_name = network.master_node_id
        node_ids.add(_node_id(network, name) if by_name is None else by_name)
    return frozenset(node_ids)


def _node_id(network: NetworkDescription, text: str) -> int:
    try:
        node_id = int(text, 0)
    except ValueError:
        node_id = 0
    if not 1 <= node_id <= MAX_NODE_ID:
        names = ", ".join(node.name for node in network.nodes.values() if node.name) or "none with a name"
        raise ConfigError(f"no node {text!r}; give a node-ID, 1 to 127, or a name: {names}")
    return node_id


# CSV tables of a recording: a row per value, or, in the wide form, a row per frame with a column per signal. Numbers
# remain numbers, with their text in another column; times are Unix s.


COLUMNS = ("time", "id", "node", "service", "signal", "value", "text")
_NS = 1_000_000_000


def write_long(frames: Iterable[DecodedFrame], out: TextIO) -> int:
    """Write one CSV row per value, or one per frame without values; return the number of rows."""
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    count = 0
    for frame in frames:
        for row in _rows(frame):
            writer.writerow(row)
            count += 1
    return count


def _rows(frame: DecodedFrame) -> Iterator[tuple[str, ...]]:
    head = _time(frame), f"0x{frame.can_id & 0x1FFFFFFF:03X}", frame.node_label, frame.service
    for value in frame.values:
        yield (*head, value.name, _plain_value(value.value), value.text)
    if not frame.values:
        yield (*head, frame.subject, frame.data.hex(), frame.text)


def write_wide(frames: Iterable[DecodedFrame], signals: Iterable[str], out: TextIO) -> int:
    """Write one CSV row per PDO with a column for each of `signals`; a cell is empty if the frame lacks the signal.

    Return the number of rows.
    """
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
                row[column] = _plain_value(value.value)
        writer.writerow(row)
        count += 1
    return count


def signal_name(frame: DecodedFrame, name: str) -> str:
    """Return the column name "NODE.NAME" of a value in a frame."""
    return f"{frame.node_label}.{name}"


def _time(frame: DecodedFrame) -> str:
    seconds, ns = divmod(frame.time, _NS)
    return f"{seconds}.{ns // 1000:06d}"


def _plain_value(value: Value) -> str:
    return value.hex() if isinstance(value, bytes | bytearray) else str(value)


_COLOURS = {Mark.ERROR: "\x1b[31m", Mark.WARNING: "\x1b[33m", Mark.NOTABLE: "\x1b[36m"}
_RESET = "\x1b[0m"
_DATA_WIDTH = 23  # eight bytes in hex
_SUBJECT_WIDTH = 12  # SDO response
_SHORTEST_NODE = 8


class LineWriter:
    """Formatter for the lines of a trace; times are relative to the first frame, or local times if `absolute`."""

    def __init__(self, network: NetworkDescription, *, absolute: bool = False, colour: bool = False) -> None:
        self._absolute, self._colour = absolute, colour
        names = [node.name for node in network.nodes.values()]
        self._node_width = max((len(name) for name in names), default=0)
        self._node_width = max(self._node_width, _SHORTEST_NODE)
        self._start: int | None = None

    def line(self, decoded: DecodedFrame) -> str:
        """Return the line of a frame, without a newline."""
        text = (
            f"{self._time(decoded.time)}  {identifier_text(decoded.can_id):>3}  {_data(decoded):<{_DATA_WIDTH}}  "
            f"{decoded.node_label:<{self._node_width}}  {decoded.subject:<{_SUBJECT_WIDTH}}  {decoded.text}"
        ).rstrip()
        colour = _COLOURS.get(decoded.mark) if self._colour else None
        return f"{colour}{text}{_RESET}" if colour else text

    def _time(self, time: int) -> str:
        if self._absolute:
            seconds, ns = divmod(time, _NS)
            moment = datetime.datetime.fromtimestamp(seconds)  # noqa: DTZ006 - the reader's own clock
            return f"{moment:%Y-%m-%d %H:%M:%S}.{ns // 1000:06d}"
        if self._start is None:
            self._start = time
        return f"{(time - self._start) / _NS:12.6f}"


def identifier_text(can_id: int) -> str:
    """Return an identifier as three or eight hexadecimal digits; for an error frame, return the error classes."""
    width = 8 if can_id & (EXTENDED_FLAG | ERROR_FLAG) else 3
    return f"{can_id & 0x1FFFFFFF:0{width}X}"


def _data(decoded: DecodedFrame) -> str:
    if decoded.can_id & REMOTE_FLAG:
        return f"remote, {len(decoded.data)} bytes" if decoded.data else "remote"
    return decoded.data.hex(" ").upper()


class ValueDocument(Document, frozen=True):
    """Value of an object in a frame; bytes are hexadecimal text, numbers that JSON cannot represent are None."""

    index: int
    subindex: int
    name: str
    value: int | float | str | None
    text: str


class FrameDocument(Document, frozen=True, kw_only=True):
    """Frame in `trace --json`; `time` is in Unix seconds, `id` and `data` are in hexadecimal."""

    time: float
    id: str
    extended: bool
    remote: bool
    data: str
    service: str
    subject: str
    node_id: int | None
    node: str | None
    text: str
    mark: str
    values: list[ValueDocument]


def document_of(decoded: DecodedFrame) -> FrameDocument:
    """Convert a decoded frame to a document."""
    return FrameDocument(
        time=decoded.time / _NS,
        id=identifier_text(decoded.can_id),
        extended=bool(decoded.can_id & EXTENDED_FLAG),
        remote=bool(decoded.can_id & REMOTE_FLAG),
        data=decoded.data.hex(),
        service=decoded.service,
        subject=decoded.subject,
        node_id=decoded.node_id,
        node=decoded.node or None,
        text=decoded.text,
        mark=decoded.mark.name.lower(),
        values=[
            ValueDocument(value.index, value.subindex, value.name, _plain(value.value), value.text)
            for value in decoded.values
        ],
    )


def _plain(value: Value) -> int | float | str | None:
    """Return a value that JSON can represent: bytes in hexadecimal, None for nan and infinity."""
    if isinstance(value, bytes | bytearray):
        return value.hex()
    return None if isinstance(value, float) and not math.isfinite(value) else value
