"""Warnings and errors of a robot for people, each cause once.

One failure is told by several events: a drive sends an emergency message, its statusword shows the fault, the group of
its joints is stopped for it. For programs these are three things; a reader wants one line with what, why and the
consequence. The line is made of the clauses of these events, each said once. What has happened several times is one
line with its count and its time span.
"""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from canopen_control.rpc.messages.state import RobotEvent

__all__ = ["tell_causes"]

_TOGETHER_S = 1.0  # what one failure brings forth is told within this time
_LEVELS = ("info", "warning", "error")
_STOPPING = re.compile(r"(stopping [^:]+): (.*)", re.DOTALL)
_WHO = re.compile(r"((?:node \d+ \([^)]*\)|bus \S+ \([^)]*\))): (.*)", re.DOTALL)


class _Cause:
    """What went wrong at one place at one time; `clauses` by what they are recognised by."""

    def __init__(self, who: str, event: RobotEvent, clauses: dict[str, str], stopping: str) -> None:
        self.who, self.level, self.kinds = who, event.level, {event.kind}
        self.since = self.until = event.time
        self.clauses, self.stopping = clauses, stopping
        self.count = 1

    def line(self) -> str:
        """Return the sentence, with level, count and time span."""
        said = "; ".join([*self.clauses.values(), *filter(None, [self.stopping])])
        span = f" ({self.count} times, {_clock(self.since)} to {_clock(self.until)})" if self.count > 1 else ""
        return f"{self.level}: {self.who}{': ' if self.who else ''}{said}{span}"


def tell_causes(events: Iterable[RobotEvent], current: Mapping[str, str]) -> list[str]:
    """Return a line for each cause in `events`; `current`, errors by node as they stand above it, are not retold."""
    folded: list[_Cause] = []
    for cause in _gather(events):
        same = next((each for each in folded if _alike(each, cause)), None)
        if same is None:
            folded.append(cause)
        else:
            same.count, same.until = same.count + 1, cause.until
    for cause in folded:
        if cause.count == 1:
            _leave_out(cause, current)
    return [cause.line() for cause in folded if cause.clauses or cause.stopping]


def _gather(events: Iterable[RobotEvent]) -> list[_Cause]:
    """Put together what was told at one place within a moment and shares a clause."""
    causes: list[_Cause] = []
    told: set[tuple[float, str]] = set()  # each axis of a node tells its loss, in one cycle
    for event in events:
        if event.level == "info" or (event.time, event.text) in told:
            continue
        told.add((event.time, event.text))
        new = _cause_of(event)
        known = next((each for each in reversed(causes) if _belongs(new, each)), None)
        if known is None:
            causes.append(new)
            continue
        known.clauses |= {head: text for head, text in new.clauses.items() if head not in known.clauses}
        known.stopping = known.stopping or new.stopping
        known.level = max(known.level, new.level, key=_LEVELS.index)
        known.kinds |= new.kinds
        known.until = new.until
    return causes


def _cause_of(event: RobotEvent) -> _Cause:
    text, stopping = event.text, ""
    if (stop := _STOPPING.fullmatch(text)) is not None:
        stopping, text = stop[1], stop[2]
    who = ""
    if (place := _WHO.fullmatch(text)) is not None:
        who, text = place[1], place[2]
    return _Cause(who, event, _clauses(text), stopping)


def _clauses(text: str) -> dict[str, str]:
    """Return the clauses of a sentence; of an emergency message it is the code that counts, not its data."""
    clauses = text.removeprefix("lost: ").split("; ")
    return {clause.partition(", register 0x")[0]: clause for clause in clauses}


def _belongs(new: _Cause, known: _Cause) -> bool:
    near = new.since - known.until <= _TOGETHER_S
    other = new.kinds.isdisjoint(known.kinds)  # the same kind anew is another failure
    return near and other and new.who == known.who and not new.clauses.keys().isdisjoint(known.clauses)


def _alike(one: _Cause, other: _Cause) -> bool:
    return (one.who, one.clauses.keys(), one.stopping) == (other.who, other.clauses.keys(), other.stopping)


def _leave_out(cause: _Cause, current: Mapping[str, str]) -> None:
    """Take out of a cause what is said as the error of its node."""
    for error in current.values():
        place = _WHO.fullmatch(error)
        if place is not None and place[1] == cause.who:
            for head in _clauses(place[2]):
                cause.clauses.pop(head, None)


def _clock(seconds: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(seconds))
