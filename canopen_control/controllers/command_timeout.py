"""Timeout of a controller's command: source, time and validity.

A velocity or effort command that is not renewed expires after the timeout of the YAML file or, without one, after
`DEFAULT_LIFE_S`; an explicit timeout of 0 is unlimited, as upstream's default. A position command has no end.
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
    """States of an accepted goal, by action_msgs' names."""

    EXECUTING = "executing"
    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


class CommandTimeout:
    """Command of a controller, without its values: `live` while it is valid, `given` its creation in ns.

    `source` is its source as text; `holder` is the connection with which it ends, None if it outlives the connection.
    `ended_by` is the reason of the end of the last one, "" if unknown.
    """

    __slots__ = ("ended_by", "given", "holder", "limit_ns", "live", "source")

    def __init__(self) -> None:
        self.limit_ns = 0
        self.given = 0
        self.live = False
        self.source = self.ended_by = ""
        self.holder: object = None

    def give(self, now: int) -> None:
        """Start with a command that was created at `now`, in ns."""
        self.given, self.live = now, True

    def runs_out(self, now: int) -> bool:
        """Return whether the command expires now without a renewal: True once for each command."""
        if not self.live or not self.limit_ns or now - self.given <= self.limit_ns:
            return False
        self.live = False
        return True

    def end(self, why: str = "") -> None:
        """End the command; `why` is a clause about the reason."""
        self.live = False
        self.ended_by = why
        self.holder = None


def timeout_ns(timeout: float | None, interfaces: Iterable[str]) -> int:
    """Return the timeout of commands to these interfaces in ns, 0 if unlimited; `timeout` in s as in the YAML file."""
    if timeout is None:
        timeout = DEFAULT_LIFE_S if MOVING.intersection(interfaces) else 0.0
    return round(timeout * 1e9)


def unlimited_warning(key: str, timeout: float | None, interfaces: Iterable[str]) -> str | None:
    """Return the warning about an explicit timeout of 0 for velocities or efforts, else None."""
    if timeout != 0.0 or not MOVING.intersection(interfaces):
        return None
    return f"{key} is 0, so a command never ends by itself: what moves continues when its sender ends"
