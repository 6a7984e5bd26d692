"""Pollers for the reactor: epoll, or an in-process one for simulations, whose readiness costs no system call."""

from __future__ import annotations

import os
import select
import selectors
import sys
from typing import TYPE_CHECKING, Any, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


_FIRST: Final = 1 << 30  # larger than any descriptor
_READABLE: Final = getattr(select, "EPOLLIN", 1)


class Poller(Protocol):
    """Source of ready descriptors."""

    def poll(self, timeout: float | None, maxevents: int, /) -> Sequence[tuple[int, int]]:
        """Return descriptors with their event masks, as epoll does."""

    def close(self) -> None:
        """Close the poller's descriptor."""


def open_poller(selector: selectors.BaseSelector) -> Poller | None:
    """Return a poller that is faster than the selector, None if there is none.

    The poller of epoll has a descriptor of its own, so that both can be closed.
    """
    if isinstance(selector, MarkedSelector):
        return selector
    if sys.platform == "linux" and isinstance(selector, selectors.EpollSelector):
        return select.epoll.fromfd(os.dup(selector.fileno()))
    return None


class MarkedSelector(selectors.BaseSelector):
    """In-process selector: returns numbers that were set ready, in that order, and never waits.

    Numbers come from `allocate` and stand for descriptors. Real descriptors may be registered too, and are never ready.
    `marked` are the ready numbers, watched or not.
    """

    def __init__(self) -> None:
        self._keys: dict[int, selectors.SelectorKey] = {}
        self.marked: dict[int, None] = {}
        self._next = _FIRST

    def allocate(self) -> int:
        """Return an unused number."""
        self._next += 1
        return self._next

    def set_ready(self, number: int) -> bool:
        """Make a number readable until `clear_ready`; return whether a reactor watches it and must be woken."""
        self.marked[number] = None
        return number in self._keys

    def clear_ready(self, number: int) -> None:
        """Make a number unreadable; no-op if it already is."""
        self.marked.pop(number, None)

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:  # noqa: ANN401 - selectors' own types
        """Watch a number."""
        key = self._keys[fileobj] = selectors.SelectorKey(fileobj, fileobj, events, data)
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:  # noqa: ANN401 - as above
        """Stop watching a number."""
        return self._keys.pop(fileobj)

    def select(self, _timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Return the ready numbers watched for reading, and all that are watched for writing."""
        keys = self._keys
        return [
            (key, selectors.EVENT_READ)
            for number in self.marked
            if (key := keys.get(number)) is not None and key.events & selectors.EVENT_READ
        ]

    def poll(self, _timeout: float | None, _most: int) -> Sequence[tuple[int, int]]:
        """Return the ready numbers as epoll does, each as readable."""
        marked, keys = self.marked, self._keys
        if not marked:
            return ()
        if len(marked) == 1:
            [number] = marked
            return ((number, _READABLE),) if number in keys else ()
        return [(number, _READABLE) for number in marked if number in keys]

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        """Return the watched numbers."""
        return self._keys

    def close(self) -> None:
        """Clear all registrations."""
        self._keys.clear()
        self.marked.clear()
