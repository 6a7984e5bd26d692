"""Event log of a robot, in which repetitions of an event are summarised with a count.

An event has a node, a kind (one word, for programs), a sentence for users, and a level. The command line, the log and
ROS receive the same events; repetitions are summarised here for all of them.
"""

from __future__ import annotations

import enum
import re
from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from canopen_control.rpc.messages.fault import FaultEvent


FIRST_WINDOW_NS: Final = 2_000_000_000
WIDEST_WINDOW_NS: Final = 64_000_000_000
FEW: Final = 5
_MAX_OPEN: Final = 256
_NEVER: Final = 1 << 62
#: kinds of deliberate actions and their results, which are reported one by one up to `FEW`
_ACTS: Final = frozenset({"stop", "stop_latched", "stop_released", "stopping", "stopped", "recovered"})
#: prefixes of the kinds of events that occur without a user's action
_MACHINES: Final = ("bus_", "emcy")
#: numbers and data bytes in a text, except hexadecimal codes and node-IDs
_NUMBER: Final = re.compile(r"(?<!node )(?<![\w.])(?:[0-9a-f]{2}(?: [0-9a-f]{2})+|\d+(?:\.\d+)?)(?!\w)")


class Level(enum.IntEnum):
    """Severity level of an event, with the numbers of diagnostic_msgs/DiagnosticStatus."""

    INFO = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Event:
    """Event at `time` in monotonic ns; `node` is the name in bus.yml, or "" for the bus itself.

    `controller` is the name of the controller concerned, "" for none. `details` is the reported fault, so that programs
    need not parse the text. `count` is the number of occurrences since the time `since`.
    """

    time: int
    kind: str
    node: str
    text: str
    level: Level = Level.INFO
    details: FaultEvent | None = None
    count: int = 1
    since: int | None = None
    controller: str = ""

    @property
    def sentence(self) -> str:
        """Text of the event, with the number of occurrences if there are several."""
        if self.count < 2:
            return self.text
        if self.since is None:
            return f"{self.text} ({self.count} times)"
        return f"{self.text} ({self.count} times in {_span((self.time - self.since) / 1e9)})"


def _span(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s" if seconds < 600 else f"{seconds / 60:.0f} min"


def _few(event: Event) -> int:
    """Return how many occurrences of an event are reported individually."""
    good_news = event.level is Level.INFO and not event.kind.startswith(_MACHINES)
    return FEW if good_news or event.kind in _ACTS else 1


class _Repeated:
    """Series of equal events: the latest occurrence, its counts and the end of the current window."""

    __slots__ = ("count", "event", "reported", "since", "until", "window_ns")

    def __init__(self, event: Event) -> None:
        self.event, self.count, self.since = event, event.count, event.time
        self.reported = 0
        self.window_ns = FIRST_WINDOW_NS
        self.until = event.time + self.window_ns

    def sum(self) -> Event:
        """Combine all occurrences into one event with the total count."""
        if self.count == self.event.count:
            return self.event
        return replace(self.event, count=self.count, since=self.since, details=None)


class EventLog:
    """Log of events: the first occurrence of an event is reported at once, repetitions are summarised.

    Events are equal if kind, node and text are equal except for numbers. `add` returns the events to report at once:
    the first occurrence, or the first `FEW` of deliberate actions and of information. Further occurrences are counted,
    and `tick` returns their summary: after `FIRST_WINDOW_NS`, and while they continue, after windows whose length
    doubles up to `WIDEST_WINDOW_NS`. A window without an occurrence ends the series.

    `recent` are the newest series, at most `capacity`, and `version` increases when they change. `waiting` are the
    reported events until `take`, at most `capacity`; `dropped` counts discarded events.
    """

    def __init__(self, capacity: int = 256) -> None:
        self.dropped = self.version = 0
        self.waiting: deque[Event] = deque()
        self._recent: deque[_Repeated] = deque(maxlen=capacity)
        self._open: dict[tuple[str, str, str], _Repeated] = {}
        self.due = _NEVER
        self._capacity = capacity

    @property
    def recent(self) -> list[Event]:
        """Latest events, oldest first; a series of equal events is one event with a count."""
        return [repeated.sum() for repeated in self._recent]

    def add(self, event: Event) -> list[Event]:
        """Add an event; return the events to report now."""
        self.version += 1
        key = (event.kind, event.node, _NUMBER.sub("#", event.text))
        repeated = self._open.get(key)
        if repeated is None or event.time >= repeated.until + repeated.window_ns:
            events = self._close_oldest() if len(self._open) >= _MAX_OPEN else []
            repeated = self._open[key] = _Repeated(event)
            self._recent.append(repeated)
            self.due = min(self.due, repeated.until)
        else:
            events = []
            repeated.event, repeated.count = event, repeated.count + event.count
        if repeated.count <= _few(event) or repeated.count == event.count:
            repeated.reported = repeated.count
            events.append(event)
        return self._report(events)

    def tick(self, now: int) -> list[Event]:
        """Return the summaries that are due at `now`, in monotonic ns."""
        events: list[Event] = []
        for key, repeated in list(self._open.items()):
            if now >= repeated.until:
                events += self._end_window(key, repeated)
        self.due = min((repeated.until for repeated in self._open.values()), default=_NEVER)
        return self._report(events)

    def flush(self) -> list[Event]:
        """Return all pending summaries at the end of a run."""
        events = [repeated.sum() for repeated in self._open.values() if repeated.count > repeated.reported]
        self._open.clear()
        self.due = _NEVER
        return self._report(events)

    def _end_window(self, key: tuple[str, str, str], repeated: _Repeated) -> list[Event]:
        if repeated.count == repeated.reported:
            del self._open[key]
            return []
        repeated.reported = repeated.count
        repeated.window_ns = min(2 * repeated.window_ns, WIDEST_WINDOW_NS)
        repeated.until += repeated.window_ns
        return [repeated.sum()]

    def _close_oldest(self) -> list[Event]:
        """Remove the oldest series to limit their number; return its pending summary, if any."""
        key = next(iter(self._open))
        repeated = self._open.pop(key)
        return [repeated.sum()] if repeated.count > repeated.reported else []

    def _report(self, events: list[Event]) -> list[Event]:
        for event in events:
            if len(self.waiting) >= self._capacity:
                self.waiting.popleft()
                self.dropped += 1
            self.waiting.append(event)
        return events

    def take(self) -> list[Event]:
        """Return and clear the events reported since the last call."""
        events = list(self.waiting)
        self.waiting.clear()
        return events
