"""Everything that the panels show, made once for all pages: state, log of events, controllers, faults. No toolkit."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.view.sampling import commanded_interfaces
from canopen_control.view.words import banner, lost_banner

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from canopen_control.rpc.messages.state import ControllerReading, RobotEvent, StateSample
    from canopen_control.view.fault_client import DriveFaults
    from canopen_control.view.words import Banner

__all__ = ["PageContent", "RecentEvents"]

_EVENTS: Final = 100


class RecentEvents:
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


@dataclass(frozen=True, slots=True)
class PageContent:
    """What is known now. `state` is the newest one; `lost` says why nobody knows whether it is still so, else empty."""

    state: StateSample
    events: RecentEvents
    controllers: tuple[ControllerReading, ...] = ()
    faults: DriveFaults | None = None
    lost: str = ""
    commanded: dict[str, str] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "commanded", commanded_interfaces(self.controllers, self.state))

    @property
    def banner(self) -> Banner:
        """The robot in one line."""
        return lost_banner(self.lost) if self.lost else banner(self.state)
