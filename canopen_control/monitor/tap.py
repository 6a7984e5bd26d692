"""A listener on one bus: frames in words as they come. Nothing is ever sent.

A bus that goes (its robot has ended, the interface is down) is opened again, once a second.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.bus.port import BusEventKind
from canopen_control.bus.port_abilities import Arrivals
from canopen_control.errors import BusError, ConfigError
from canopen_control.frame import frames_of
from canopen_control.monitor.frame_tables import LoadMeter
from canopen_control.trace.decoder import Decoder
from canopen_control.trace.listen import open_listener

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.bus.port import Port
    from canopen_control.trace.decoder import DecodedFrame
    from canopen_control.trace.network_description import NetworkDescription


LABEL: Final = "monitor"
_AGAIN_NS: Final = 1_000_000_000


class BusTap:
    """Decodes what is on a bus and hands it to `take`; `problem` says why it hears nothing, "" while it does.

    `owner` is the robot that runs on it, or empty.
    """

    def __init__(self, network: NetworkDescription, take: Callable[[DecodedFrame], None], *, owner: str = "") -> None:
        self.network, self.owner = network, owner
        self.meter = LoadMeter(network.bitrate)
        self.problem = "not opened yet"
        self._on_port: Callable[[Port | None], None] = lambda _port: None
        self._take = take
        self._decoder = Decoder(network)
        self._port: Port | None = None
        self._arrivals: Arrivals | None = None
        self._retry_ns = 0

    @property
    def lost(self) -> int:
        """Frames that came faster than they were read."""
        return 0 if self._port is None else self._port.stats.lost

    def watch(self, on_port: Callable[[Port | None], None]) -> None:
        """Call `on_port` now and later with the port to watch for reading, and with None when it goes."""
        self._on_port = on_port
        if self._port is not None:
            on_port(self._port)

    def tick(self, now: int) -> None:
        """Open the bus if it is time to; `now` in monotonic ns."""
        self.meter.tick(now)
        if self._port is not None or now < self._retry_ns:
            return
        self._retry_ns = now + _AGAIN_NS
        try:
            self._port = open_listener(self.network.channel, LABEL, owner=self.owner)
            self._arrivals = Arrivals(self._port)
        except (BusError, ConfigError) as error:
            self.problem = str(error)
            return
        self.problem = ""
        self._on_port(self._port)

    def receive(self) -> None:
        """Take what has come."""
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
            self._take(self._decoder.decode(frame, stamp + arrivals.unix_offset_ns))

    def close(self) -> None:
        """Leave the bus; a second call does nothing."""
        if self._port is not None:
            self._on_port(None)
            self._port.close()
            self._port = self._arrivals = None
