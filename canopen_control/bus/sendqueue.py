"""Frames that the kernel did not take yet: bounded, the oldest dropped first, and a half-sent one never cut."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.frame import RECORD_SIZE

if TYPE_CHECKING:
    from canopen_control.bus.port import Records

__all__ = ["SEND_LIMIT", "SendQueue"]

SEND_LIMIT = 4096
"""Frames that may wait: most of a second at 1 Mbit/s; what is older would only confuse."""


class SendQueue:
    """What waits to be sent; `data` begins with the rest of a half-sent record, if there is one."""

    __slots__ = ("data", "limit")

    def __init__(self, limit: int = SEND_LIMIT) -> None:
        self.data = bytearray()
        self.limit = limit

    def __len__(self) -> int:
        """Frames that wait, a half-sent one included."""
        return (len(self.data) + RECORD_SIZE - 1) // RECORD_SIZE

    def put(self, records: Records) -> int:
        """Append the rest of some records (only the first may be half sent); return how many were dropped for it."""
        self.data += records
        excess = len(self) - self.limit
        if excess <= 0:
            return 0
        half_sent = len(self.data) % RECORD_SIZE
        del self.data[half_sent : half_sent + excess * RECORD_SIZE]
        return excess

    def taken(self, size: int) -> None:
        """Forget the first `size` bytes: the kernel has them."""
        del self.data[:size]

    def clear(self) -> int:
        """Forget everything; return how many frames that were."""
        count = len(self)
        self.data.clear()
        return count
