"""The robot's event log: each event one sentence, repeated ones told once with their count.

An event names the node it is about, what happened in one word for programs and in one sentence for people, and how
bad it is. Events travel unchanged from here to the command line, the log and ROS; what repeats itself is summed up
here, for all of them.
"""

from __future__ import annotations

import enum
import re
from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from canopen_control.rpc.messages.state import EventDetails


FIRST_WINDOW_NS: Final = 2_000_000_000
WIDEST_WINDOW_NS: Final = 64_000_000_000
FEW: Final = 5
_MOST_OPEN: Final = 256
_NEVER: Final = 1 << 62
#: what somebody did, or what a state has become by it: each one counts, unless it is a flood
_ACTS: Final = frozenset({"stop", "stop_latched", "stop_released", "stopping", "stopped", "recovered"})
#: what is told without anybody having done something, good as it may be
_MACHINES: Final = ("bus_", "emcy")
#: counts, times and bytes of data, but neither hexadecimal codes nor node ids
_NUMBER: Final = re.compile(r"(?<!node )(?<![\w.])(?:[0-9a-f]{2}(?: [0-9a-f]{2})+|\d+(?:\.\d+)?)(?!\w)")


class Level(enum.IntEnum):
    """How bad it is; the numbers are those of diagnostic_msgs/DiagnosticStatus."""

    INFO = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Event:
    """Something happened: `time` in monotonic ns, `node` the name in bus.yml or "" for the bus itself.

    `controller` is the one it is about, "" for none. `details` are what programs need not read out of the text. `count`
    is how often it happened, since `since` where that is more than once.
    """

    time: int
    kind: str
    node: str
    text: str
    level: Level = Level.INFO
    details: EventDetails | None = None
    count: int = 1
    since: int | None = None
    controller: str = ""

    @property
    def sentence(self) -> str:
        """The text, with how often it happened."""
        if self.count < 2:
            return self.text
        if self.since is None:
            return f"{self.text} ({self.count} times)"
        return f"{self.text} ({self.count} times in {_span((self.time - self.since) / 1e9)})"


def _span(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s" if seconds < 600 else f"{seconds / 60:.0f} min"


def _few(event: Event) -> int:
    """Return how many of its kind are told one by one."""
    good_news = event.level is Level.INFO and not event.kind.startswith(_MACHINES)
    return FEW if good_news or event.kind in _ACTS else 1


class _Repeated:
    """An event that may come again: the newest of its kind, how often, how often that has been told, until when."""

    __slots__ = ("count", "event", "since", "told", "until", "window_ns")

    def __init__(self, event: Event) -> None:
        self.event, self.count, self.since = event, event.count, event.time
        self.told = 0
        self.window_ns = FIRST_WINDOW_NS
        self.until = event.time + self.window_ns

    def sum(self) -> Event:
        """Return what is told of all of them."""
        if self.count == self.event.count:
            return self.event
        return replace(self.event, count=self.count, since=self.since, details=None)


class EventLog:
    """What happened, each told when it comes first, and in sum when it comes again.

    An event is the same as one before when kind, node and text are, numbers apart. What `add` returns is told at once:
    the first one, of a deliberate act and of good news the first `FEW`. The others are counted, and what `tick` returns
    sums them up: after `FIRST_WINDOW_NS`, and as long as they keep coming, in windows of twice the length each, up to
    `WIDEST_WINDOW_NS`. A window in which none came is the end of it.

    `recent` are the newest, at most `capacity`, each of those that repeat with its count; `take` hands out what is
    `waiting`, `dropped` counts what was too much.
    """

    def __init__(self, capacity: int = 256) -> None:
        self.dropped = 0
        self.waiting: deque[Event] = deque()
        self._recent: deque[_Repeated] = deque(maxlen=capacity)
        self._open: dict[tuple[str, str, str], _Repeated] = {}
        self._due = _NEVER
        self._capacity = capacity

    @property
    def recent(self) -> list[Event]:
        """The newest, oldest first."""
        return [each.sum() for each in self._recent]

    def add(self, event: Event) -> list[Event]:
        """Keep an event; return what is to be told now, if anything. Of a flood nobody takes only the newest stay."""
        key = (event.kind, event.node, _NUMBER.sub("#", event.text))
        known = self._open.get(key)
        if known is None or event.time >= known.until + known.window_ns:
            told = self._close_oldest() if len(self._open) >= _MOST_OPEN else []
            known = self._open[key] = _Repeated(event)
            self._recent.append(known)
            self._due = min(self._due, known.until)
        else:
            told = []
            known.event, known.count = event, known.count + event.count
        if known.count <= _few(event) or known.count == event.count:
            known.told = known.count
            told.append(event)
        return self._tell(told)

    def is_due(self, now: int) -> bool:
        """Whether `tick` has something to do."""
        return now >= self._due

    def tick(self, now: int) -> list[Event]:
        """Return the sums that are due."""
        told: list[Event] = []
        for key, each in list(self._open.items()):
            if now >= each.until:
                told += self._end_window(key, each)
        self._due = min((each.until for each in self._open.values()), default=_NEVER)
        return self._tell(told)

    def flush(self) -> list[Event]:
        """Return all sums that are not told yet; for the end."""
        told = [each.sum() for each in self._open.values() if each.count > each.told]
        self._open.clear()
        self._due = _NEVER
        return self._tell(told)

    def _end_window(self, key: tuple[str, str, str], each: _Repeated) -> list[Event]:
        if each.count == each.told:
            del self._open[key]
            return []
        each.told = each.count
        each.window_ns = min(2 * each.window_ns, WIDEST_WINDOW_NS)
        each.until += each.window_ns
        return [each.sum()]

    def _close_oldest(self) -> list[Event]:
        """Make room for another one; what was counted of the oldest is told."""
        key = next(iter(self._open))
        each = self._open.pop(key)
        return [each.sum()] if each.count > each.told else []

    def _tell(self, events: list[Event]) -> list[Event]:
        for event in events:
            if len(self.waiting) >= self._capacity:
                self.waiting.popleft()
                self.dropped += 1
            self.waiting.append(event)
        return events

    def take(self) -> list[Event]:
        """Return what was told since the last call."""
        events = list(self.waiting)
        self.waiting.clear()
        return events
