"""A bounded queue for what a core wants sent or told until its owner takes it.

A core must not grow when a bus floods it or its owner forgets it. The oldest item gives way and is counted.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterable


T = TypeVar("T")


class Outbox(Generic[T]):
    """At most `limit` items, oldest first; `lost` counts those that had to give way.

    `waiting` is for whoever only asks whether there are any, which in most cycles there are not.
    """

    __slots__ = ("lost", "waiting")

    def __init__(self, limit: int = 256) -> None:
        self.waiting: deque[T] = deque(maxlen=limit)
        self.lost = 0

    def put(self, item: T) -> None:
        """Append `item`; when full the oldest is lost."""
        waiting = self.waiting
        if len(waiting) == waiting.maxlen:
            self.lost += 1
        waiting.append(item)

    def drain(self) -> list[T]:
        """Return all items, oldest first, and forget them."""
        waiting = self.waiting
        if not waiting:
            return []
        items = list(waiting)
        waiting.clear()
        return items

    def clear(self) -> None:
        """Forget all items without counting them."""
        self.waiting.clear()

    def __len__(self) -> int:
        return len(self.waiting)


def drain_all(queues: Iterable[deque[T]]) -> list[T]:
    """Return the items of what waits in several outboxes, those of the first one first, and forget them."""
    items: list[T] = []
    for waiting in queues:
        if waiting:
            items += waiting
            waiting.clear()
    return items
