"""Parts of the drive's state machine: goals, step timeouts, quick stop, fault reset, requested mode.

The table in `drive` decides the goal; each part here tracks one operation of the drive that takes time.
"""

from __future__ import annotations

from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.events import (
    FaultResetFailed,
    ModeConfirmed,
    ModeTimedOut,
    TransitionTimedOut,
)
from canopen_control.cia402.state import (
    FAULT_RESET_BIT,
    TARGET_REACHED,
    VOLTAGE_ENABLED,
    Command,
    State,
    transition_of,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.cia402.events import DriveEvent


# Goals of the master's side of an axis, and when each goal is reached.
#
# A goal corresponds to a state for `state.next_command`. A stop is reached when the drive has no torque any more, in
# the intended final state or in a lower one; a drive in a fault counts as stopped when its fault reaction is over.


FAULT_STATES = (State.FAULT_REACTION_ACTIVE, State.FAULT)
DISABLED_STATES = (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)
LADDER: Mapping[State, int] = MappingProxyType(
    {
        State.NOT_READY_TO_SWITCH_ON: -1,
        State.SWITCH_ON_DISABLED: 0,
        State.QUICK_STOP_ACTIVE: 0,  # rank of SWITCH_ON_DISABLED: every exit leads to this state, or up
        State.READY_TO_SWITCH_ON: 1,
        State.SWITCHED_ON: 2,
        State.OPERATION_ENABLED: 3,
    }
)
"""Level of each state on the way to OPERATION_ENABLED, used to detect the loss of a state."""


class DriveGoal(Enum):
    """Goal of the master for an axis; each value is a description in words."""

    DISABLED = "disabled by the drive's own ramp"
    ENABLED = "operation enabled"
    QUICK_STOPPED = "stopped by a quick stop"
    VOLTAGE_DISABLED = "voltage disabled at once"


def state_of_goal(goal: DriveGoal, disabled_state: State) -> State:
    """Return the CiA 402 state for a goal; `disabled_state` is the final state of a disabled drive."""
    if goal is DriveGoal.ENABLED:
        return State.OPERATION_ENABLED
    if goal is DriveGoal.QUICK_STOPPED:
        return State.QUICK_STOP_ACTIVE
    return disabled_state if goal is DriveGoal.DISABLED else State.SWITCH_ON_DISABLED


def is_stopped(goal: DriveGoal, disabled_state: State, state: State | None) -> bool:
    """Whether a drive in `state` (None: unknown) has reached `goal`, which is not ENABLED."""
    # CiA 402-2, table 22, transition 14: in FAULT the fault reaction is over, and the motor has no torque
    if state is State.FAULT:
        return True
    # CiA 402-2, 0x605A: a quick stop ends in either of these states
    if goal is DriveGoal.QUICK_STOPPED:
        return state in (State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED)
    return state in DISABLED_STATES and LADDER[state] <= LADDER[state_of_goal(goal, disabled_state)]


# Steps of the master's side of an axis: timeouts, the exit from a quick stop, and the edge of a fault reset.
#
# Rules (CiA 402-2):
#
# - Each transition of the diagram has its own timeout, by number. A step without a transition, for a drive that stays
#   where it is, has none. A step that exceeds its timeout is reported once, without another timeout.
# - The behaviour after a quick stop depends on 0x605A and is read from the drive's state. To enable the drive again,
#   transition 16 is requested at once, which is optional; if it has no effect, or if the drive is to be disabled, the
#   end of the stop is awaited, since the motor would coast if power were cut before. A drive with 0x605A = 0 to 4 then
#   leaves the state by itself; other drives get transition 12, when the stop has ended or has lasted too long.
# - The edge of a fault reset (bit 7: 0, 1, 0; transition 15) is sent once per request, in FAULT only, since a drive
#   in its fault reaction would ignore it. Bit 7 returns to 0 when the fault is gone, or after a timeout if the cause
#   remains.


NEVER: Final = (1 << 62) - 1
# Transitions that a drive makes by itself, by its current state (None: before the first statusword).
AUTOMATIC: Final = {None: 0, State.NOT_READY_TO_SWITCH_ON: 1}
_SUPPLY_NS: Final = 100_000_000
SETTLE = -1
"""Pseudo transition number: its timeout is the time after which an overtaken command can no longer arrive."""


def transition_number(state: State | None, command: Command | None) -> int | None:
    """Return the number of the transition that `command` triggers in `state`, or None."""
    transition = transition_of(state, command) if state is not None and command is not None else None
    return None if transition is None else transition.number


class StepTimer:
    """Timeout of the current step: `command` is sent until `deadline` (`NEVER`: no timeout)."""

    def __init__(self, timeout_ns: int, timeouts: Mapping[int, int]) -> None:
        self.command: Command | None = None
        self.deadline = NEVER
        self._timeout = timeout_ns
        self._timeouts = dict(timeouts)
        self._armed = False

    def rearm(self) -> None:
        """Treat the next command as a new step, even if it is unchanged, because the goal has changed."""
        self._armed = False

    def enter(self) -> None:
        """Clear the timeout and treat the next command as a new step, because the drive has changed its state."""
        self._armed = False
        self.deadline = NEVER

    def must_arm(self, command: Command | None) -> bool:
        return not self._armed or command is not self.command

    def arm(self, command: Command | None, number: int | None, now: int) -> None:
        """Start the timeout of transition `number` (None: no timeout) and remember `command`."""
        self._armed, self.command = True, command
        self.deadline = NEVER if number is None else now + self._timeouts.get(number, self._timeout)

    def timeout_event(
        self, state: State | None, goal: State, statusword: int | None, gave_up: bool, now: int
    ) -> TransitionTimedOut:
        """Return the timeout event of a step; `goal` is the target state of a step without a transition."""
        command = self.command
        transition = transition_of(state, command) if state is not None and command is not None else None
        target, number = (transition.target, transition.number) if transition is not None else (goal, None)
        if state is State.NOT_READY_TO_SWITCH_ON:
            number = AUTOMATIC[state]  # a self-test or commutation may take longer, so that its timeout is named
        return TransitionTimedOut(now, state, target, command, number, statusword, gave_up)


class StopStage(Enum):
    """Stage of leaving a quick stop; if a stage has no effect, the next stage follows."""

    ENABLE = "transition 16"
    WAIT = "wait for the end of the stop"
    DISABLE = "transition 12"


class QuickStopExit:
    """Sequence by which a drive leaves QUICK_STOP_ACTIVE, stage by stage."""

    def __init__(self) -> None:
        self.stage = StopStage.ENABLE
        self._moved = False

    def restart(self) -> None:
        """Return to the first stage because the goal has changed."""
        self.stage = StopStage.ENABLE

    def enter(self) -> None:
        """Return to the first stage and forget observed motion because the drive has changed its state."""
        self.stage = StopStage.ENABLE
        self._moved = False

    def advance(self) -> None:
        """Enter the next stage after a timeout."""
        self.stage = StopStage.WAIT if self.stage is StopStage.ENABLE else StopStage.DISABLE

    def evaluate(self, statusword: int) -> None:
        """In QUICK_STOP_ACTIVE, record whether bit 10 of the statusword has been 0, so that the motor has moved."""
        # CiA 402-2, 0x6041 in QUICK STOP ACTIVE: bit 10 is 0 while the drive stops
        if not statusword & TARGET_REACHED:
            self._moved = True

    def command(self, enable: bool, statusword: int, standstill: bool, may_enable: bool) -> Command:
        """Return the command to send to a drive in QUICK_STOP_ACTIVE.

        `enable` is True if enabling is requested, `may_enable` if it is permitted at once, `standstill` if the
        motor is known to be at standstill.
        """
        # CiA 402-2, table 22, transition 16: optional, and only with 0x605A = 5 to 8
        if self.stage is StopStage.ENABLE and enable:
            return Command.ENABLE_OPERATION if may_enable else Command.QUICK_STOP
        if self.stage is not StopStage.DISABLE:
            # Bit 10 means the end of the stop only if it was 0 during the stop; else it may belong to an old target.
            over = standstill or (self._moved and bool(statusword & TARGET_REACHED))
            self.stage = StopStage.DISABLE if over else StopStage.WAIT
        return Command.DISABLE_VOLTAGE if self.stage is StopStage.DISABLE else Command.QUICK_STOP


class SupplyWatch:
    """Detector of a power stage that has lost its supply while the drive stays in OPERATION_ENABLED.

    `deadline` is the time at which the loss counts, `NEVER` for none. A drive that has never set bit 4 in this state
    does not maintain the bit (SMC LECSN-T).
    """

    def __init__(self) -> None:
        self.deadline = NEVER
        self._supplied = False

    def restart(self) -> None:
        """Forget the bit because the drive has changed its state."""
        self.deadline, self._supplied = NEVER, False

    def lost(self, statusword: int, now: int) -> bool:
        """Return True once if bit 4 of a statusword in OPERATION_ENABLED has been 0 for `_SUPPLY_NS` after it was 1."""
        # CiA 402-2, 0x6041: bit 4, voltage is applied to the power stage; also 0 with STO in some drives
        if statusword & VOLTAGE_ENABLED:
            self.deadline, self._supplied = NEVER, True
        elif self._supplied and self.deadline == NEVER:
            self.deadline = now + _SUPPLY_NS
        elif now >= self.deadline:
            self.restart()
            return True
        return False


class ResetPhase(Enum):
    """Phase of a fault reset; each value is a description in words."""

    IDLE = "no reset is requested"
    REQUESTED = "bit 7 must be sent as 0 first"
    LOW = "bit 7 was sent as 0 and can be set"
    HIGH = "bit 7 is 1"


class FaultReset:
    """Sequence of one fault reset; `deadline` is its timeout, `NEVER` before the first update."""

    def __init__(self, timeout_ns: int) -> None:
        self.phase = ResetPhase.IDLE
        self.deadline = NEVER
        self._timeout = timeout_ns

    @property
    def active(self) -> bool:
        return self.phase is not ResetPhase.IDLE

    @property
    def bit(self) -> int:
        # CiA 402-2, table 22, transition 15: the rising edge of bit 7 resets a fault
        return FAULT_RESET_BIT if self.phase is ResetPhase.HIGH else 0

    @property
    def rising(self) -> bool:
        """Whether the next update in FAULT will set bit 7."""
        return self.phase is ResetPhase.LOW

    def start(self) -> None:
        """Request a reset, unless a reset is in progress."""
        if self.phase is ResetPhase.IDLE:
            self.phase, self.deadline = ResetPhase.REQUESTED, NEVER

    def cancel(self) -> None:
        """End the reset; bit 7 becomes 0."""
        self.phase, self.deadline = ResetPhase.IDLE, NEVER

    def update(self, state: State, statusword: int, now: int) -> DriveEvent | None:
        """Advance the reset of a drive in a fault state by one cycle; return an event if the reset has failed."""
        if self.deadline == NEVER:
            self.deadline = now + self._timeout
        if now >= self.deadline:
            sent = self.phase in (ResetPhase.LOW, ResetPhase.HIGH)
            self.cancel()
            return FaultResetFailed(now, statusword, sent)
        # CiA 402-2, table 22: FAULT REACTION ACTIVE ends by itself (transition 14); only FAULT can be reset
        if state is State.FAULT:
            self.phase = ResetPhase.LOW if self.phase is ResetPhase.REQUESTED else ResetPhase.HIGH
        return None


# Requested mode of operation, until 0x6061 confirms it (CiA 402-2, 6.4).
#
# A mode is active only when 0x6061 shows it. If a mode is not confirmed in time, the last active mode is requested
# again, and the new mode has failed until the next request. The mode 0 is never requested automatically. `MODE_TABLE`
# has the next state for each trigger; a trigger without a row changes nothing.
#
# Some drives show 0 (no mode) until they are enabled (ros-industrial/ros2_canopen, issue 444). Such a drive may be
# enabled in a mode that it has not shown; until it shows the mode, for which there is a timeout, only targets at
# standstill are sent.


class ModeState(Enum):
    """State of a mode request; each value is a description in words."""

    NONE = "no mode was requested: the drive keeps its own mode"
    REQUESTED = "a mode is requested that 0x6061 does not show yet"
    UNSHOWN = "the drive shows no mode while disabled: it may be enabled, and must then show the mode"
    CONFIRMED = "0x6061 shows the requested mode"
    REFUSED = "the mode was not confirmed in time, and there is no earlier mode to return to"
    RETURNING = "the mode was not confirmed in time; the earlier mode is requested again but not shown by 0x6061 yet"
    RETURNED = "the mode was not confirmed in time; 0x6061 shows the earlier mode"


class ModeTrigger(Enum):
    """Trigger of a row in `MODE_TABLE`; each value is a description in words."""

    ASK = "another mode is requested"
    ASK_AGAIN = "the present mode is requested again"
    SHOWN = "0x6061 shows the mode"
    NOT_SHOWN = "0x6061 shows another mode, or nothing"
    NONE_SHOWN = "half of the timeout has elapsed, and 0x6061 of a disabled drive shows 0"
    DRIVE_LOST = "the drive was lost"
    OVERDUE = "the timeout has elapsed, and no other mode was confirmed before"
    OVERDUE_RETURN = "the timeout has elapsed, and another mode was confirmed before"
    OVERDUE_STAYED = "the timeout has elapsed, and 0x6061 shows the mode that was confirmed before"


_S, _ModeTransition = ModeState, ModeTrigger
_ASKED: Final = {_ModeTransition.ASK: _S.REQUESTED}
_TIMED: Final = {
    _ModeTransition.OVERDUE: _S.REFUSED,
    _ModeTransition.OVERDUE_RETURN: _S.RETURNING,
    _ModeTransition.OVERDUE_STAYED: _S.RETURNED,
}

MODE_TABLE: Final[Mapping[ModeState, Mapping[ModeTrigger, ModeState]]] = MappingProxyType(
    {
        _S.NONE: _ASKED,
        _S.REQUESTED: {**_ASKED, **_TIMED, _ModeTransition.SHOWN: _S.CONFIRMED, _ModeTransition.NONE_SHOWN: _S.UNSHOWN},
        _S.UNSHOWN: {
            **_ASKED,
            **_TIMED,
            _ModeTransition.SHOWN: _S.CONFIRMED,
            _ModeTransition.NONE_SHOWN: _S.UNSHOWN,
            _ModeTransition.DRIVE_LOST: _S.REQUESTED,
        },
        _S.CONFIRMED: {**_ASKED, _ModeTransition.NOT_SHOWN: _S.REQUESTED, _ModeTransition.DRIVE_LOST: _S.REQUESTED},
        _S.REFUSED: _ASKED,
        _S.RETURNING: {
            **_ASKED,
            _ModeTransition.ASK_AGAIN: _S.REQUESTED,
            _ModeTransition.OVERDUE: _S.REFUSED,
            _ModeTransition.SHOWN: _S.RETURNED,
        },
        _S.RETURNED: {
            **_ASKED,
            _ModeTransition.ASK_AGAIN: _S.CONFIRMED,
            _ModeTransition.NOT_SHOWN: _S.RETURNING,
            _ModeTransition.DRIVE_LOST: _S.RETURNING,
        },
    }
)
"""Next state for each state and trigger; other triggers have no effect."""

CONFIRMED: Final = (_S.NONE, _S.CONFIRMED, _S.RETURNED)
"""States in which the drive is in the intended mode."""
FAILED: Final = (_S.REFUSED, _S.RETURNING, _S.RETURNED)
"""States after a mode that was not confirmed in time; a new request ends them."""


_CHANGING: Final = -1
"""Value of 0x6061 in Festo's CMMP-AS for 3 to 6 s while it changes to IP (ros_canopen, issue 457)."""
_CHANGES: Final = 4  # factor for the timeout while `_CHANGING` is shown


_STRAYS: Final = 2  # updates in which another value of 0x6061 is not taken for another mode


class ModeRequest:
    """Requested mode of operation, and whether 0x6061 confirms it.

    `mode` is None without a request; `sent` is the value for 0x6060, which differs from `mode` until the drive is in a
    state in which it changes its mode; `deadline` is the timeout of an unconfirmed mode, `NEVER` for none. `missed` is
    the last mode that was not confirmed in time, or None once a mode is confirmed.
    """

    def __init__(self, timeout_ns: int) -> None:
        self.state = ModeState.NONE
        self.mode: int | None = None
        self.sent: int | None = None
        self.display: int | None = None
        self.missed: int | None = None
        self.deadline = NEVER
        self._timeout = timeout_ns
        self.strays = 0
        """Number of updates in a row in which an enabled drive has shown another mode than its confirmed mode."""
        self._halved = False  # the deadline is shorter, because the drive shows no mode while disabled
        self._last_confirmed: int | None = None

    @property
    def confirmed(self) -> bool:
        """Whether 0x6061 shows the requested mode, or no mode is requested."""
        return self.state in CONFIRMED

    @property
    def may_enable(self) -> bool:
        """Whether the drive may be enabled: the mode is confirmed, or the drive shows its mode only while enabled."""
        return self.state in CONFIRMED or self.state is ModeState.UNSHOWN

    @property
    def failed(self) -> bool:
        return self.state in FAILED

    def ask(self, mode: int) -> bool:
        """Request a mode; return whether it differs from the current request."""
        if mode == self.mode:
            self._fire(ModeTrigger.ASK_AGAIN)
            return False
        self.mode, self.deadline = mode, NEVER
        self._fire(ModeTrigger.ASK)
        return True

    def forget_display(self) -> None:
        """Discard the displayed mode of a drive that was lost, but keep the request."""
        self.display = None
        self.deadline = NEVER
        self._fire(ModeTrigger.DRIVE_LOST)

    def update(self, display: int | None, enabled: bool, now: int) -> DriveEvent | None:
        """Process the latest 0x6061 (None: not received); return a confirmation or timeout event, else None.

        `enabled` is True if the drive is in OPERATION_ENABLED.
        """
        self.display = display
        mode = self.mode
        if mode is None:
            return None
        # CiA 402-2, 0x6061: the mode is active when it is shown here
        if display == mode:
            self.strays = 0
            return self._confirm(mode, now)
        if enabled and self.confirmed and self.strays < _STRAYS:
            self.strays += 1  # a cyclic axis in motion would be stopped abruptly
            return None
        # Some drives show 0 (no mode) in 0x6061 until they are enabled
        unshown = display == 0 and not enabled
        if self.deadline == NEVER:
            if not (unshown and self.state is ModeState.UNSHOWN):
                self._halved = unshown
                self.deadline = now + (self._timeout // 2 if unshown else self._timeout)
                self._fire(ModeTrigger.NOT_SHOWN)
        elif now >= self.deadline:
            # Festo CMMP-AS shows -1 in 0x6061 for some seconds while it synchronises
            if display == _CHANGING and now < self.deadline + _CHANGES * self._timeout:
                return None
            if self._halved and not unshown:  # 0 was shown before; the second half of the timeout begins
                self._halved, self.deadline = False, now + self._timeout - self._timeout // 2
                return None
            if not (unshown and self._fire(ModeTrigger.NONE_SHOWN)):
                return self._time_out(mode, enabled, now)
            self.deadline = NEVER
        return None

    def _fire(self, trigger: ModeTrigger) -> bool:
        state = MODE_TABLE[self.state].get(trigger)
        if state is not None:
            self.state = state
        return state is not None

    def _confirm(self, mode: int, now: int) -> DriveEvent | None:
        self.deadline = NEVER
        if not self._fire(ModeTrigger.SHOWN):
            return None
        self._last_confirmed, self.missed = mode, None
        return ModeConfirmed(now, mode)

    def _time_out(self, mode: int, enabled: bool, now: int) -> DriveEvent:
        back = self._last_confirmed if self._last_confirmed != mode else None
        self.mode, self.missed, self.deadline = back, mode, NEVER
        self.sent = back
        if back is None:
            self._fire(ModeTrigger.OVERDUE)
        else:
            self._fire(ModeTrigger.OVERDUE_STAYED if back == self.display else ModeTrigger.OVERDUE_RETURN)
        return ModeTimedOut(now, mode, self.display, back, enabled)
