"""Timeout and senders of a controller's commands, and the reason why a command ended.

A velocity or effort command that is not renewed expires after the timeout of the YAML file or, without one, after
`DEFAULT_TIMEOUT_S`; an explicit timeout of 0 means unlimited, the default in ros2_controllers. A position command does
not expire. The most recent command takes effect; clients that command one controller alternately are reported
(`SenderWatch`).
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.urdf.joint_element import ACCELERATION, EFFORT, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Iterable


DEFAULT_TIMEOUT_S: Final = 2.0
_LONG_S: Final = 60.0
UNLIMITED: Final = "endless_command"
"""Kind of the event that reports commands without a time limit."""
MOVING: Final = frozenset({VELOCITY, EFFORT, ACCELERATION})
"""Interfaces whose targets keep a joint moving."""


class GoalState(enum.Enum):
    """States of an accepted action goal, named as in action_msgs."""

    EXECUTING = "executing"
    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


class CommandSender(NamedTuple):
    """Sender of commands: `identity` is unique to its connection, `name` is for messages."""

    identity: object
    name: str


ALTERNATION_NS: Final = 2_000_000_000
"""Longest time between two changes of the sender that still counts as alternating."""
_CALM_NS: Final = 10_000_000_000  # time without a change after which an alternation is reported again
_RETURNS: Final = 2  # a sender that returns once may have been interrupted intentionally
_KNOWN: Final = 4  # number of senders that are distinguished


class SenderWatch:
    """Detector of senders that command one controller alternately, which makes its joints jerk between two commands.

    A new sender that takes over, and a sender that returns once, are normal.
    """

    __slots__ = ("_changed_at", "_known", "_reported", "_returns")

    def __init__(self) -> None:
        self._known: list[CommandSender] = []  # the current sender is last
        self._changed_at = self._returns = 0
        self._reported = False

    def take(self, sender: CommandSender, now: int) -> tuple[str, str] | None:
        """Record the sender of a command; return the names of two senders that have started to alternate, else None."""
        known = self._known
        if known and known[-1].identity == sender.identity:
            return None
        since, self._changed_at = now - self._changed_at, now
        if since > ALTERNATION_NS:
            del known[:-1]
            self._returns = 0
            self._reported = self._reported and since <= _CALM_NS
        earlier = [other for other in known if other.identity != sender.identity]
        if len(earlier) < len(known):  # the sender has returned
            self._returns += 1
        self._known = [*earlier[1 - _KNOWN :], sender]
        if self._reported or self._returns < _RETURNS:
            return None
        self._reported = True
        return earlier[-1].name, sender.name


class CommandTimeout:
    """Validity of a controller's current command, without its values.

    - `live`: whether the command is valid; `created`: its creation time in ns; `limit_ns`: the timeout, 0 if unlimited.
    - `source`: text that names the sender; `senders` detects senders that alternate.
    - `holder`: connection whose end also ends the command; None if the command outlives the connection.
    - `ended_by`: reason why the previous command ended, "" if unknown.
    """

    __slots__ = ("created", "ended_by", "holder", "limit_ns", "live", "senders", "source")

    def __init__(self) -> None:
        self.limit_ns = 0
        self.created = 0
        self.live = False
        self.source = self.ended_by = ""
        self.holder: object = None
        self.senders = SenderWatch()

    def start(self, now: int) -> None:
        """Mark the command as valid; `now` is its creation time in ns."""
        self.created, self.live = now, True

    def expire(self, now: int) -> bool:
        """End the command if it has expired, and return whether this call ended it; `now` is in ns."""
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
        timeout = DEFAULT_TIMEOUT_S if MOVING.intersection(interfaces) else 0.0
    return round(timeout * 1e9)


def timeout_warning(key: str, timeout: float | None, interfaces: Iterable[str]) -> str | None:
    """Return a warning if a velocity, effort or acceleration has an explicit timeout of 0 or over a minute, else None.

    `timeout` is the value of the parameter `key` in s. Such a long value was usually meant in ms.
    """
    if timeout is None or 0.0 < timeout <= _LONG_S or not MOVING.intersection(interfaces):
        return None
    if timeout:
        return f"{key} is {timeout:g} s: moving joints continue for that time when the sender disappears"
    return f"{key} is 0, so commands never expire: moving joints continue when the sender disappears"
