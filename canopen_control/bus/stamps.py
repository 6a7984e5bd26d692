"""When frames came: a port may know it from the kernel, which is nearer to the wire than whoever reads later.

It is for those who write frames down or measure them. The cycle never asks, since each stamp is work for every frame.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from canopen_control.frame import RECORD_SIZE

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.bus.port import Port

__all__ = ["Stamping", "receive_stamped"]


@runtime_checkable
class Stamping(Protocol):
    """A port that knows when its frames came."""

    def receive_stamped(self) -> tuple[bytes, list[int]]:
        """Return what `receive` does, and the time of each record in Unix ns; raise `BusClosed`."""


def receive_stamped(port: Port, clock: Callable[[], int] = time.time_ns) -> tuple[bytes, list[int]]:
    """Return the records that wait and the time of each in Unix ns; where the port knows none, it is `clock`'s now."""
    if isinstance(port, Stamping):
        return port.receive_stamped()
    records = port.receive()
    return records, [clock()] * (len(records) // RECORD_SIZE)
