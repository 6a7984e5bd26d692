"""Client of a virtual drive or device: state, faults and inputs, without the CAN bus.

This module is separate from the client of a robot, so that commands for a robot need not import the messages of drives.
"""

from __future__ import annotations

import contextlib
import math
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError, RemoteError
from canopen_control.host.lineclient import LineClient
from canopen_control.host.sockets import drive_name, list_sockets, socket_path
from canopen_control.rpc.client import Client
from canopen_control.rpc.messages.drive import DRIVE, DriveEvent, DriveHello, GetWorldShapes

if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Self

    from canopen_control.rpc.messages.drive import WorldShape


_SHAPES_S: Final = 1.0


class DriveClient(Client[DriveHello, DriveEvent]):
    """Connection to a virtual drive; the requests are in `rpc.messages.drive`."""

    @classmethod
    def connect(cls, channel: str, node_id: int, timeout: float = 10.0, *, label: str = "") -> Self:
        """Connect to a virtual node on a bus; raise RemoteError if it is not running. `label` names it in messages."""
        label = label or f"the virtual drive {node_id} on {channel}"
        stream = LineClient(socket_path("drive", drive_name(channel, node_id)), timeout, label=label)
        return cls(DRIVE, stream, timeout)


def shapes_of_world(nodes: Iterable[tuple[str, int]]) -> tuple[WorldShape, ...]:
    """Return the shapes of the world from the first of `nodes` (channel, node-ID) that reports any, or ().

    Blocks for at most a second per drive.
    """
    alive = set(list_sockets("drive"))
    for channel, node_id in nodes:
        if drive_name(channel, node_id) not in alive:
            continue
        with contextlib.suppress(RemoteError), DriveClient.connect(channel, node_id, _SHAPES_S) as client:
            if shapes := client.ask(GetWorldShapes()):
                return shapes
    return ()


def signal_values(text: str) -> dict[str, float]:
    """Parse ``di0=1,ai0=2.5`` into values by signal; raise ConfigError if a part does not have this form."""
    values = {}
    for field in text.split(","):
        name, _, number = (part.strip() for part in field.partition("="))
        try:
            values[name] = float(number)
        except ValueError:
            values[name] = math.nan
        if not name or not math.isfinite(values[name]):
            raise ConfigError(f"{field!r}: write SIGNAL=NUMBER, as in di0=1,ai0=16384")
    return values
