"""Set-point handshake of profile position mode (CiA 402-2, 0x6040 and 0x6041 in mode PP).

Rules:

- The drive accepts a set-point on the rising edge of controlword bit 4, and only a bit 12 that rises after this edge is
  its acknowledgement. So bit 12 must be 0 first, the target is sent one update before the edge, and bit 4 returns to 0
  when bit 12 is 1.
- Some drives show bit 12 from their enabling on, and clear it only after bit 4 has risen and fallen (canopen, issue
  678). A bit 12 that stays 1 without a motion is cleared by such a pulse, once, with the actual position as its target,
  so that the pulse moves nothing.
- Bit 10 belongs to the previous target until the drive uses the new one. It counts when bit 12 is 0 again and bit 10
  was 0 after the acknowledgement, or some updates later, because a short motion may pass unseen.
- Some drives accept no set-point while they move to the previous one (ZLTECH ZLAC8015D). A set-point that interrupted a
  motion and is not acknowledged waits for the end of that motion, and is sent once more.
- Each phase has a timeout, and at every exit bit 4 is 0. The caller decides what then happens to the motion. A bit 12
  that stays 1 for some seconds at the target is not cleared any more, so that its long timeout is not waited for.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from canopen_control.cia402.state import TARGET_REACHED
from canopen_control.errors import LocalProtocolError

_NEVER = 1 << 63
_SECOND = 1_000_000_000
_RESTS_NS = 3 * _SECOND
_SHOWN_NS = _SECOND // 2  # time of a bit 12 without a set-point after which a pulse of bit 4 clears it
_PULSE = 3  # updates with bit 4 in such a pulse
_NEW_SET_POINT = 1 << 4
_IMMEDIATELY = 1 << 5
_RELATIVE = 1 << 6
_CHANGE_ON_SET_POINT = 1 << 9
_ACKNOWLEDGED = 1 << 12
_FOLLOWING_ERROR = 1 << 13


class SetPoint(NamedTuple):
    """Target in device units, with bits 5, 6 and 9 of the controlword."""

    target: int
    bits: int = 0


@dataclass(frozen=True, slots=True)
class SetPointTaken:
    """Acknowledgement of a set-point by bit 12 of the statusword."""

    time: int
    target: int

    @property
    def text(self) -> str:
        return f"set-point {self.target} acknowledged"


@dataclass(frozen=True, slots=True)
class SetPointReached:
    """Arrival at the last acknowledged set-point; bit 11 of `statusword` shows whether the target was limited."""

    time: int
    target: int
    statusword: int

    @property
    def text(self) -> str:
        return f"set-point {self.target} reached"


@dataclass(frozen=True, slots=True)
class SetPointFailed:
    """Abandoned set-point, with the reason and the phase in which the handshake ended."""

    time: int
    target: int
    phase: SetPointPhase
    reason: str

    @property
    def text(self) -> str:
        return f"set-point {self.target} abandoned: {self.reason}"


@dataclass(frozen=True, slots=True)
class SetPointDeferred:
    """Set-point that was not acknowledged during a motion, and is repeated when the motion has ended."""

    time: int
    target: int

    @property
    def text(self) -> str:
        return f"set-point {self.target} not acknowledged during a motion; sent again when the motion has ended"


@dataclass(frozen=True, slots=True)
class FollowingError:
    """Following error (bit 13), reported once per set-point; the reaction is left to the drive."""

    time: int
    target: int
    statusword: int

    @property
    def text(self) -> str:
        return f"following error on the way to {self.target} (statusword 0x{self.statusword:04X})"


SetPointEvent = SetPointTaken | SetPointReached | SetPointFailed | SetPointDeferred | FollowingError


class SetPointPhase(Enum):
    """Phase of a set-point; each value describes a timeout in the phase."""

    IDLE = "no set-point is active"
    LOW = "bit 12 (set-point acknowledged) of the statusword stayed 1 before the set-point"
    CLEAR = "bit 12 (set-point acknowledged) of the statusword is being cleared before the set-point"
    ACKNOWLEDGE = "the set-point was not acknowledged (bit 12 of the statusword)"
    RELEASE = "bit 12 (set-point acknowledged) of the statusword stayed 1 after the set-point"
    MOVING = "the target was not reached in time"
    DEFERRED = "the previous motion did not end in time"


_P = SetPointPhase


class SetPointHandshake:
    """Handshake of profile position mode for one axis.

    Write `target` to 0x607A (None: no set-point yet) in the same cycle as the bits that `update` returns, and the bits
    to `DriveMachine.mode_bits`. One further set-point may wait while the drive acknowledges or approaches the present
    one; it is sent as soon as bit 12 is 0, and `immediately` and the drive determine whether it ends the first motion.
    Only the last set-point is reported as reached. `release_timeout_ns` must be as long as a motion for drives that
    keep bit 12 during the motion; with `motion_timeout_ns` None a motion has no timeout.
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
        self._rests_since: int | None = None  # with bits 10 and 12 set after the acknowledgement
        self._interrupts = False  # the set-point interrupts a motion
        self._lagged = False
        self._clear_at = _NEVER  # time at which a pulse of bit 4 clears bit 12
        self._events: list[SetPointEvent] = []

    def move(
        self, target: int, *, relative: bool = False, immediately: bool = False, change_on_set_point: bool = False
    ) -> None:
        """Send a set-point in device units after the current motion, or at once with `immediately`.

        If a set-point is already waiting (see `can_take`), replace it with `immediately`, else raise
        LocalProtocolError.
        """
        if not (self.can_take or immediately):
            raise LocalProtocolError(
                f"set-point {target}: another one is waiting; wait until the drive has acknowledged it"
            )
        bits = _IMMEDIATELY * immediately | _RELATIVE * relative | _CHANGE_ON_SET_POINT * change_on_set_point
        self._next = SetPoint(target, bits)

    def stop_at(self, target: int) -> None:
        """Send at once a set-point that ends the motion; it replaces any set-point whose edge has not been sent yet."""
        self._next = SetPoint(target, _IMMEDIATELY)
        if self.phase is SetPointPhase.CLEAR:
            self._current, self._next = self._next, None
        elif self.phase is SetPointPhase.LOW:
            self._current, self._next = self._next, None
            self.target, self._updates = target, 0

    def abort(self, reason: str = "aborted") -> None:
        """Abandon all set-points at the next update, with bit 4 = 0 from then on."""
        if self.busy:
            self._aborted = reason

    @property
    def can_take(self) -> bool:
        return self._next is None

    @property
    def busy(self) -> bool:
        """Whether a set-point is waiting, or sent but not yet reached."""
        return self.phase is not SetPointPhase.IDLE or self._next is not None

    def events(self) -> list[SetPointEvent]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def next_deadline(self) -> int | None:
        """Return the time in ns by which `update` must be called again, or None if no timeout is running."""
        return None if self._deadline == _NEVER else self._deadline

    def update(
        self,
        statusword: int | None,
        ready: bool,
        now: int,
        halted: bool = False,
        under_way: bool = False,
        position: int | None = None,
    ) -> int:
        """Return bits 4, 5, 6 and 9 of the controlword to send.

        Call once per cycle; this method never raises an exception. `ready` is True if the drive is enabled in mode PP;
        otherwise the set-point is abandoned. While `halted` the drive keeps its target and bit 10 means standstill, so
        that nothing is evaluated and no timeout runs. `under_way` is True if the axis is moving far from its target, so
        that bit 10, which flickers in some drives (yarp-devices, issue 245), is ignored. `position` is the actual
        position in device units; without it no bit 12 is cleared by a pulse.
        """
        if self.phase is SetPointPhase.IDLE and self._next is None:
            return 0
        if self._aborted or not ready or statusword is None:
            return self._give_up(self._aborted or "the drive is not enabled in mode PP", now)
        # CiA 402-2, 0x6041 in mode PP: with halt, bit 10 means velocity 0
        if halted:
            self._deadline = _NEVER
            return self._bits
        self._proceed(statusword & ~TARGET_REACHED if under_way else statusword, now, position)
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

    def _proceed(self, statusword: int, now: int, position: int | None) -> None:
        if self._next is not None and self.phase in (SetPointPhase.IDLE, SetPointPhase.MOVING):
            self._interrupts = self.phase is SetPointPhase.MOVING
            self._clear_at = _NEVER if self._interrupts else now + _SHOWN_NS
            self._begin(self._next)
        acknowledged = bool(statusword & _ACKNOWLEDGED)
        if self.phase in (SetPointPhase.LOW, SetPointPhase.CLEAR):
            self._prepare(acknowledged, now, position)
        elif self.phase is SetPointPhase.ACKNOWLEDGE:
            # CiA 402-2, 0x6041 in mode PP: bit 12 acknowledges the set-point; then bit 4 returns to 0
            if acknowledged:
                self._go(SetPointPhase.RELEASE)
                self._interrupts = False
                self._moved = self._lagged = False
                self._rests_since = None
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

    def _prepare(self, acknowledged: bool, now: int, position: int | None) -> None:
        """Wait for bit 12 = 0, if necessary after a pulse of bit 4 that clears it, and begin the edge of bit 4."""
        if self.phase is SetPointPhase.CLEAR:
            self._bits = _NEW_SET_POINT | _IMMEDIATELY
            if self._updates > _PULSE:
                self.target = self._current.target
                self._go(SetPointPhase.LOW)
        # CiA 402-2, 0x6040 in mode PP: bit 4 may rise only while bit 12 of the statusword is 0
        elif not acknowledged and self._updates:
            self._go(SetPointPhase.ACKNOWLEDGE, _NEW_SET_POINT | self._current.bits)
        elif now >= self._clear_at and position is not None:
            self._clear_at, self.target = _NEVER, position
            self._go(SetPointPhase.CLEAR)

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
                self._rests_since = None if not reached else now if self._rests_since is None else self._rests_since
                if self._rests_since is not None and now - self._rests_since >= _RESTS_NS:
                    self._deadline = now  # a drive at its target does not clear the bit any more
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
