"""A SYNC that the kernel, or a node of the bus, sends and the cycle follows.

The kernel's SYNC is heard like anybody's (what one socket sends comes to every other one), and the cycle's edges are
held behind it (`sync_phase`): half a period, by when the drives' answers to it have come, and what the cycle writes has
the other half to be on the wire before the next SYNC, at which the drives act upon it; with `sync_order: first` an
eighth, which leaves seven eighths to a process that is late. When SYNC is not heard the cycle goes on by its own clock,
the task is set up again, and that is told.

The kernel counts each period from when it has sent: its SYNC is slow by its own latency, some us a period. That is
measured by what is heard, and taken off the period that it is told (`_Excess`).
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Protocol

from canopen_control.errors import BusError
from canopen_control.master.event_log import Event, Level

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["FollowedSync", "SyncOfAnother"]

_MISSED = 5  # periods without SYNC until it is set up again
_RETRY_NS = 500_000_000
_BLOCK, _BLOCKS = 64, 5  # SYNCs that are judged together, and so often before anything is changed
_MOST_TRIMMED = 20  # this part of a period at most, and _LATENCY_US
_LATENCY_US = 100  # beyond that it is no latency: the machine stands still at times


class Task(Protocol):
    """What sends SYNC; `sender` and `mending` are who it is and what is done where none comes, in words."""

    @property
    def sender(self) -> str: ...

    @property
    def mending(self) -> str: ...

    def start(self, period_us: int) -> None:
        """Send every `period_us`, also when it did already; raise BusError."""

    def adjust(self, period_us: int) -> None:
        """Go on with another period, without a SYNC in between; raise BusError."""

    def close(self) -> None:
        """Send no more."""


class _Excess:
    """By how much the periods between SYNCs are longer than `period_ns`: of what came first in each block.

    A SYNC is seen late or in time, never early, so that the earliest of a block say when it was sent; the least of
    several blocks counts, since a machine that stands still for a moment delays all SYNCs after it.
    """

    __slots__ = ("_before", "_count", "_due", "_least", "_longer", "_period_ns")

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self.restart()

    def restart(self) -> None:
        """Forget what was seen."""
        self._count = self._due = self._least = 0
        self._before: int | None = None
        self._longer: list[int] = []

    def heard(self, now: int) -> int | None:
        """Take a SYNC; return by how many ns a period is too long once that is known, else None."""
        if not self._count:
            self._due = self._least = now
        self._count += 1
        self._least = min(self._least, now - self._due) if self._count % _BLOCK != 1 else now - self._due
        self._due += self._period_ns
        if self._count % _BLOCK:
            return None
        before, self._before = self._before, self._least
        if before is not None:
            self._longer.append((self._least - before) // _BLOCK)
        if len(self._longer) < _BLOCKS:
            return None
        found = min(self._longer)
        self.restart()
        return found


class SyncOfAnother:
    """The SYNC of a node, with which nothing can be done but to listen."""

    sender = "a node of the bus (sync_producer: other)"
    mending = "the cycle goes on by its own clock, and drives that wait for SYNC stand; let a node produce it (0x1005)"

    def start(self, period_us: int) -> None:
        """Do nothing: it is sent already, or will be."""

    def adjust(self, period_us: int) -> None:
        """Do nothing: its clock is its own."""

    def close(self) -> None:
        """Do nothing."""


class FollowedSync:
    """The SYNC of one bus; `lead(now)` is called with every one that is heard, None for a bus that is not followed.

    `count` is how many were heard; `first_wait_ns` is how much later the first one may come: it waits for the boot of
    a node that sends it.
    """

    def __init__(
        self,
        task: Task,
        period_us: int,
        lead: Callable[[int], None] | None,
        report: Callable[[Event], None],
        first_wait_ns: int = 0,
    ) -> None:
        self._task, self._period_us, self._lead, self._report = task, period_us, lead, report
        self._timeout = max(_MISSED * period_us * 1000, _RETRY_NS // 2)
        self.count = 0
        self._deadline, self._first_wait = 0, first_wait_ns
        self._silent = False
        self._excess, self._trimmed_us = _Excess(period_us * 1000), 0

    def start(self, now: int) -> None:
        """Let the kernel begin; raise BusError."""
        self._begin()
        self._deadline = now + self._first_wait + self._timeout

    def heard(self, now: int) -> None:
        """Take a SYNC that came over the bus."""
        self.count += 1
        self._deadline = now + self._timeout
        self._silent = False
        if self._lead is not None:
            self._lead(now)
        if (longer := self._excess.heard(now)) is not None:
            self._trim(round(longer / 1000))

    def _begin(self) -> None:
        self._trimmed_us = 0
        self._excess.restart()
        self._task.start(self._period_us)

    def _trim(self, longer_us: int) -> None:
        """Tell the kernel a period that is shorter by what it adds; it adds, and never takes away."""
        most = min(self._period_us // _MOST_TRIMMED, _LATENCY_US)
        trimmed = max(0, min(most, self._trimmed_us + longer_us))
        if trimmed != self._trimmed_us:
            self._trimmed_us = trimmed
            with contextlib.suppress(BusError):  # what does not come is set up again
                self._task.adjust(self._period_us - trimmed)

    def tick(self, now: int) -> None:
        """Set it up again when it is not heard, every half a second until it is."""
        if now < self._deadline:
            return
        self._deadline = now + _RETRY_NS
        self._task.close()
        why = self._task.mending
        try:
            self._begin()
        except BusError as error:
            why = str(error)
        if not self._silent:
            self._silent = True
            self._report(Event(now, "sync_lost", "", f"no SYNC comes from {self._task.sender}; {why}", Level.WARNING))

    def close(self) -> None:
        """Let the kernel end; a second call does nothing."""
        self._task.close()
