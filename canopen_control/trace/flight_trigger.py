"""Trigger of a flight recorder: a file is written after a fault and the reaction to it, at a limited rate.

A fault is an event of level error, or an event that reports a lost bus. The file is written `AFTER_NS` after the last
fault, so that it contains the reaction, but at most `LONGEST_NS` after the first fault. The next file follows `GAP_NS`
later at the earliest; while faults continue, this gap doubles up to `WIDEST_GAP_NS`, so that a series of faults
overnight does not displace the file of its first minute. A fault that is outside of the window at the end of the gap
gets no file, but is counted in `left_out`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_control.rpc.messages.state import RobotEvent


SECOND = 1_000_000_000
AFTER_NS = 3 * SECOND
LONGEST_NS = 10 * SECOND
GAP_NS = 30 * SECOND
WIDEST_GAP_NS = 960 * SECOND
CALM_NS = 300 * SECOND  # after this time without a fault the gap is reset
_KINDS = frozenset({"bus_bus_off", "bus_down", "bus_closed", "bus_lost"})
_NEVER = 1 << 62


def is_fault(event: RobotEvent) -> bool:
    """Whether an event of the API's stream is a fault that triggers a file."""
    return event.level == "error" or event.kind in _KINDS


def is_sum(event: RobotEvent) -> bool:
    """Whether an event summarises earlier events."""
    return event.since not in (None, event.time)


class RecordingTrigger:
    """Trigger for files; times are in monotonic ns, and `keep_ns` is the age at which a fault leaves the window."""

    def __init__(self, keep_ns: int) -> None:
        self.left_out = 0
        self._keep_ns = keep_ns
        self._reason: RobotEvent | None = None
        self._first = self._last = -_NEVER
        self._not_before = -_NEVER
        self._gap = GAP_NS

    def fault(self, event: RobotEvent, now: int) -> None:
        """Record a fault; the first one since the last file is the reason for the next file."""
        if now - self._last >= CALM_NS:
            self._gap = GAP_NS
        if self._reason is not None and now - self._first > self._keep_ns:
            self._reason = None  # the gap delayed it until it was outside the window
            self.left_out += 1
        if self._reason is None:
            self._reason, self._first = event, now
        self._last = now

    def next_deadline(self) -> int | None:
        """Return the time at which `due` must be called, or None without a fault."""
        if self._reason is None:
            return None
        return max(min(self._last + AFTER_NS, self._first + LONGEST_NS), self._not_before)

    def due(self, now: int) -> RobotEvent | None:
        """Return the fault for which a file must be written now, once per file, or None."""
        deadline = self.next_deadline()
        if deadline is None or now < deadline:
            return None
        return self._take(now)

    def end(self, now: int) -> RobotEvent | None:
        """Return the fault that has no file yet at the end of the recording, or None."""
        return None if self._reason is None else self._take(now)

    def _take(self, now: int) -> RobotEvent | None:
        reason, self._reason = self._reason, None
        if now - self._last > self._keep_ns:
            self.left_out += 1
            return None
        self._not_before, self._gap = now + self._gap, min(2 * self._gap, WIDEST_GAP_NS)
        return reason
