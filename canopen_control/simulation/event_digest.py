"""The SHA-256 of every frame and event of a simulation with its time: two runs with the same one are the same."""

from __future__ import annotations

import hashlib
import struct
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from canopen_control.master.event_log import Event

__all__ = ["EventDigest"]

_HEAD: Final = struct.Struct("<q")
_ENOUGH: Final = 1 << 16


class EventDigest:
    """Takes frames and events in their order; `events` counts the latter."""

    def __init__(self) -> None:
        self.events = 0
        self._sha256 = hashlib.sha256()
        self._waiting = bytearray()
        self._pack = _HEAD.pack

    def frame(self, now: int, label: str, record: bytes) -> None:
        """Take a frame that has passed."""
        waiting = self._waiting
        waiting += self._pack(now)
        waiting += record
        waiting += label.encode()
        if len(waiting) > _ENOUGH:
            self._sha256.update(waiting)
            waiting.clear()

    def event(self, event: Event) -> None:
        """Take an event of the robot."""
        self.events += 1
        self._waiting += self._pack(event.time)
        self._waiting += f"{event.kind}\0{event.node}\0{event.sentence}\0".encode()

    @property
    def hex(self) -> str:
        """The digest so far."""
        self._sha256.update(self._waiting)
        self._waiting.clear()
        return self._sha256.hexdigest()
