"""The SHA-256 of every frame and event of a simulation with its time: two runs with the same one are the same.

Where the robot's files are, which the notes on them say, is no part of it.
"""

from __future__ import annotations

import hashlib
import struct
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.master.event_log import Event

__all__ = ["EventDigest"]

_HEAD: Final = struct.Struct("<q")
_ENOUGH: Final = 1 << 16


class EventDigest:
    """Takes frames and events in their order; `events` counts the latter, `folders` are those of the robot's files."""

    def __init__(self, folders: Iterable[str] = ()) -> None:
        self.events = 0
        self._folders = sorted({f"{folder}/" for folder in folders}, key=len, reverse=True)
        self._labels: dict[str, bytes] = {}
        self._sha256 = hashlib.sha256()
        self._waiting = bytearray()
        self._pack = _HEAD.pack

    def frame(self, now: int, label: str, record: bytes) -> None:
        """Take a frame that has passed."""
        waiting, name = self._waiting, self._labels.get(label)
        if name is None:
            name = self._labels[label] = label.encode()
        waiting += self._pack(now) + record + name
        if len(waiting) > _ENOUGH:
            self._sha256.update(waiting)
            waiting.clear()

    def event(self, event: Event) -> None:
        """Take an event of the robot."""
        self.events += 1
        self._waiting += self._pack(event.time)
        sentence = event.sentence
        for folder in self._folders:
            sentence = sentence.replace(folder, "")
        self._waiting += f"{event.kind}\0{event.node}\0{sentence}\0".encode()

    @property
    def hex(self) -> str:
        """The digest so far."""
        self._sha256.update(self._waiting)
        self._waiting.clear()
        return self._sha256.hexdigest()
