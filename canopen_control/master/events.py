"""What a robot tells about itself: one event, one sentence.

An event names the node it is about, what happened in one word for programs and in one sentence for people, and how
bad it is. Events travel unchanged from here to the command line, the log and ROS.
"""

from __future__ import annotations

import enum
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["Event", "EventLog", "Level"]


class Level(enum.IntEnum):
    """How bad it is; the numbers are those of diagnostic_msgs/DiagnosticStatus."""

    INFO = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Event:
    """Something happened: `time` in monotonic ns, `node` the name in bus.yml or "" for the bus itself.

    `details` are what programs need not read out of the text: of kinds "emcy" and "emcy_reset" the error_code,
    error_register and data (hexadecimal) of the message.
    """

    time: int
    kind: str
    node: str
    text: str
    level: Level = Level.INFO
    details: Mapping[str, Any] | None = None


class EventLog:
    """The newest events, at most `capacity`; `take` hands out what is `waiting`, `dropped` counts what was too much."""

    def __init__(self, capacity: int = 256) -> None:
        self.recent: deque[Event] = deque(maxlen=capacity)
        self.dropped = 0
        self.waiting: deque[Event] = deque()
        self._capacity = capacity

    def add(self, event: Event) -> None:
        """Append an event; of a flood nobody takes only the newest stay."""
        self.recent.append(event)
        if len(self.waiting) >= self._capacity:
            self.waiting.popleft()
            self.dropped += 1
        self.waiting.append(event)

    def take(self) -> list[Event]:
        """Return the events since the last call."""
        events = list(self.waiting)
        self.waiting.clear()
        return events
