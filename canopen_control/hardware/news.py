"""What a joint tells: a named piece of news, whether it must stop the robot, and how the drive's events become one.

The law of this file: one table from the kind of a drive's event to its name, its level and whether it stops; what a
program should tell apart has a name of its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.cia402 import events
from canopen_control.master.events import Level

if TYPE_CHECKING:
    from canopen_control.cia402.events import DriveEvent

__all__ = ["News", "news_of"]


class News(NamedTuple):
    """Something about one joint; `stops` says that its group has to stop."""

    kind: str
    text: str
    level: Level = Level.WARNING
    stops: bool = False


_TABLE: Final[dict[type, tuple[str, Level, bool]]] = {
    events.StateChanged: ("state", Level.INFO, False),
    events.FaultEntered: ("fault", Level.ERROR, True),
    events.FaultCleared: ("fault_cleared", Level.INFO, False),
    events.FaultResetFailed: ("fault_reset_failed", Level.ERROR, False),
    events.TransitionTimedOut: ("transition_timeout", Level.ERROR, False),
    events.ModeConfirmed: ("mode", Level.INFO, False),
    events.ModeTimedOut: ("mode_timeout", Level.ERROR, False),
    events.EnableLost: ("enable_lost", Level.ERROR, True),
    events.ControlChanged: ("control", Level.WARNING, False),
    events.StatuswordUndefined: ("statusword", Level.ERROR, False),
}


def news_of(event: DriveEvent) -> News:
    """Return what an event of the drive's state machine means for its joint."""
    kind, level, stops = _TABLE[type(event)]
    if isinstance(event, events.TransitionTimedOut):
        stops = event.gave_up
    elif isinstance(event, events.ControlChanged):
        level = Level.INFO if event.remote else Level.ERROR
        stops = not event.remote
    return News(kind, event.text, level, stops)
