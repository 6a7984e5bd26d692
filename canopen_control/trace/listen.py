"""Listening on a bus: frames and when they came, and nothing is ever sent.

The law of this file: it opens what several can open at once. On a bus inside another process nobody can listen, and an
adapter with one owner is not taken from it.
"""

from __future__ import annotations

import select
import time
from typing import TYPE_CHECKING, Final

from canopen_control.bus.channel import SERVED, ChannelKind, open_port, parse_channel
from canopen_control.bus.port import BusEventKind
from canopen_control.bus.port_abilities import Arrivals, Stamping
from canopen_control.bus.recordings import RecordedFrame
from canopen_control.errors import ConfigError
from canopen_control.frame import frames_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.bus.port import BusEvent, Port


_IDLE_S: Final = 0.25  # how often a silent bus lets the owner look at his clock
_NEWS: Final = frozenset({BusEventKind.DOWN, BusEventKind.UP, BusEventKind.OVERRUN})  # no frame on the bus shows them


def open_listener(channel: str, label: str, *, owner: str = "") -> Port:
    """Open `channel` to listen, with time stamps where it has them.

    BusNotOpen where nobody has it, ConfigError while the robot `owner` has it alone.
    """
    spec = parse_channel(channel)
    if spec.kind.in_process:
        raise ConfigError(f"{channel} is inside one process, nobody else can listen; use local:NAME instead")
    if owner and spec.kind is ChannelKind.PYTHON_CAN and spec.interface not in SERVED:
        raise ConfigError(f"{channel} has one owner, the running robot {owner}; nobody can listen beside it")
    port = open_port(channel, label=label, join=True)
    if isinstance(port, Stamping):
        port.ask_stamps()
    return port


def batches(
    port: Port,
    seconds: float | None = None,
    *,
    clock: Callable[[], float] = time.monotonic,
    on_event: Callable[[BusEvent], object] | None = None,
) -> Iterator[list[RecordedFrame]]:
    """Yield what came since the last time, an empty list four times a second where nothing did.

    Ends after `seconds`, or never; raises `BusClosed` when the bus is gone. `on_event` gets what happens to the channel
    and shows in no frame, after the frames that came before it.
    """
    end = None if seconds is None else clock() + seconds
    arrivals = Arrivals(port)
    offset = arrivals.unix_offset_ns
    while end is None or clock() < end:
        wait = _IDLE_S if end is None else max(0.0, min(_IDLE_S, end - clock()))
        select.select([port.fileno()], [], [], wait)
        records, stamps = arrivals.receive()
        events = port.events()
        yield [RecordedFrame(stamp + offset, frame) for stamp, frame in zip(stamps, frames_of(records), strict=True)]
        for event in events:
            if on_event is not None and event.kind in _NEWS:
                on_event(event)
