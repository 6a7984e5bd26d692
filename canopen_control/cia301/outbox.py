"""Bounded queue of a protocol core's frames or events, until its owner fetches them.

A core must not grow when the bus is flooded or its owner stops fetching: the oldest item is dropped and counted.
"""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class Outbox(Generic[T]):
    """Queue of at most `limit` items, oldest first; `lost` counts the items dropped because it was full.

    `waiting` is the underlying deque: testing it for items avoids a call in cycles that have none.
    """

    __slots__ = ("lost", "waiting")

    def __init__(self, limit: int = 256) -> None:
        self.waiting: deque[T] = deque(maxlen=limit)
        self.lost = 0

    def put(self, item: T) -> None:
        """Append `item`; drop the oldest item if the queue is full."""
        waiting = self.waiting
        if len(waiting) == waiting.maxlen:
            self.lost += 1
        waiting.append(item)

    def drain(self) -> list[T]:
        waiting = self.waiting
        if not waiting:
            return []
        items = list(waiting)
        waiting.clear()
        return items

    def clear(self) -> None:
        """Discard all items without counting them as lost."""
        self.waiting.clear()

    def __len__(self) -> int:
        return len(self.waiting)
