"""The set-point handshake of profile position mode (CiA 402-2, 0x6040 and 0x6041 in mode PP).

Rules:

- A set-point is taken on the rising edge of controlword bit 4, and only a bit 12 that rises after that edge is its
  acknowledgement. So bit 12 is seen 0 first, the target is out one update before the edge, and bit 4 falls when bit 12
  has risen.
- Bit 10 shows the previous target until the drive works on the new one. It counts when bit 12 has fallen again and bit
  10 was seen 0 since the acknowledgement, or some updates later, since a short move may pass unseen.
- A drive may take no set-point while it is under way to the one before (ZLTECH ZLAC8015D). One that interrupted a
  motion and is not acknowledged waits for the end of that motion, and is given once more.
- Each phase has its time, and on every way out bit 4 is 0. What then happens to the motion is the owner's decision.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from canopen_control.cia402.state import TARGET_REACHED
from canopen_control.errors import LocalProtocolError

_NEVER = 1 << 63
_SECOND = 1_000_000_000
_NEW_SET_POINT = 1 << 4
_IMMEDIATELY = 1 << 5
_RELATIVE = 1 << 6
_CHANGE_ON_SET_POINT = 1 << 9
_ACKNOWLEDGED = 1 << 12
_FOLLOWING_ERROR = 1 << 13


class SetPoint(NamedTuple):
    """One target in device units, with bits 5, 6 and 9 of the controlword."""

    target: int
    bits: int = 0


@dataclass(frozen=True, slots=True)
class SetPointTaken:
    """Acknowledged set-point."""

    time: int
    target: int

    @property
    def text(self) -> str:
        """Sentence for users."""
        return f"set-point {self.target} taken"


@dataclass(frozen=True, slots=True)
class SetPointReached:
    """Reached set-point, the last one acknowledged; bit 11 of `statusword` shows whether it was limited."""

    time: int
    target: int
    statusword: int

    @property
    def text(self) -> str:
        """Sentence for users."""
        return f"set-point {self.target} reached"


@dataclass(frozen=True, slots=True)
class SetPointFailed:
    """Abandoned set-point; `reason` is the cause, `phase` its phase."""

    time: int
    target: int
    phase: SetPointPhase
    reason: str

    @property
    def text(self) -> str:
        """Sentence for users."""
        return f"set-point {self.target} given up: {self.reason}"


@dataclass(frozen=True, slots=True)
class SetPointDeferred:
    """Set-point not acknowledged during the motion to the previous one; it is repeated at the end of that motion."""

    time: int
    target: int

    @property
    def text(self) -> str:
        """Sentence for users."""
        return (
            f"set-point {self.target} not acknowledged on the way to another one; given again when the drive is there"
        )


@dataclass(frozen=True, slots=True)
class FollowingError:
    """Following error (bit 13), reported once per set-point; the drive's reaction is its own."""

    time: int
    target: int
    statusword: int

    @property
    def text(self) -> str:
        """Sentence for users."""
        return f"following error on the way to {self.target} (statusword 0x{self.statusword:04X})"


SetPointEvent = SetPointTaken | SetPointReached | SetPointFailed | SetPointDeferred | FollowingError


class SetPointPhase(Enum):
    """Phase of a set-point; the value describes a timeout in it."""

    IDLE = "nothing to do"
    LOW = "the acknowledge bit 12 stays 1 before the set-point"
    ACKNOWLEDGE = "the set-point was not acknowledged"
    RELEASE = "the acknowledge bit 12 stays 1 after the set-point"
    MOVING = "the target was not reached in time"
    DEFERRED = "waits for the end of the motion before"


_P = SetPointPhase


