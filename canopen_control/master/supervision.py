"""Supervision of a node beside its heartbeat: stale PDOs, duplicate node ids, floods of EMCY.

The law of this file: nothing here acts. Each watch takes what it sees, allocates nothing while all is well, and
returns what is to be told, once per occasion and never faster than the log can bear.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.master.cycle import ReceivedPdo


_SECOND: Final = 1_000_000_000
_EMCY_PER_SECOND: Final = 10
_WINDOW_PERIODS: Final = 10
_DOUBLE: Final = 16  # heartbeats in ten periods: more than jitter explains
_FORGET_NS: Final = 10 * _SECOND
_BOOT_UPS_APART_NS: Final = 100_000_000  # less than any device needs from one boot-up to the next
_LONGEST_BEAT_NS: Final = 2 * _SECOND  # of boot-ups that are sent like heartbeats
_MOST_RESETS: Final = 8
_RESET_ANSWERED_NS: Final = 3 * _SECOND  # a gateway or an adapter may hold a boot-up up for that long
_STUCK: Final = 3  # distances as long as the one before


class BusReader(Protocol):
    """What reads the channel of a network."""

    def catch_up(self) -> None:
        """Read all that waits."""

    def follow_identifiers(self) -> None:
        """Take that the network's `identifiers` have changed."""


