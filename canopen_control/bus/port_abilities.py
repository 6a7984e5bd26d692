"""What some ports can do beside `Port`: filter identifiers in the kernel, and time-stamp what they receive.

Both are asked for by a function that serves every port: one that cannot filter gives everything, and its owner ignores
what is not his; one that has no stamps gets the time of reading. A file of its own, since mypyc, which compiles
`port`, makes no protocols that can be asked for at run time.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from canopen_control.frame import RECORD_SIZE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.bus.port import Port

__all__ = ["Filtering", "Stamping", "receive_stamped", "set_filter"]


@runtime_checkable
class Filtering(Protocol):
    """A port that can leave frames out, so that its owner is not woken for them; error frames come always."""

    def set_filter(self, can_ids: Iterable[int]) -> None:
        """Give these identifiers only, with the flags of linux/can.h; a later call replaces an earlier one."""


def set_filter(port: Port, can_ids: Iterable[int]) -> None:
    """Tell a port which identifiers its owner wants; nothing happens where it cannot filter."""
    if isinstance(port, Filtering):
        port.set_filter(can_ids)


@runtime_checkable
class Stamping(Protocol):
    """A port that knows from the kernel when its frames came. The cycle never asks: each stamp is work per frame."""

    def receive_stamped(self) -> tuple[bytes, list[int]]:
        """Return what `receive` does, and the time of each record in Unix ns; raise `BusClosed`."""


def receive_stamped(port: Port, clock: Callable[[], int] = time.time_ns) -> tuple[bytes, list[int]]:
    """Return the records that wait and the time of each in Unix ns; where the port knows none, it is `clock`'s now."""
    if isinstance(port, Stamping):
        return port.receive_stamped()
    records = port.receive()
    return records, [clock()] * (len(records) // RECORD_SIZE)
