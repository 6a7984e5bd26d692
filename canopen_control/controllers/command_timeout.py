"""Timeout of a controller's command, with the source of the command and the reason for its end.

A velocity or effort command that is not renewed expires after the timeout of the YAML file or, without one, after
`DEFAULT_LIFE_S`; an explicit timeout of 0 means unlimited, which is upstream's default. A position command does not
expire.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Final

from canopen_control.urdf.joint_element import ACCELERATION, EFFORT, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Iterable


DEFAULT_LIFE_S: Final = 2.0
ENDLESS: Final = "endless_command"
"""Kind of the event that reports commands without a time limit."""
MOVING: Final = frozenset({VELOCITY, EFFORT, ACCELERATION})
"""Interfaces whose targets keep a joint moving."""


class GoalState(enum.Enum):
    """States of an accepted action goal, named as in action_msgs."""

    EXECUTING = "executing"
    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


class CommandTimeout:
    """Validity of a controller's current command, without the values of the command.

    - `live`: whether the command is valid; `created`: its creation time in ns; `limit_ns`: the timeout, 0 if unlimited.
    - `source`: text that names the sender.
    - `holder`: connection whose end also ends the command; None if the command outlives the connection.
    - `ended_by`: reason for the end of the previous command, "" if unknown.
    """

    __slots__ = ("created", "ended_by", "holder", "limit_ns", "live", "source")

    def __init__(self) -> None:
        self.limit_ns = 0
        self.created = 0
        self.live = False
        self.source = self.ended_by = ""
        self.holder: object = None

    def give(self, now: int) -> None:
        """Start the validity of a command that was created at `now`, in ns."""
        self.created, self.live = now, True

    def expire(self, now: int) -> bool:
        """Return True once when the command has expired; `now` is in ns."""
        if not self.live or not self.limit_ns or now - self.created <= self.limit_ns:
            return False
        self.live = False
        return True

    def end(self, why: str = "") -> None:
        """End the command; `why` is a clause with the reason."""
        self.live = False
        self.ended_by = why
        self.holder = None


def timeout_ns(timeout: float | None, interfaces: Iterable[str]) -> int:
    """Return the timeout in ns for commands to these interfaces, 0 if unlimited; `timeout` is the YAML value in s."""
    if timeout is None:
        timeout = DEFAULT_LIFE_S if MOVING.intersection(interfaces) else 0.0
    return round(timeout * 1e9)


def unlimited_warning(key: str, timeout: float | None, interfaces: Iterable[str]) -> str | None:
    """Return a warning about an explicit timeout of 0 for velocities, efforts or accelerations, else None."""
    if timeout != 0.0 or not MOVING.intersection(interfaces):
        return None
    return f"{key} is 0, so commands never expire: moving joints continue when the sender disappears"
