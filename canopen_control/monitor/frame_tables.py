"""Frames of a bus in the monitor: one row for each identifier, and the latest frames that pass a filter.

Memory is bounded. A filter is a line of words separated by commas: a service (`pdo`, `sdo`, ...), a node (name or
number), an identifier or a range of identifiers (`0x181`, `0x180-0x1FF`), or `changes`. Words of the same kind are
alternatives, words of different kinds must all match; an empty filter passes all frames.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.bus.port import BusEventKind
from canopen_control.bus.port_abilities import Arrivals
from canopen_control.errors import BusError, ConfigError
from canopen_control.frame import FRAME_BITS, frames_of
from canopen_control.trace.decoder import SERVICES, Decoder
from canopen_control.trace.frame_lines import Filter, node_ids_of, parse_ids
from canopen_control.trace.listen import open_listener

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.bus.port import Port
    from canopen_control.frame import CanFrame
    from canopen_control.trace.decoder import DecodedFrame
    from canopen_control.trace.network_description import NetworkDescription


KEPT: Final = 2000  # decoded frames that a changed filter can still show
_IDENTIFIERS: Final = 4096  # more identifiers on one bus are a fault of the bus
_SMOOTHING: Final = 0.2
_SECOND_NS: Final = 1_000_000_000
_CHANGES: Final = "changes"


def parse_filter(text: str, network: NetworkDescription) -> Filter:
    """Parse the text of a filter; raise ConfigError with the valid words if it is invalid."""
    services, nodes, ids = set[str](), list[str](), list[range]()
    words = [word.strip() for word in text.split(",") if word.strip()]
    for word in words:
        if word.lower() in SERVICES:
            services.add(word.lower())
        elif word.lower().startswith("0x"):
            ids.append(_identifiers(word))
        elif word != _CHANGES:
            nodes.append(word)
    return Filter(_nodes(network, nodes), frozenset(services), tuple(ids), _CHANGES in words)


def _identifiers(word: str) -> range:
    try:
        return parse_ids(word)
    except ValueError as error:
        raise ConfigError(str(error)) from None


def _nodes(network: NetworkDescription, words: list[str]) -> frozenset[int]:
    try:
        return node_ids_of(network, words)
    except ConfigError as error:
        services = ", ".join(SERVICES)
        raise ConfigError(f"{error}; or a service: {services}; an identifier as 0x181; {_CHANGES}") from None


@dataclass(slots=True)
class _Row:
    """Row of one identifier; `period_ns` is the smoothed interval between frames, None after the first frame."""

    count: int
    last: DecodedFrame
    period_ns: float | None = None


@dataclass(slots=True)
class FrameTable:
    """Table of the identifiers on a bus, with the count, the period and the last frame of each."""

    rows: dict[int, _Row] = field(default_factory=dict)

    def add(self, decoded: DecodedFrame) -> None:
        """Count a frame; a new identifier is ignored if the table is full."""
        row = self.rows.get(decoded.can_id)
        if row is None:
            if len(self.rows) < _IDENTIFIERS:
                self.rows[decoded.can_id] = _Row(1, decoded)
            return
        gap = float(decoded.time - row.last.time)
        row.period_ns = gap if row.period_ns is None else row.period_ns + _SMOOTHING * (gap - row.period_ns)
        row.count += 1
        row.last = decoded


class TraceLog:
    """Latest frames, with a filter; `KEPT` frames are stored, so that a new filter also applies to earlier frames."""

    def __init__(self) -> None:
        self.filter = Filter()
        self._all: deque[DecodedFrame] = deque(maxlen=KEPT)
        self._fresh: deque[DecodedFrame] = deque(maxlen=KEPT)

    def add(self, decoded: DecodedFrame) -> None:
        """Store a frame; `fresh` returns it if it passes the filter."""
        self._all.append(decoded)
        if self.filter.wants(decoded):
            self._fresh.append(decoded)

    def choose(self, chosen: Filter) -> None:
        """Change the filter; the next `fresh` returns all stored frames that pass the new filter."""
        self.filter = chosen
        self._fresh = deque((frame for frame in self._all if chosen.wants(frame)), maxlen=KEPT)

    def fresh(self) -> list[DecodedFrame]:
        """Return the frames since the last call that pass the filter."""
        frames = list(self._fresh)
        self._fresh.clear()
        return frames


class LoadMeter:
    """Meter of the bus load, averaged over about a second, without stuff bits; times are in ns."""

    def __init__(self, bitrate: int) -> None:
        self.bitrate = bitrate
        self.load: float | None = None
        self._bits = 0
        self._since: int | None = None

    def add(self, frame: CanFrame) -> None:
        self._bits += FRAME_BITS + 8 * len(frame.data)

    def tick(self, now: int) -> None:
        """Update the load once a second."""
        if self._since is None:
            self._since, self._bits = now, 0
        elif now - self._since >= _SECOND_NS:
            self.load = self._bits * _SECOND_NS / (now - self._since) / self.bitrate
            self._since, self._bits = now, 0


# Listener on one bus, which decodes frames as they arrive and sends nothing.
#
# A lost bus (its robot has ended, the interface is down) is opened again; one attempt per second.


LABEL: Final = "monitor"
_RETRY_NS: Final = 1_000_000_000


class PortWatcher(Protocol):
    """Observer of the port of a `BusTap`; it calls the tap's `receive` when frames arrive at the port."""

    def port_changed(self, port: Port | None) -> None:
        """Read from `port` from now on; None means that the previous port was lost."""
        ...


