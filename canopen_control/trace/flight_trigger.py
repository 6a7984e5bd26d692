"""When a flight recorder writes: after a fault, once the reaction to it is over, and not at every fault of a storm.

The law of this file. A fault is an event of level error, or one of the kinds that say that a bus carries nothing. The
file is written `AFTER_NS` after the last fault, so that the reaction is in it, but `LONGEST_NS` after the first at the
latest. After a file there is none for `GAP_NS`; as long as faults keep coming the gap doubles up to `WIDEST_GAP_NS`,
so that a storm of a night does not push out the file of its first minute. A fault that is too old for the window when
the gap is over is not written; it is counted in `left_out`.
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
CALM_NS = 300 * SECOND  # after as long without a fault the gap is the shortest again
_KINDS = frozenset({"bus_bus_off", "bus_down", "bus_closed", "bus_lost"})
_NEVER = 1 << 62


def is_fault(event: RobotEvent) -> bool:
    """Whether an event of the API's stream is a reason to write."""
    return event.level == "error" or event.kind in _KINDS


def is_sum(event: RobotEvent) -> bool:
    """Whether an event sums up what was told when it came first."""
    return event.since not in (None, event.time)


class RecordingTrigger:
    """Decides when to write; times in monotonic ns. `keep_ns` is how old a fault may be and still be in the window."""

    def __init__(self, keep_ns: int) -> None:
        self.left_out = 0
        self._keep_ns = keep_ns
        self._reason: RobotEvent | None = None
        self._first = self._last = -_NEVER
        self._not_before = -_NEVER
        self._gap = GAP_NS

    def fault(self, event: RobotEvent, now: int) -> None:
        """Note a fault; the first one since the last file is the reason of the next."""
        if now - self._last >= CALM_NS:
            self._gap = GAP_NS
        if self._reason is not None and now - self._first > self._keep_ns:
            self._reason = None  # held back by the gap for so long that it is not in the window any more
            self.left_out += 1
        if self._reason is None:
            self._reason, self._first = event, now
        self._last = now

    def next_deadline(self) -> int | None:
        """Return when to ask `due` next; None while there is no fault."""
        if self._reason is None:
            return None
        return max(min(self._last + AFTER_NS, self._first + LONGEST_NS), self._not_before)

    def due(self, now: int) -> RobotEvent | None:
        """Return the fault to write a file about, once; None when it is not time."""
        deadline = self.next_deadline()
        if deadline is None or now < deadline:
            return None
        return self._take(now)

    def end(self, now: int) -> RobotEvent | None:
        """Return the fault that nothing was written about yet, since the recording ends now."""
        return None if self._reason is None else self._take(now)

    def _take(self, now: int) -> RobotEvent | None:
        reason, self._reason = self._reason, None
        if now - self._last > self._keep_ns:
            self.left_out += 1
            return None
        self._not_before, self._gap = now + self._gap, min(2 * self._gap, WIDEST_GAP_NS)
        return reason
