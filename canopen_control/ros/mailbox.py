"""Commands on their way from ROS to the robot: the newest of each controller, at most one per cycle.

The law of the file: a publisher may be as fast as it likes; what it sends in between is superseded, never queued, so
that the robot gets what was meant last, and gets it once per `interval_ns`. The first message after a pause leaves at
once.
"""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

__all__ = ["Mailbox"]

T = TypeVar("T")


class Mailbox(Generic[T]):
    """Newest value by name; `put` from any thread, `take` by the one that was woken."""

    def __init__(self, interval_ns: int) -> None:
        self.interval_ns = interval_ns
        self._lock = threading.Lock()
        self._waiting: dict[str, T] = {}
        self._sent: dict[str, int] = {}
        self._woken = False

    def put(self, name: str, value: T) -> bool:
        """Leave the newest value; True when somebody must be woken to `take` it."""
        with self._lock:
            self._waiting[name] = value
            wake, self._woken = not self._woken, True
            return wake

    def take(self, now: int) -> tuple[dict[str, T], int | None]:
        """Return what may leave now, and when to come again for the rest (ns; None: when woken)."""
        with self._lock:
            due = {name: value for name, value in self._waiting.items() if self._due_at(name) <= now}
            for name in due:
                del self._waiting[name]
                self._sent[name] = now
            later = min(map(self._due_at, self._waiting), default=None)
            self._woken = later is not None
            return due, later

    def forget(self, name: str) -> None:
        """Drop what waits under a name that is no more."""
        with self._lock:
            self._waiting.pop(name, None)
            self._sent.pop(name, None)

    def _due_at(self, name: str) -> int:
        return self._sent[name] + self.interval_ns if name in self._sent else 0