class SetPointHandshake:
    """The set-points of one axis, one after the other.

    Write `target` to 0x607A (None: none was given yet) in the same cycle as the bits that `update` returns, and the
    bits to `DriveMachine.mode_bits`. One more set-point may wait while the drive takes or reaches the one before; it is
    offered as soon as bit 12 is 0, and whether the drive finishes the first one is its affair and that of
    `immediately`. Only the last one is reported as reached. `release_timeout_ns` must be as long as a motion for drives
    that keep bit 12 while they move; `motion_timeout_ns` None leaves the motion its time.
    """

    def __init__(
        self,
        *,
        low_timeout_ns: int = 5 * _SECOND,
        acknowledge_timeout_ns: int = _SECOND,
        release_timeout_ns: int = 60 * _SECOND,
        motion_timeout_ns: int | None = None,
        settle_updates: int = 3,
    ) -> None:
        self.target: int | None = None
        self.phase = SetPointPhase.IDLE
        self._timeouts = {
            _P.LOW: low_timeout_ns,
            _P.ACKNOWLEDGE: acknowledge_timeout_ns,
            _P.RELEASE: release_timeout_ns,
            _P.MOVING: motion_timeout_ns,
            _P.DEFERRED: motion_timeout_ns,
        }
        self._settle_updates = settle_updates
        self._current = SetPoint(0)
        self._next: SetPoint | None = None
        self._aborted = ""
        self._bits = 0
        self._deadline = _NEVER
        self._updates = 0  # in this phase
        self._moved = False
        self._interrupts = False  # a motion that was under way when the set-point was given
        self._lagged = False
        self._events: list[SetPointEvent] = []

    def move(
        self, target: int, *, relative: bool = False, immediately: bool = False, change_on_set_point: bool = False
    ) -> None:
        """Send a set-point in device units; `immediately` interrupts the motion and replaces a waiting set-point.

        Raises LocalProtocolError when one waits already, see `can_take`.
        """
        if not (self.can_take or immediately):
            raise LocalProtocolError(f"set-point {target}: one is waiting already; wait until the drive took it")
        bits = _IMMEDIATELY * immediately | _RELATIVE * relative | _CHANGE_ON_SET_POINT * change_on_set_point
        self._next = SetPoint(target, bits)

    def abort(self, reason: str = "aborted") -> None:
        """Abort the active and the waiting set-point at the next update; bit 4 is 0 from then on."""
        if self.busy:
            self._aborted = reason

    @property
    def can_take(self) -> bool:
        """Whether `move` accepts another set-point."""
        return self._next is None

    @property
    def busy(self) -> bool:
        """Whether a set-point waits to be acknowledged or reached."""
        return self.phase is not SetPointPhase.IDLE or self._next is not None

    def events(self) -> list[SetPointEvent]:
        """Return the events since the last call."""
        happened, self._events = self._events, []
        return happened

    def next_deadline(self) -> int | None:
        """Return the latest time for the next call of `update`, None without a timeout."""
        return None if self._deadline == _NEVER else self._deadline

    def update(
        self, statusword: int | None, ready: bool, now: int, halted: bool = False, under_way: bool = False
    ) -> int:
        """Return controlword bits 4, 5, 6 and 9 to send. Call it once per cycle; it never raises.

        `ready`: the drive is enabled in mode PP; without that a set-point is given up. While `halted` the drive keeps
        its target and bit 10 means standstill: nothing is judged, no time runs out. `under_way`: the axis is seen
        moving far from its target; bit 10, which flickers in some drives (yarp-devices, issue 245), does not count.
        """
        if self.phase is SetPointPhase.IDLE and self._next is None:
            return 0
        if self._aborted or not ready or statusword is None:
            return self._give_up(self._aborted or "the drive is not enabled in mode PP", now)
        # CiA 402-2, 0x6041 in mode PP: with halt, bit 10 means velocity 0
        if halted:
            self._deadline = _NEVER
            return self._bits
        self._proceed(statusword & ~TARGET_REACHED if under_way else statusword, now)
        if self._deadline == _NEVER:
            self._arm(now)
        elif now >= self._deadline:
            if self.phase is not SetPointPhase.ACKNOWLEDGE or not self._interrupts:
                return self._give_up(self.phase.value, now)
            self._events.append(SetPointDeferred(now, self._current.target))
            self._go(SetPointPhase.DEFERRED)
        return self._bits

    def _arm(self, now: int) -> None:
        timeout = self._timeouts.get(self.phase)
        self._deadline = _NEVER if timeout is None else now + timeout

    def _go(self, phase: SetPointPhase, bits: int = 0) -> None:
        if phase is SetPointPhase.IDLE:
            self._interrupts = False
        self.phase, self._bits = phase, bits
        self._deadline = _NEVER
        self._updates = 0

    def _proceed(self, statusword: int, now: int) -> None:
        if self._next is not None and self.phase in (SetPointPhase.IDLE, SetPointPhase.MOVING):
            self._interrupts = self.phase is SetPointPhase.MOVING
            self._begin(self._next)
        acknowledged = bool(statusword & _ACKNOWLEDGED)
        if self.phase is SetPointPhase.LOW:
            # CiA 402-2, 0x6040 in mode PP: bit 4 may rise only while bit 12 of the statusword is 0
            if not acknowledged and self._updates:
                self._go(SetPointPhase.ACKNOWLEDGE, _NEW_SET_POINT | self._current.bits)
        elif self.phase is SetPointPhase.ACKNOWLEDGE:
            # CiA 402-2, 0x6041 in mode PP: bit 12 acknowledges the set-point; then bit 4 returns to 0
            if acknowledged:
                self._go(SetPointPhase.RELEASE)
                self._interrupts = False
                self._moved = self._lagged = False
                self._events.append(SetPointTaken(now, self._current.target))
        elif self.phase is SetPointPhase.DEFERRED:
            if not statusword & TARGET_REACHED:
                self._updates = 0
            elif self._updates >= self._settle_updates:
                self._interrupts = False
                self._begin(self._next or self._current)
        else:
            self._follow(statusword, acknowledged, now)
        self._updates += 1

    def _begin(self, set_point: SetPoint) -> None:
        self._current, self._next = set_point, None
        self.target = set_point.target
        self._go(SetPointPhase.LOW)

    def _follow(self, statusword: int, acknowledged: bool, now: int) -> None:
        reached = bool(statusword & TARGET_REACHED)
        self._moved = self._moved or not reached
        # CiA 402-2, 0x6041 in mode PP: bit 13 (following error)
        if statusword & _FOLLOWING_ERROR and not self._lagged:
            self._lagged = True
            self._events.append(FollowingError(now, self._current.target, statusword))
        if self.phase is SetPointPhase.RELEASE:
            # CiA 402-2, 0x6041 in mode PP: bit 12 stays 1 while the buffer of set-points is full
            if acknowledged:
                return
            self._go(SetPointPhase.MOVING)
        # CiA 402-2, 0x6041 in mode PP: bit 10 (target reached); the old target's 1 may still be shown
        if reached and not acknowledged and (self._moved or self._updates >= self._settle_updates):
            self._go(SetPointPhase.IDLE)
            self._events.append(SetPointReached(now, self._current.target, statusword))

    def _give_up(self, reason: str, now: int) -> int:
        if self.phase is not SetPointPhase.IDLE:
            self._events.append(SetPointFailed(now, self._current.target, self.phase, reason))
        if self._next is not None:
            self._events.append(SetPointFailed(now, self._next.target, SetPointPhase.IDLE, reason))
        self._next, self._aborted = None, ""
        self._go(SetPointPhase.IDLE)
        return 0