class PdoWatch:
    """Counts the SYNCs that the synchronous TPDOs of a bus let pass; sets `overdue` of those that stay away.

    SYNCs that a late process sends close together count as one: their answers have the time that `period_ns` apart
    would give them, and `least_ns` at least. `reader` reads what waits before anything is overdue.
    """

    def __init__(self, period_ns: int = 0) -> None:
        self.reader: BusReader | None = None
        self.least_ns = 0
        self._period = period_ns
        self._pdos: list[ReceivedPdo] = []
        self._changes: list[ReceivedPdo] = []

    def add(self, pdo: ReceivedPdo) -> None:
        """Watch a TPDO; one that is not sent with SYNCs (`every` 0) is not."""
        if pdo.every:
            self._pdos.append(pdo)

    def sync(self, now: int = 0) -> Sequence[ReceivedPdo]:
        """Count a SYNC that nothing can have answered yet; return the TPDOs that became overdue, or came back."""
        changes = self._changes
        if changes:
            changes.clear()
        for pdo in self._pdos:
            if pdo.count != pdo.checked:
                pdo.checked = pdo.count
                if pdo.silent:
                    self._came(pdo)
            elif pdo.expected:
                if not pdo.silent:
                    pdo.since = now
                pdo.silent += 1
                if pdo.silent >= pdo.allowed_silence and not pdo.overdue and self._is_late(pdo, now):
                    pdo.overdue = True
                    changes.append(pdo)
        return changes

    def _came(self, pdo: ReceivedPdo) -> None:
        pdo.silent = 0
        if pdo.overdue:
            pdo.overdue = False
            self._changes.append(pdo)

    def _is_late(self, pdo: ReceivedPdo, now: int) -> bool:
        """Whether an answer had its time and does not wait to be read; half a period for the jitter of SYNC."""
        time = max((2 * pdo.allowed_silence - 3) * self._period // 2, self.least_ns - self._period)
        if now - pdo.since < time:
            return False
        if self.reader is not None:
            self.reader.catch_up()
        if pdo.count == pdo.checked:
            return pdo.expected
        pdo.checked, pdo.silent = pdo.count, 0
        return False


def _is_like(gap: int, other: int) -> bool:
    """Whether two distances in time are the same but for jitter."""
    return 4 * abs(gap - other) < other


class EmcyGate:
    """Lets a node's emergencies through to the log, ten a second; `held` counts those that were kept back."""

    def __init__(self) -> None:
        self.held = 0
        self._passed = 0
        self._window = 0

    def passes(self, now: int) -> bool:
        """Whether the next message may be told; what was held is told first."""
        if now - self._window >= _SECOND and not self.held:
            self._window, self._passed = now, 0
        self._passed += 1
        if self._passed > _EMCY_PER_SECOND:
            self.held += 1
            return False
        return True

    def summary(self, now: int) -> int:
        """Return how many were kept back, once the second is over; 0 for nothing to tell."""
        if not self.held or now - self._window < _SECOND:
            return 0
        held, self.held = self.held, 0
        return held

    @property
    def deadline(self) -> int | None:
        """When `summary` has something to tell."""
        return self._window + _SECOND if self.held else None


class DuplicateWatch:
    """Tells that two devices share a node id: heartbeats at twice the rate, or two boot-ups at once.

    Boot-ups at equal distances, as from a heartbeat, are no restarts and no second device: `stuck` is set for them. A
    frame came between `since`, when none waited to be read, and `now`: what a late process reads in one go says nothing
    of a rate, nor what comes in one go after a silence, since a hub, a gateway or an adapter may have held it up. It is
    told again when for ten seconds nothing looked like it.
    """

    def __init__(self, period_ns: int) -> None:
        self._period = period_ns
        self._window = 0
        self._count = 0
        self._boot_up = -_SECOND
        self._sign = -_FORGET_NS
        self.stuck = False
        """Whether the node sends its boot-up as others send heartbeats (a LocalNode of canopen 2.4 after a reset)."""
        self._beat = 0  # the last heartbeat
        self._held = 0  # heartbeats that a silence may have kept back
        self._resets = 0  # that were sent and are not answered by a boot-up yet
        self._reset_at: int | None = None  # when the first frame came after the last of them
        self._gap = self._alike = 0  # between the last two boot-ups, and how many gaps in a row were as long

    def set_period(self, period_ns: int) -> None:
        """Count heartbeats of another period; resets that were sent still wait for their boot-ups."""
        self._period = period_ns
        self._window = self._count = self._beat = self._held = self._alike = 0
        self.stuck = False

    def heartbeat(self, now: int, since: int | None = None) -> bool:
        """Count a heartbeat; True when it shows that two devices share the node id."""
        self.stuck, self._alike = False, 0
        self._age_resets(now)
        if not self._period:
            return False
        late = (since is not None and now - since >= self._period) or self._was_held(now)
        if late or now - self._window >= _WINDOW_PERIODS * self._period:
            self._window, self._count = now, 0
        self._count += not late
        return self._count >= _DOUBLE and self._is_new(now)

    def _was_held(self, now: int) -> bool:
        """Whether a heartbeat may be one of those that did not come before, while something on the way stood still."""
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
        """Take that a reset is sent to the node, which answers by a boot-up, however many wait on the way."""
        self._resets = min(self._resets + 1, _MOST_RESETS)
        self._reset_at = None

    def _age_resets(self, now: int) -> None:
        """Forget resets that were not answered in time; a heartbeat after one may have been sent before it."""
        if self._reset_at is None:
            self._reset_at = now
        elif now - self._reset_at > _RESET_ANSWERED_NS:
            self._resets = 0

    def boot_up(self, now: int, since: int | None = None) -> bool:
        """Take a boot-up; True when another one came too shortly before, and fewer resets were sent."""
        self._age_resets(now)
        asked = self._resets > 0
        self._resets -= asked
        late = since is not None and now - since >= _BOOT_UPS_APART_NS
        gap, before, self._boot_up = now - self._boot_up, self._gap, now
        self._gap = gap
        self._alike = self._alike + 1 if not asked and gap < _LONGEST_BEAT_NS and _is_like(gap, before) else 0
        self.stuck = self._alike >= _STUCK
        close = gap < _BOOT_UPS_APART_NS and not (late or asked or self._alike or _is_like(gap, self._period))
        self._window = self._count = 0
        return close and self._is_new(now)

    def _is_new(self, now: int) -> bool:
        """Take a sign; whether the last one is long gone."""
        before, self._sign = self._sign, now
        return now - before >= _FORGET_NS
