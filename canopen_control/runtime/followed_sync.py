"""A SYNC that the kernel, or a node of the bus, sends and the cycle follows.

The kernel's SYNC is heard like anybody's (what one socket sends comes to every other one), and the cycle's edges are
held behind it (`sync_phase`): half a period, by when the drives' answers to it have come, and what the cycle writes has
the other half to be on the wire before the next SYNC, at which the drives act upon it; with `sync_order: first` an
eighth, which leaves seven eighths to a process that is late. When SYNC is not heard the cycle goes on by its own clock,
the task is set up again, and that is told.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from canopen_control.errors import BusError
from canopen_control.master.event_log import Event, Level

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["FollowedSync", "SyncOfAnother"]

_MISSED = 5  # periods without SYNC until it is set up again
_RETRY_NS = 500_000_000


class Task(Protocol):
    """What sends SYNC; `sender` and `mending` are who it is and what is done where none comes, in words."""

    @property
    def sender(self) -> str: ...

    @property
    def mending(self) -> str: ...

    def start(self, period_us: int) -> None:
        """Send every `period_us`, also when it did already; raise BusError."""

    def close(self) -> None:
        """Send no more."""


class SyncOfAnother:
    """The SYNC of a node, with which nothing can be done but to listen."""

    sender = "a node of the bus (sync_producer: other)"
    mending = "the cycle goes on by its own clock, and drives that wait for SYNC stand; let a node produce it (0x1005)"

    def start(self, period_us: int) -> None:
        """Do nothing: it is sent already, or will be."""

    def close(self) -> None:
        """Do nothing."""


class FollowedSync:
    """The SYNC of one bus; `lead(now)` is called with every one that is heard, None for a bus that is not followed.

    `count` is how many were heard; `patience_ns` is how much later the first one may come, which waits for the boot of
    a node that sends it.
    """

    def __init__(
        self,
        task: Task,
        period_us: int,
        lead: Callable[[int], None] | None,
        report: Callable[[Event], None],
        patience_ns: int = 0,
    ) -> None:
        self._task, self._period_us, self._lead, self._report = task, period_us, lead, report
        self._timeout = max(_MISSED * period_us * 1000, _RETRY_NS // 2)
        self.count = 0
        self._deadline, self._patience = 0, patience_ns
        self._silent = False

    def start(self, now: int) -> None:
        """Let the kernel begin; raise BusError."""
        self._task.start(self._period_us)
        self._deadline = now + self._patience + self._timeout

    def heard(self, now: int) -> None:
        """Take a SYNC that came over the bus."""
        self.count += 1
        self._deadline = now + self._timeout
        self._silent = False
        if self._lead is not None:
            self._lead(now)

    def tick(self, now: int) -> None:
        """Set it up again when it is not heard, every half a second until it is."""
        if now < self._deadline:
            return
        self._deadline = now + _RETRY_NS
        self._task.close()
        why = self._task.mending
        try:
            self._task.start(self._period_us)
        except BusError as error:
            why = str(error)
        if not self._silent:
            self._silent = True
            self._report(Event(now, "sync_lost", "", f"no SYNC comes from {self._task.sender}; {why}", Level.WARNING))

    def close(self) -> None:
        """Let the kernel end; a second call does nothing."""
        self._task.close()
