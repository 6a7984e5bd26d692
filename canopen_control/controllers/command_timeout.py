"""The timeout of a controller's command: who gave it, when, and how long it counts.

The law of the file: a velocity or effort command that nobody renews ends by itself, after the time-out of the YAML or,
where that names none, after `DEFAULT_LIFE_S`; a time-out of 0 that is written is for ever, as upstream's default. A
position is a place to stay at and has no end.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Final

from canopen_control.urdf.joint_element import ACCELERATION, EFFORT, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Iterable


DEFAULT_LIFE_S: Final = 2.0
ENDLESS: Final = "endless_command"
"""The kind of the event that tells of commands without an end."""
MOVING: Final = frozenset({VELOCITY, EFFORT, ACCELERATION})
"""The interfaces whose targets keep something moving."""


class GoalState(enum.Enum):
    """The states of a goal that was accepted, by action_msgs' names."""

    EXECUTING = "executing"
    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


class CommandTimeout:
    """The command that a controller has, its values apart: `live` while it counts, `given` when it was made, in ns.

    `source` says in words who gave it; `holder` is the connection with which it ends, None where it outlives that.
    `ended_by` says why the last one was taken back, "" where nobody said.
    """

    __slots__ = ("ended_by", "given", "holder", "limit_ns", "live", "source")

    def __init__(self) -> None:
        self.limit_ns = 0
        self.given = 0
        self.live = False
        self.source = self.ended_by = ""
        self.holder: object = None

    def give(self, now: int) -> None:
        """Begin anew with a command that was made at `now`, in ns."""
        self.given, self.live = now, True

    def runs_out(self, now: int) -> bool:
        """Whether it ends now, because nobody has renewed it: True once for each command."""
        if not self.live or not self.limit_ns or now - self.given <= self.limit_ns:
            return False
        self.live = False
        return True

    def end(self, why: str = "") -> None:
        """Count no more; `why` is a clause that says who or what has ended it."""
        self.live = False
        self.ended_by = why
        self.holder = None


def timeout_ns(timeout: float | None, interfaces: Iterable[str]) -> int:
    """Return the life of commands to these interfaces in ns, 0 for ever; `timeout` in s as the YAML has it."""
    if timeout is None:
        timeout = DEFAULT_LIFE_S if MOVING.intersection(interfaces) else 0.0
    return round(timeout * 1e9)


def unlimited_warning(key: str, timeout: float | None, interfaces: Iterable[str]) -> str | None:
    """Return what is to be said of a time-out of 0 that is written for velocities or efforts, else None."""
    if timeout != 0.0 or not MOVING.intersection(interfaces):
        return None
    return f"{key} is 0, so a command never ends by itself: what moves goes on when its sender dies"
