"""Reception of frames with their arrival times on a bus, without sending.

Only channels that several processes can open are used. A bus inside another process is out of reach, and an adapter
that allows only one program is left to that program.
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


_IDLE_S: Final = 0.25  # interval of empty results on a silent bus, so that the caller can check the time
# channel events without a frame on the bus
_NEWS: Final = frozenset({BusEventKind.DOWN, BusEventKind.UP, BusEventKind.OVERRUN})


def open_listener(channel: str, label: str, *, owner: str = "") -> Port:
    """Open `channel` for listening, with time stamps if the channel supports them.

    Raise BusNotOpen if the bus is not open, or ConfigError if no other program can listen, such as when the robot
    `owner` uses the adapter exclusively.
    """
    spec = parse_channel(channel)
    if spec.kind.in_process:
        raise ConfigError(f"{channel} is inside one process, no other program can listen; use local:NAME instead")
    if owner and spec.kind is ChannelKind.PYTHON_CAN and spec.interface not in SERVED:
        raise ConfigError(f"{channel} has one owner, the running robot {owner}; no other program can listen")
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
    """Yield the frames received since the previous batch; on a silent bus, an empty list every 0.25 s.

    End after `seconds` (None: never); raise BusClosed if the bus is lost. `on_event` receives channel events without
    a frame, after the frames received before them.
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
