"""A bounded queue for what a core wants sent or told until its owner takes it.

A core must not grow when a bus floods it or its owner forgets it. The oldest item gives way and is counted.
"""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

__all__ = ["Outbox"]

T = TypeVar("T")


class Outbox(Generic[T]):
    """At most `limit` items, oldest first; `lost` counts those that had to give way."""

    __slots__ = ("_items", "lost")

    def __init__(self, limit: int = 256) -> None:
        self._items: deque[T] = deque(maxlen=limit)
        self.lost = 0

    def put(self, item: T) -> None:
        """Append `item`; when full the oldest is lost."""
        if len(self._items) == self._items.maxlen:
            self.lost += 1
        self._items.append(item)

    def drain(self) -> list[T]:
        """Return all items, oldest first, and forget them."""
        if not self._items:
            return []
        items = list(self._items)
        self._items.clear()
        return items

    def clear(self) -> None:
        """Forget all items without counting them."""
        self._items.clear()

    def __len__(self) -> int:
        return len(self._items)
