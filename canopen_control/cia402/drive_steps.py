"""The steps of the master's side of an axis: the time of each, the way out of a quick stop, the edge of a fault reset.

Law of this file (CiA 402-2):

- Each transition of the diagram has its time, by number. A step that asks for no transition, because the drive is to
  stay where it is, has none. A step whose time is over is told once and not timed again.
- What the drive does after a quick stop is its own affair (0x605A) and is read from its state. To be enabled it is
  asked at once by transition 16, which is optional; if that does not do, or if it is to be disabled, the end of the
  stop is waited for, since power cut before it lets the motor coast. A drive with 0x605A = 0 to 4 leaves by itself
  then; the others are told by transition 12, when the stop is seen done or has lasted too long.
- The edge of a fault reset (bit 7: 0, 1, 0; transition 15) is sent once per request, in FAULT only, since a drive still
  in its fault reaction would not see it. Bit 7 falls again when the fault is gone, or when the time is over and the
  cause is still there.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.events import FaultResetFailed, TransitionTimedOut
from canopen_control.cia402.state import FAULT_RESET_BIT, TARGET_REACHED, Command, State, transition_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.cia402.events import DriveEvent

__all__ = ["SETTLE", "FaultReset", "QuickStopExit", "ResetPhase", "StepTimer", "StopStage", "transition_number"]

_NEVER: Final = (1 << 62) - 1
SETTLE = -1
"""In place of a transition number: the time after which a command that was overtaken no longer arrives."""


def transition_number(state: State | None, command: Command | None) -> int | None:
    """Return the number of the transition that `command` asks for in `state`, None where it asks for none."""
    transition = transition_of(state, command) if state is not None and command is not None else None
    return None if transition is None else transition.number


class StepTimer:
    """The timer of the present step: `command` is what is being sent, `deadline` is `_NEVER` for none."""

    def __init__(self, timeout_ns: int, timeouts: Mapping[int, int]) -> None:
        self.command: Command | None = None
        self.deadline = _NEVER
        self._timeout = timeout_ns
        self._timeouts = dict(timeouts)
        self._armed = False

    def rearm(self) -> None:
        """Begin a new step with the next command, even if it is the same: something else is wanted of it."""
        self._armed = False

    def enter(self) -> None:
        """Begin a new step with the next command, because the drive is in another state."""
        self._armed = False
        self.deadline = _NEVER

    def must_arm(self, command: Command | None) -> bool:
        """Whether `command` begins a new step."""
        return not self._armed or command is not self.command

    def arm(self, command: Command | None, number: int | None, now: int) -> None:
        """Begin the step `command`; `number` is that of its transition, None for no time."""
        self._armed, self.command = True, command
        self.deadline = _NEVER if number is None else now + self._timeouts.get(number, self._timeout)

    def timed_out(
        self, state: State | None, goal: State, statusword: int | None, gave_up: bool, now: int
    ) -> TransitionTimedOut:
        """Return the event of a step whose time is over; without a transition `goal` is what was wanted."""
        command = self.command
        transition = transition_of(state, command) if state is not None and command is not None else None
        wanted, number = (transition.target, transition.number) if transition is not None else (goal, None)
        return TransitionTimedOut(now, state, wanted, command, number, statusword, gave_up)


class StopStage(Enum):
    """What is tried; each when the one before did not do."""

    ENABLE = "transition 16"
    WAIT = "for the end of the stop"
    DISABLE = "transition 12"


class QuickStopExit:
    """The stage reached since the drive was first seen in its quick stop, or since the goal changed."""

    def __init__(self) -> None:
        self.stage = StopStage.ENABLE
        self._moved = False

    def restart(self) -> None:
        """Begin again, for another goal."""
        self.stage = StopStage.ENABLE

    def enter(self) -> None:
        """Begin again, for another stop."""
        self.stage = StopStage.ENABLE
        self._moved = False

    def advance(self) -> None:
        """Give up the stage: its time is over."""
        self.stage = StopStage.WAIT if self.stage is StopStage.ENABLE else StopStage.DISABLE

    def look(self, statusword: int) -> None:
        """Take a statusword of the drive in its stop."""
        if not statusword & TARGET_REACHED:
            self._moved = True

    def command(self, enable: bool, statusword: int, standstill: bool, may_enable: bool) -> Command:
        """Return what to send: `enable` is wanted, `may_enable` at once, the motor is known to stand (`standstill`)."""
        if self.stage is StopStage.ENABLE and enable:
            return Command.ENABLE_OPERATION if may_enable else Command.QUICK_STOP
        if self.stage is not StopStage.DISABLE:
            # Bit 10 tells the end of the stop only if it was seen 0 in it: before, it may be an old target's.
            over = standstill or (self._moved and bool(statusword & TARGET_REACHED))
            self.stage = StopStage.DISABLE if over else StopStage.WAIT
        return Command.DISABLE_VOLTAGE if self.stage is StopStage.DISABLE else Command.QUICK_STOP


class ResetPhase(Enum):
    """How far a fault reset is."""

    IDLE = "nobody asked for one"
    ASKED = "bit 7 is to be sent 0 first"
    LOW = "bit 7 was sent 0 and is to be raised"
    HIGH = "bit 7 is 1"


class FaultReset:
    """The sequence of one reset; `deadline` is when it has failed."""

    def __init__(self, timeout_ns: int) -> None:
        self.phase = ResetPhase.IDLE
        self.deadline = _NEVER
        self._timeout = timeout_ns

    @property
    def active(self) -> bool:
        """Whether one was asked for and is not at its end."""
        return self.phase is not ResetPhase.IDLE

    @property
    def bit(self) -> int:
        """Bit 7 of the controlword for this cycle, 0 or 0x80."""
        return FAULT_RESET_BIT if self.phase is ResetPhase.HIGH else 0

    @property
    def rising(self) -> bool:
        """Whether the next update will raise bit 7 without anything else having to happen."""
        return self.phase is ResetPhase.LOW

    def start(self) -> None:
        """Ask for a reset; nothing while one is under way."""
        if self.phase is ResetPhase.IDLE:
            self.phase, self.deadline = ResetPhase.ASKED, _NEVER

    def cancel(self) -> None:
        """End it, because the fault is gone, or the drive: bit 7 is 0 again."""
        self.phase, self.deadline = ResetPhase.IDLE, _NEVER

    def update(self, state: State, statusword: int, now: int) -> DriveEvent | None:
        """Go on by one cycle, for a drive in one of its two fault states."""
        if self.deadline == _NEVER:
            self.deadline = now + self._timeout
        if now >= self.deadline:
            self.cancel()
            return FaultResetFailed(now, statusword)
        if state is State.FAULT:
            self.phase = ResetPhase.LOW if self.phase is ResetPhase.ASKED else ResetPhase.HIGH
        return None
