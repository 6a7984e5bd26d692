"""Supervision of a node in addition to its heartbeat: overdue PDOs, duplicate node-IDs and EMCY floods.

The monitors only report: they return what is to be reported, once per occasion, and allocate no memory in normal
operation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.master.cycle import ReceivedPdo


_SECOND: Final = 1_000_000_000
_EMCY_PER_SECOND: Final = 10
_WINDOW_PERIODS: Final = 10
_DOUBLE: Final = 16  # heartbeats in ten periods, more than jitter can explain
_FORGET_NS: Final = 10 * _SECOND
_BOOT_UPS_APART_NS: Final = 5_000_000  # less than the time between the boot-ups of a boot-loader and its application
_LONGEST_BEAT_NS: Final = 2 * _SECOND  # maximum interval of boot-ups that are sent like heartbeats
_MAX_RESETS: Final = 8
_RESET_ANSWERED_NS: Final = 3 * _SECOND  # a gateway or an adapter may delay a boot-up by that time
_STUCK: Final = 3  # number of intervals that equal the previous one


class BusReader(Protocol):
    """Owner of a bus port, which reads frames and sets the receive filter."""

    def catch_up(self) -> None:
        """Process all frames waiting at the port."""

    def follow_identifiers(self) -> None:
        """Update the receive filter after the network's `identifiers` have changed."""


