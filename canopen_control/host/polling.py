"""Pollers for the reactor: epoll, or an in-process poller for simulations whose readiness costs no system call."""

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
        """Return ready descriptors with their event masks, as epoll does."""

    def close(self) -> None: ...


def open_poller(selector: selectors.BaseSelector) -> Poller | None:
    """Return a poller that is faster than `selector` itself, or None.

    The epoll poller has a descriptor of its own, so that both the poller and the selector can be closed.
    """
    if isinstance(selector, MarkedSelector):
        return selector
    if sys.platform == "linux" and isinstance(selector, selectors.EpollSelector):
        return select.epoll.fromfd(os.dup(selector.fileno()))
    return None


class MarkedSelector(selectors.BaseSelector):
    """In-process selector that returns the numbers that were set ready, in that order, and never waits.

    `allocate` returns the numbers, which take the place of descriptors. Real descriptors may be registered too, and are
    never ready. `marked` contains the ready numbers, whether they are registered or not.
    """

    def __init__(self) -> None:
        self._keys: dict[int, selectors.SelectorKey] = {}
        self.marked: dict[int, None] = {}
        self._next = _FIRST

    def allocate(self) -> int:
        """Return an unused number to be used in place of a descriptor."""
        self._next += 1
        return self._next

    def set_ready(self, number: int) -> bool:
        """Make a number readable until `clear_ready`; return whether it is registered with a reactor."""
        self.marked[number] = None
        return number in self._keys

    def clear_ready(self, number: int) -> None:
        """Make a number unreadable; no-op if it is not ready."""
        self.marked.pop(number, None)

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:  # noqa: ANN401 - selectors' own types
        key = self._keys[fileobj] = selectors.SelectorKey(fileobj, fileobj, events, data)
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:  # noqa: ANN401 - as above
        return self._keys.pop(fileobj)

    def select(self, _timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Return the ready numbers that are registered for reading; numbers are never ready for writing."""
        keys = self._keys
        return [
            (key, selectors.EVENT_READ)
            for number in self.marked
            if (key := keys.get(number)) is not None and key.events & selectors.EVENT_READ
        ]

    def poll(self, _timeout: float | None, _most: int) -> Sequence[tuple[int, int]]:
        """Return the registered and ready numbers, each with the mask of readable, as epoll does."""
        marked, keys = self.marked, self._keys
        if not marked:
            return ()
        if len(marked) == 1:
            [number] = marked
            return ((number, _READABLE),) if number in keys else ()
        return [(number, _READABLE) for number in marked if number in keys]

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        return self._keys

    def close(self) -> None:
        self._keys.clear()
        self.marked.clear()
