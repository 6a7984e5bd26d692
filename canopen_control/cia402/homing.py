"""Homing (CiA 402-2, mode HM): the methods of 0x6098, and the homing sequence.

Rules:

- Bits 13, 12 and 10 of the statusword together are the phase of homing (`HomingStatus`). Before the start they may
  still belong to the last homing, or to another mode: "attained" and "error" count only after they were absent.
- A method without motion may end between two statuswords. Only for such a method is an old "attained" accepted, a few
  updates after the start.
- Some drives never set bit 10 (JVL MIS): homing ends when "attained" is set and the axis has stood still for a second.
- Some drives keep "attained" until they leave OPERATION_ENABLED (aidin_hand2): their next homing is detected only after
  they have left this state.
- The new zero may reach the master after "attained": the position has another TPDO, and some drives update it later. A
  success counts only when the position has not changed for `_SETTLED_NS` and `_SETTLED_FRAMES` TPDOs, since a set-point
  in the old coordinates would make the axis jump. A position that is not near the home offset (0x607C) is probably the
  old one, and has `_ZERO_NS` to change.
- Every exit returns bit 4 to 0: success, error, interruption, abort and timeout. Only success sets `homed`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.cia402.units import wrap_int32
from canopen_control.errors import DriveError

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping


_NEVER = 1 << 63
_SECOND = 1_000_000_000
_START = 1 << 4

_WITH_INDEX = {
    1: "negative limit switch",
    2: "positive limit switch",
    3: "positive home switch, negative side",
    4: "positive home switch, positive side",
    5: "negative home switch, positive side",
    6: "negative home switch, negative side",
    7: "home switch, start positive, before its rising edge",
    8: "home switch, start positive, after its rising edge",
    9: "home switch, start positive, before its falling edge",
    10: "home switch, start positive, after its falling edge",
    11: "home switch, start negative, before its rising edge",
    12: "home switch, start negative, after its rising edge",
    13: "home switch, start negative, before its falling edge",
    14: "home switch, start negative, after its falling edge",
}
METHODS: Mapping[int, str] = MappingProxyType(
    {
        0: "no homing",
        **{method: f"{text}, and index pulse" for method, text in _WITH_INDEX.items()},
        **{method + 16: text for method, text in _WITH_INDEX.items()},
        33: "next index pulse, negative direction",
        34: "next index pulse, positive direction",
        35: "the present position (older profile)",
        37: "the present position",
    }
)
"""Homing methods of CiA 402-2 with descriptions; negative methods are manufacturer-specific, others reserved."""

METHODS_WITHOUT_MOTION = frozenset({35, 37})


def require_method(method: int, supported: Collection[int] | None = None) -> None:
    """Raise DriveError for a homing method that is not in `supported` (0x60E3; None: all but the reserved ones)."""
    # CiA 402-2, 0x6098: negative methods are the manufacturer's; 0x60E3 lists the supported ones
    if method in supported if supported is not None else method in METHODS or method < 0:
        return
    listed = f"0x60E3 lists {', '.join(map(str, sorted(supported)))}" if supported is not None else "it is reserved"
    raise DriveError(f"homing method {method} ({METHODS.get(method, 'unknown')}) is not supported: {listed}")


class HomingStatus(Enum):
    """Phase of homing in bits 13 (error), 12 (attained) and 10 (reached) of the statusword."""

    IN_PROGRESS = 0b000
    NOT_RUNNING = 0b001  # interrupted, or not started
    ATTAINED = 0b010  # the target is not reached yet
    COMPLETED = 0b011
    ERROR_MOVING = 0b100
    ERROR_STOPPED = 0b101
    RESERVED_6 = 0b110
    RESERVED_7 = 0b111


_STATUS = tuple(HomingStatus)
_RUNNING = (HomingStatus.IN_PROGRESS, HomingStatus.ATTAINED)
_STANDING = _SECOND  # standstill after which "attained" without bit 10 (target reached) is the end
_SETTLED_NS = _SECOND // 5
_SETTLED_FRAMES = 2
_LONGEST_SETTLING = 5 * _SECOND
_ZERO_NS = 2 * _SECOND
_LATE = "not done in time; `homing_timeout_seconds` in bus.yml allows more time"
_UNSEEN = (
    "the drive did not start it in time; check in its manual that it supports this method and sets bit 12 (homing "
    "attained)"
)
_LATCHED = (
    "not done in time: bit 12 (homing attained) was 1 before the start, so the end cannot be detected; disable and "
    "enable the drive and home again, or set `switching_state: 4` in bus.yml, so that it leaves OPERATION_ENABLED "
    "before homing"
)
_ENDED = (HomingStatus.NOT_RUNNING, HomingStatus.COMPLETED)


def homing_status(statusword: int) -> HomingStatus:
    """Return the homing status in bits 13, 12 and 10 of a statusword; valid only in mode HM."""
    # CiA 402-2, 0x6041 in mode HM: bit 13 homing error, bit 12 homing attained, bit 10 target reached
    return _STATUS[statusword >> 11 & 0b110 | statusword >> 10 & 0b001]


@dataclass(frozen=True, slots=True)
class HomingDone:
    """Successful homing."""

    time: int
    method: int

    @property
    def text(self) -> str:
        return f"homed by method {self.method}"


@dataclass(frozen=True, slots=True)
class HomingFailed:
    """Failed homing; `status` is the last received status, None if no statusword was received."""

    time: int
    method: int
    status: HomingStatus | None
    reason: str

    @property
    def text(self) -> str:
        return f"homing by method {self.method} failed: {self.reason}"


HomingEvent = HomingDone | HomingFailed


class _Phase(Enum):
    IDLE = 0
    PREPARE = 1  # bit 4 is 0, and the old bits are evaluated
    RUN = 2
    SETTLE = 3  # homing has ended; the position may still change to the new zero


class HomingPosition(NamedTuple):
    """Position of the axis in counts, and the number of TPDOs received with it."""

    counts: int
    received: int


class HomingSequence:
    """Homing sequence, one run at a time; write the result of `update` to `DriveMachine.mode_bits`.

    The caller sets 0x6098, the speeds and the mode, and restores the previous mode. `homed` is False from `start` until
    success, and after `forget`. `start_timeout_ns` limits the time until homing is seen in progress, `timeout_ns` the
    whole homing; `settle_updates` is the number of updates for which ambiguous bits must be stable. Changes of the
    position by at most `tolerance` counts are ignored. `home_offset` is 0x607C, in counts; a position is near it within
    `near` counts, because the drive may need a way to stop.
    """

    def __init__(
        self,
        *,
        timeout_ns: int = 10 * _SECOND,
        start_timeout_ns: int = _SECOND,
        settle_updates: int = 3,
        tolerance: int = 0,
        near: int = 1 << 32,
    ) -> None:
        self.method = self.home_offset = 0
        self.homed = False
        self._timeout, self._start_timeout = timeout_ns, start_timeout_ns
        self._settle_updates = settle_updates
        self._tolerance, self._near = tolerance, near
        self._settled_from: HomingPosition | None = None  # the last changed position, received at `_settled_since`
        self._settled_since = 0
        self._phase = _Phase.IDLE
        self._aborted = ""
        self._updates = 0
        self._stopped_updates = 0
        self._attained_absent = self._error_absent = self._ran = False
        self._deadline = self._start_deadline = self._zero_by = _NEVER
        self._standing_since: int | None = None  # time since "homing attained" is set while bit 10 is 0
        self._events: list[HomingEvent] = []

    def start(self, method: int) -> None:
        """Start homing with `method`, the value in 0x6098, unless homing is in progress."""
        if self._phase is _Phase.IDLE:
            self.method, self.homed = method, False
            self._phase = _Phase.PREPARE
            self._updates = self._stopped_updates = 0
            self._attained_absent = self._error_absent = self._ran = False
            self._standing_since = self._settled_from = None

    def abort(self, reason: str = "aborted") -> None:
        """Abort homing at the next update with bit 4 = 0, so that the drive stops as 0x605D defines."""
        if self.active:
            self._aborted = reason

    def forget(self) -> None:
        """Clear `homed` because the drive has lost its home position in a restart or a position jump."""
        self.homed = False

    @property
    def active(self) -> bool:
        return self._phase is not _Phase.IDLE

    def events(self) -> list[HomingEvent]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def next_deadline(self) -> int | None:
        """Return the time in ns by which `update` must be called again, or None if no timeout is running."""
        earliest = min(self._deadline, self._start_deadline)
        return None if earliest == _NEVER else earliest

    def update(
        self,
        statusword: int | None,
        ready: bool,
        now: int,
        *,
        standing: bool = False,
        position: HomingPosition | None = None,
    ) -> int:
        """Return bit 4 of the controlword to send.

        Call once per cycle; this method never raises an exception. `ready` is True if the drive is enabled in mode HM;
        otherwise homing fails. `standing` is True if the axis is known to stand still, `position` None if unknown.
        """
        if self._phase is _Phase.IDLE:
            return 0
        status = None if statusword is None else homing_status(statusword)
        if self._aborted or status is None or not ready:
            return self._fail(self._aborted or "the drive is not enabled in mode HM", status, now)
        if self._phase is _Phase.SETTLE:
            return self._settle(position, now)
        if self._deadline == _NEVER:
            self._deadline = now + self._timeout
        if now >= self._deadline:
            return self._fail(_LATE if self._attained_absent else _LATCHED, status, now)
        self._updates += 1
        if self._phase is _Phase.PREPARE:
            return self._prepare(status, now)
        return self._run(status, now, standing, position)

    def _prepare(self, status: HomingStatus, now: int) -> int:
        """Record bits 12 and 13 for some updates before the start, because the first may belong to another mode."""
        # CiA 402-2, 0x6040 in mode HM: homing starts with the rising edge of bit 4
        if self._updates <= self._settle_updates:
            self._attained_absent = not status.value & HomingStatus.ATTAINED.value
            self._error_absent = not status.value & HomingStatus.ERROR_MOVING.value
            return 0
        self._phase = _Phase.RUN
        self._updates = 0
        self._start_deadline = now + self._start_timeout
        return _START

    def _run(self, status: HomingStatus, now: int, standing: bool, position: HomingPosition | None) -> int:
        self._attained_absent |= not status.value & HomingStatus.ATTAINED.value
        self._error_absent |= not status.value & HomingStatus.ERROR_MOVING.value
        if status in _RUNNING:
            self._ran = True
            self._start_deadline = _NEVER
        self._stopped_updates = self._stopped_updates + 1 if status in _ENDED else 0
        if status is HomingStatus.COMPLETED and self._is_believable():
            return self._begin_settling(position, now)
        # JVL MIS (ros2_canopen, issue 245): bit 10 is never set
        if status is not HomingStatus.ATTAINED or not self._attained_absent or not standing:
            self._standing_since = None
        elif self._standing_since is None:
            self._standing_since = now
        elif now - self._standing_since >= _STANDING:
            return self._begin_settling(position, now)
        # CiA 402-2, 0x6041 in mode HM: bit 13 (homing error)
        if self._error_absent and status.value & HomingStatus.ERROR_MOVING.value:
            return self._fail("the drive reports a homing error", status, now)
        # CiA 402-2, 0x6041 in mode HM: bits 13, 12, 10 = 001, homing interrupted or not started
        if self._ran and status is HomingStatus.NOT_RUNNING and self._stopped_updates > self._settle_updates:
            return self._fail("the drive interrupted it", status, now)
        if now >= self._start_deadline:
            return self._fail(_UNSEEN, status, now)
        return _START

    def _is_believable(self) -> bool:
        if self._attained_absent:
            return True
        # CiA 402-2, 0x6098: methods 35 and 37 take the present position, so that no motion is seen
        return self.method in METHODS_WITHOUT_MOTION and self._stopped_updates > self._settle_updates

    def _begin_settling(self, position: HomingPosition | None, now: int) -> int:
        self._phase = _Phase.SETTLE
        self._start_deadline, self._deadline = _NEVER, now + _LONGEST_SETTLING
        self._zero_by = now + _ZERO_NS
        return self._settle(position, now)

    def _settle(self, position: HomingPosition | None, now: int) -> int:
        """Finish when the position has settled; a position that keeps changing, or is unknown, is not waited for."""
        before = self._settled_from
        # CiA 301, 7.5.2.37: 0x6064 may come on every n-th SYNC only, after the statusword; ODrive, pull request 710:
        # the position is updated some time after the end of homing
        if position is None or now >= self._deadline:
            return self._finish(now)
        if before is None or abs(wrap_int32(position.counts - before.counts)) > self._tolerance:
            self._settled_from, self._settled_since = position, now
        elif now - self._settled_since >= _SETTLED_NS and position.received - before.received >= _SETTLED_FRAMES:
            # CiA 402-2, 0x607C: after homing the position is the home offset; in older drives its negative
            ways = (abs(wrap_int32(position.counts - home)) for home in (self.home_offset, -self.home_offset))
            if now >= self._zero_by or min(ways) <= self._near:
                return self._finish(now)
        return _START

    def _finish(self, now: int) -> int:
        self.homed = True
        self._events.append(HomingDone(now, self.method))
        return self._end()

    def _fail(self, reason: str, status: HomingStatus | None, now: int) -> int:
        self._events.append(HomingFailed(now, self.method, status, reason))
        return self._end()

    def _end(self) -> int:
        self._phase = _Phase.IDLE
        self._aborted = ""
        self._deadline = self._start_deadline = _NEVER
        return 0