class PdoWatch:
    """Monitor of a bus's synchronous and timed TPDOs: counts SYNCs without a response and sets `overdue`.

    For SYNCs that a late process sends in quick succession, the answers still have the time that follows from
    `period_ns`, and at least `min_ns`. `reader` processes waiting frames before a TPDO becomes overdue.
    """

    def __init__(self, period_ns: int = 0) -> None:
        self.reader: BusReader | None = None
        self.min_ns = 0
        self._period = period_ns
        self._pdos: list[ReceivedPdo] = []
        self._changes: list[ReceivedPdo] = []

    def add(self, pdo: ReceivedPdo) -> None:
        """Monitor a TPDO; an event-driven TPDO (`every` 0) without a supervised event timer is ignored."""
        if pdo.every or pdo.timer_silence:
            self._pdos.append(pdo)

    def sync(self, now: int = 0) -> Sequence[ReceivedPdo]:
        """Count a SYNC before its responses arrive; return the TPDOs that became overdue or were received again."""
        changes = self._changes
        if changes:
            changes.clear()
        for pdo in self._pdos:
            if pdo.count != pdo.checked:
                pdo.checked = pdo.count
                if pdo.silent:
                    self._received(pdo)
            elif pdo.expected:
                if not pdo.silent:
                    pdo.since = now
                pdo.silent += 1
                if pdo.silent >= pdo.allowed_silence and not pdo.overdue and self._is_late(pdo, now):
                    pdo.overdue = True
                    changes.append(pdo)
        return changes

    def _received(self, pdo: ReceivedPdo) -> None:
        pdo.silent = 0
        if pdo.overdue:
            pdo.overdue = False
            self._changes.append(pdo)

    def _is_late(self, pdo: ReceivedPdo, now: int) -> bool:
        """Whether a missing TPDO had enough time (allowing half a period of jitter), and does not wait at the port."""
        time = max((2 * pdo.allowed_silence - 3) * self._period // 2, self.min_ns - self._period)
        if now - pdo.since < time:
            return False
        if self.reader is not None:
            self.reader.catch_up()
        if pdo.count == pdo.checked:
            return pdo.expected
        pdo.checked, pdo.silent = pdo.count, 0
        return False


def _is_like(gap: int, other: int) -> bool:
    return 4 * abs(gap - other) < other


class EmcyGate:
    """Limiter of the EMCY messages reported for a node, to ten per second; `held` counts the suppressed messages."""

    def __init__(self) -> None:
        self.held = 0
        self._passed = 0
        self._window = 0

    def passes(self, now: int) -> bool:
        """Whether an EMCY message may be reported; after a suppressed one, False until `summary` returns the count."""
        if now - self._window >= _SECOND and not self.held:
            self._window, self._passed = now, 0
        self._passed += 1
        if self._passed > _EMCY_PER_SECOND:
            self.held += 1
            return False
        return True

    def summary(self, now: int) -> int:
        """Return and clear the number of suppressed messages once the second has ended; return 0 before that."""
        if not self.held or now - self._window < _SECOND:
            return 0
        count, self.held = self.held, 0
        return count

    @property
    def deadline(self) -> int | None:
        """Time from which `summary` returns the number of suppressed messages, or None if none are suppressed."""
        return self._window + _SECOND if self.held else None


class DuplicateWatch:
    """Detector of two devices with the same node-ID: heartbeats at twice the rate, or two boot-ups at once.

    Boot-ups at equal intervals, like a heartbeat, are neither restarts nor a second device: they set `stuck`. Two with
    a pause between them may be those of a boot-loader and its application, which many devices send. A frame was
    received between `since`, when the receive queue was last empty, and `now`: frames that a late process reads
    together show no rate, nor do frames after a silence, because a hub, a gateway or an adapter may have delayed them.
    A report is repeated only after ten seconds without evidence.
    """

    def __init__(self, period_ns: int) -> None:
        self._period = period_ns
        self._window = 0
        self._count = 0
        self._boot_up = -_SECOND
        self._last_evidence = -_FORGET_NS
        self.stuck = False
        """Whether the node repeats its boot-up like a heartbeat (as a LocalNode of canopen 2.4 does after a reset)."""
        self._beat = 0  # time of the last heartbeat
        self._held = 0  # heartbeats that may have been delayed during a silence
        self._resets = 0  # resets that are not answered by a boot-up yet
        self._reset_at: int | None = None  # time of the first frame after the last reset
        self._gap = self._alike = 0  # interval of the last two boot-ups, number of equal intervals

    def set_period(self, period_ns: int) -> None:
        """Set the expected heartbeat period in ns, and restart the detection; unanswered resets remain recorded."""
        self._period = period_ns
        self._window = self._count = self._beat = self._held = self._alike = 0
        self.stuck = False

    def heartbeat(self, now: int, since: int | None = None) -> bool:
        """Record a heartbeat; return True if its rate is new evidence of two devices with the node-ID."""
        self.stuck, self._alike = False, 0
        self._age_resets(now)
        if not self._period:
            return False
        late = (since is not None and now - since >= self._period) or self._was_held(now)
        if late or now - self._window >= _WINDOW_PERIODS * self._period:
            self._window, self._count = now, 0
        # CiA 301, 7.2.8.3.2.2: one heartbeat per producer time; more come from a second device with the node-ID
        self._count += not late
        return self._count >= _DOUBLE and self._is_new(now)

    def _was_held(self, now: int) -> bool:
        """Whether the heartbeat may have been delayed in transmission."""
        gap, self._beat = now - self._beat, now
        if 2 * gap >= 3 * self._period:
            self._held += gap // self._period
        elif 2 * gap >= self._period:
            self._held = 0
        elif self._held:
            self._held -= 1
            return True
        return False

    def reset(self) -> None:
        """Record that a reset was sent to the node, so that the boot-up after it is expected."""
        self._resets = min(self._resets + 1, _MAX_RESETS)
        self._reset_at = None

    def _age_resets(self, now: int) -> None:
        """Discard resets that were not answered in time, counted from the first frame after the last reset."""
        if self._reset_at is None:
            self._reset_at = now
        elif now - self._reset_at > _RESET_ANSWERED_NS:
            self._resets = 0

    def boot_up(self, now: int, since: int | None = None) -> bool:
        """Record a boot-up; return True if its interval is new evidence of two devices with the node-ID."""
        self._age_resets(now)
        expected = self._resets > 0
        self._resets -= expected
        late = since is not None and now - since >= _BOOT_UPS_APART_NS
        gap, before, self._boot_up = now - self._boot_up, self._gap, now
        self._gap = gap
        self._alike = self._alike + 1 if not expected and gap < _LONGEST_BEAT_NS and _is_like(gap, before) else 0
        self.stuck = self._alike >= _STUCK
        # CiA 301, 7.3.2.2.1: one boot-up per initialisation
        close = gap < _BOOT_UPS_APART_NS and not (late or expected or self._alike or _is_like(gap, self._period))
        self._window = self._count = 0
        return close and self._is_new(now)

    def _is_new(self, now: int) -> bool:
        """Record evidence of two devices; return True unless evidence was already recorded in the last ten seconds."""
        before, self._last_evidence = self._last_evidence, now
        return now - before >= _FORGET_NS