class BusTap:
    """Listener that decodes the frames of a bus and passes them to `on_frame`.

    `problem` is the reason why no frames arrive, or "". `owner` is the robot that runs on the bus, or "".
    """

    def __init__(
        self, network: NetworkDescription, on_frame: Callable[[DecodedFrame], None], *, owner: str = ""
    ) -> None:
        self.network, self.owner = network, owner
        self.meter = LoadMeter(network.bitrate)
        self.problem = "not opened yet"
        self._watcher: PortWatcher | None = None
        self._on_frame = on_frame
        self._decoder = Decoder(network)
        self._port: Port | None = None
        self._arrivals: Arrivals | None = None
        self._retry_ns = 0

    @property
    def lost(self) -> int:
        """Number of frames lost because reading was too slow."""
        return 0 if self._port is None else self._port.stats.lost

    def watch(self, watcher: PortWatcher) -> None:
        """Register the observer of the port; it is called whenever the port is opened or lost."""
        self._watcher = watcher
        if self._port is not None:
            watcher.port_changed(self._port)

    def tick(self, now: int) -> None:
        """Update the load and, once a second, try to open the bus if it is not open; `now` is in monotonic ns."""
        self.meter.tick(now)
        if self._port is not None or now < self._retry_ns:
            return
        self._retry_ns = now + _RETRY_NS
        try:
            self._port = open_listener(self.network.channel, LABEL, owner=self.owner)
            self._arrivals = Arrivals(self._port)
        except (BusError, ConfigError) as error:
            self.problem = str(error)
            return
        self.problem = ""
        if self._watcher is not None:
            self._watcher.port_changed(self._port)

    def receive(self) -> None:
        """Decode all received frames."""
        arrivals = self._arrivals
        if arrivals is None:
            return
        try:
            records, stamps = arrivals.receive()
            for event in arrivals.port.events():
                if event.kind in (BusEventKind.DOWN, BusEventKind.UP):
                    self.problem = event.text if event.kind is BusEventKind.DOWN else ""
        except BusError as error:
            self.problem = str(error)
            self.close()
            return
        for stamp, frame in zip(stamps, frames_of(records), strict=True):
            self.meter.add(frame)
            self._on_frame(self._decoder.decode(frame, stamp + arrivals.unix_offset_ns))

    def close(self) -> None:
        """Close the bus; a second call does nothing."""
        if self._port is not None:
            if self._watcher is not None:
                self._watcher.port_changed(None)
            self._port.close()
            self._port = self._arrivals = None
