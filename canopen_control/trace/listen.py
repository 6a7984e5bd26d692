"""Listening on a bus: frames and when they came, and nothing is ever sent.

The law of this file: it opens what several can open at once. On a bus inside another process nobody can listen, and an
adapter with one owner is not taken from it.
"""

from __future__ import annotations

import select
import time
from typing import TYPE_CHECKING

from canopen_control.bus.channel import ChannelKind, open_port, parse_channel
from canopen_control.bus.port_abilities import receive_stamped
from canopen_control.bus.recordings import RecordedFrame
from canopen_control.errors import ConfigError
from canopen_control.frame import frames_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.bus.port import Port

__all__ = ["batches", "open_listener"]

_IDLE_S = 0.25  # how often a silent bus lets the owner look at his clock


def open_listener(channel: str, label: str, *, owner: str = "") -> Port:
    """Open `channel` to listen; BusNotOpen where nobody has it, ConfigError while the robot `owner` has it alone."""
    kind = parse_channel(channel).kind
    if kind.in_process:
        raise ConfigError(f"{channel} is inside one process, nobody else can listen; use local:NAME instead")
    if owner and kind is ChannelKind.PYTHON_CAN:
        raise ConfigError(f"{channel} has one owner, the running robot {owner}; nobody can listen beside it")
    return open_port(channel, label=label, join=True)


def batches(
    port: Port, seconds: float | None = None, *, clock: Callable[[], float] = time.monotonic
) -> Iterator[list[RecordedFrame]]:
    """Yield what came since the last time, an empty list four times a second where nothing did.

    Ends after `seconds`, or never; raises `BusClosed` when the bus is gone.
    """
    end = None if seconds is None else clock() + seconds
    while end is None or clock() < end:
        wait = _IDLE_S if end is None else max(0.0, min(_IDLE_S, end - clock()))
        select.select([port.fileno()], [], [], wait)
        records, stamps = receive_stamped(port)
        yield [RecordedFrame(stamp, frame) for stamp, frame in zip(stamps, frames_of(records), strict=True)]
