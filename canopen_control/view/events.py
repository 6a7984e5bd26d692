"""The log of events: the last hundred; the sum of what repeats itself takes the place of the one it began with."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from canopen_control.rpc.messages.state import RobotEvent

__all__ = ["EventLog"]

_EVENTS: Final = 100


class EventLog:
    """The newest events; iterates oldest first."""

    def __init__(self, events: Iterable[RobotEvent] = ()) -> None:
        self._events: deque[RobotEvent] = deque(maxlen=_EVENTS)
        for event in events:
            self.add(event)

    def __iter__(self) -> Iterator[RobotEvent]:
        return iter(self._events)

    def add(self, event: RobotEvent) -> None:
        """Take an event; one that the runtime has counted takes the place of the one it began with."""
        if event.count > 1:
            self._replace(event)
        else:
            self._events.append(event)

    def _replace(self, event: RobotEvent) -> None:
        for number, each in enumerate(self._events):
            if (each.first, each.kind, each.node) == (event.first, event.kind, event.node):
                del self._events[number]
                break
        self._events.append(event)
