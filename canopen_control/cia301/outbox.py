"""Bounded queue in which a core's frames or events wait for its owner.

A core must not grow when the bus is flooded or its owner stops fetching: the oldest item is dropped and counted.
"""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class Outbox(Generic[T]):
    """Queue of at most `limit` items, oldest first; `lost` counts dropped items.

    `waiting` is True if the queue has items; reading it avoids a call in cycles without any.
    """

    __slots__ = ("lost", "waiting")

    def __init__(self, limit: int = 256) -> None:
        self.waiting: deque[T] = deque(maxlen=limit)
        self.lost = 0

    def put(self, item: T) -> None:
        """Append `item`; drop the oldest one if the queue is full."""
        waiting = self.waiting
        if len(waiting) == waiting.maxlen:
            self.lost += 1
        waiting.append(item)

    def drain(self) -> list[T]:
        """Return and clear all items, oldest first."""
        waiting = self.waiting
        if not waiting:
            return []
        items = list(waiting)
        waiting.clear()
        return items

    def clear(self) -> None:
        """Clear all items without counting them."""
        self.waiting.clear()

    def __len__(self) -> int:
        return len(self.waiting)
