"""What is wanted of a drive: the intent, the table of what changes it, and the command of the present step.

Law of this file: an `Intent` is a goal together with what is still on its way to the drive; `TABLE` says what each
trigger makes of it, and what has no row changes nothing. Only ENABLE and OVERTAKE lead to the goal ENABLED; a fault,
and an enable that ended without a command, lead away from it. Another goal begins another step.
"""

from __future__ import annotations

from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.drive_goal import FAULT_STATES, LADDER, Goal, state_of_goal
from canopen_control.cia402.drive_steps import SETTLE, QuickStopExit, StepTimer, StopStage, transition_number
from canopen_control.cia402.state import Command, State, next_command

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.cia402.events import TransitionTimedOut

__all__ = ["GOALS", "SENT_FIRST", "TABLE", "DriveIntent", "Intent", "IntentTrigger"]

_NEVER: Final = (1 << 62) - 1
_FALLS: Final = 2  # on the way up: a command still on its way may cause one, a drive that keeps falling has a reason
# What an enable waits for before it can command anything.
_AUTOMATIC: Final = {None: 0, State.NOT_READY_TO_SWITCH_ON: 1}


class Intent(Enum):
    """What the master works towards, and what is on its way to the drive; the value says what it means."""

    DISABLED = "disabled, by the drive's own ramp"
    DISABLED_AFTER_STOP = "disabled; a quick stop goes on until the drive has left OPERATION_ENABLED"
    ENABLED = "operation enabled"
    OVERTAKING = "operation enabled; a command that the enable has overtaken, and that would end it, may still arrive"
    QUICK_STOPPING = "stopped by a quick stop, which is sent until the drive has left OPERATION_ENABLED"
    QUICK_STOPPED = "stopped by a quick stop"
    VOLTAGE_DISABLED = "without voltage at once"


class IntentTrigger(Enum):
    """What changes an intent; the value says when."""

    ENABLE = "somebody enables it"
    OVERTAKE = "somebody enables it in OPERATION_ENABLED, and something else than to stay there was sent last"
    DISABLE = "somebody disables it"
    QUICK_STOP = "somebody quick stops it"
    QUICK_STOP_ENABLED = "somebody quick stops it in OPERATION_ENABLED"
    DISABLE_VOLTAGE = "somebody cuts its voltage"
    LEFT = "the drive is seen in another state than OPERATION_ENABLED"
    ARRIVED = "what was on its way to the drive has arrived, or its time is over"
    LOST = "a fault, or an enable that ended without a command"


_I, _T = Intent, IntentTrigger
_END: Final = {_T.DISABLE_VOLTAGE: _I.VOLTAGE_DISABLED, _T.LOST: _I.DISABLED}
_ENABLE: Final = {_T.ENABLE: _I.ENABLED, _T.OVERTAKE: _I.OVERTAKING}
_STOP: Final = {_T.QUICK_STOP: _I.QUICK_STOPPED, _T.QUICK_STOP_ENABLED: _I.QUICK_STOPPING}
_ENABLED: Final = {**_END, **_STOP, _T.DISABLE: _I.DISABLED}

TABLE: Final[Mapping[Intent, Mapping[IntentTrigger, Intent]]] = MappingProxyType(
    {
        _I.DISABLED: {**_END, **_ENABLE, **_STOP},
        _I.DISABLED_AFTER_STOP: {**_END, **_ENABLE, **_STOP, _T.LEFT: _I.DISABLED, _T.ARRIVED: _I.DISABLED},
        _I.ENABLED: _ENABLED,
        _I.OVERTAKING: {**_ENABLED, _T.ARRIVED: _I.ENABLED},
        _I.QUICK_STOPPING: {
            **_END,
            **_ENABLE,
            _T.DISABLE: _I.DISABLED_AFTER_STOP,
            _T.LEFT: _I.QUICK_STOPPED,
            _T.ARRIVED: _I.QUICK_STOPPED,
        },
        _I.QUICK_STOPPED: {**_END, **_ENABLE, _T.DISABLE: _I.DISABLED},
        _I.VOLTAGE_DISABLED: {**_END, **_ENABLE},  # whatever else is said, the voltage stays away
    }
)
"""Intent and trigger to the next intent; a trigger without a row changes nothing."""

GOALS: Final[Mapping[Intent, Goal]] = MappingProxyType(
    {
        _I.DISABLED: Goal.DISABLED,
        _I.DISABLED_AFTER_STOP: Goal.DISABLED,
        _I.ENABLED: Goal.ENABLED,
        _I.OVERTAKING: Goal.ENABLED,
        _I.QUICK_STOPPING: Goal.QUICK_STOPPED,
        _I.QUICK_STOPPED: Goal.QUICK_STOPPED,
        _I.VOLTAGE_DISABLED: Goal.VOLTAGE_DISABLED,
    }
)
"""The goal of each intent."""

SENT_FIRST: Final[Mapping[Intent, Command]] = MappingProxyType(
    {
        _I.DISABLED_AFTER_STOP: Command.QUICK_STOP,
        _I.QUICK_STOPPING: Command.QUICK_STOP,
        _I.VOLTAGE_DISABLED: Command.DISABLE_VOLTAGE,
    }
)
"""What an intent sends whatever the state, a fault apart; the others go step by step, by `state.next_command`."""


class DriveIntent:
    """What is wanted of one drive, and the step that it is at; `disabled_state` is where a disabled drive ends."""

    def __init__(self, step: StepTimer, disabled_state: State) -> None:
        self.step = step
        self.disabled_state = disabled_state
        self.state = Intent.DISABLED
        self.goal = Goal.DISABLED
        self._falls = 0
        self._stop_exit = QuickStopExit()

    @property
    def waits(self) -> bool:
        """Whether the end of a quick stop is waited for, which may be seen without a new statusword."""
        return self._stop_exit.stage is StopStage.WAIT

    def fire(self, trigger: IntentTrigger) -> bool:
        """Take the row of a trigger; returns whether the goal is another one now."""
        state = TABLE[self.state].get(trigger)
        if state is None:
            return False
        self.state, goal = state, GOALS[state]
        if goal is self.goal:
            return False
        self.goal = goal
        self._falls = 0
        self.step.rearm()
        self._stop_exit.restart()
        return True

    def entered(self, drive: State | None) -> None:
        """Begin another step, because the drive is in another state."""
        self.step.enter()
        self._stop_exit.enter()
        if drive is not State.OPERATION_ENABLED:
            self.fire(IntentTrigger.LEFT)

    def stopping(self, statusword: int) -> None:
        """Take a statusword of the drive in its quick stop."""
        self._stop_exit.look(statusword)

    def fell(self, previous: State, drive: State) -> bool:
        """Take a change from one state to another; returns whether a drive that was to be enabled has lost it."""
        if self.goal is not Goal.ENABLED or LADDER[drive] >= LADDER[previous]:
            return False
        self._falls += 1
        if (previous is State.OPERATION_ENABLED and self.state is Intent.ENABLED) or self._falls > _FALLS:
            return True
        self.fire(IntentTrigger.ARRIVED)
        return False

    def timed_out(self, drive: State | None, statusword: int | None, now: int) -> TransitionTimedOut | None:
        """End a step whose time is over; returns what is to be told, None where something else is tried."""
        self.step.deadline = _NEVER
        if self.state is Intent.OVERTAKING:
            self.fire(IntentTrigger.ARRIVED)  # what could have ended the enable did not
            return None
        stage = self._stop_exit.stage if self._is_leaving_quick_stop(drive) else None
        if stage is StopStage.ENABLE or stage is StopStage.WAIT:
            self._stop_exit.advance()  # to another command, so to another step
        if stage is StopStage.ENABLE:
            return None  # transition 16 is optional: not worth a word
        gave_up = self.goal is Goal.ENABLED and stage is not StopStage.WAIT
        return self.step.timed_out(drive, state_of_goal(self.goal, self.disabled_state), statusword, gave_up, now)

    def choose(self, drive: State | None, statusword: int | None, standstill: bool, may_enable: bool) -> Command | None:
        """Return the command for a drive seen in a state, None for one that no command moves.

        `may_enable`: its mode is confirmed and nobody holds it; `standstill`: the motor is known to stand.
        """
        if drive is None or drive in FAULT_STATES:
            return None
        if (sent := SENT_FIRST.get(self.state)) is not None:
            return sent
        enable = self.goal is Goal.ENABLED
        if self._is_leaving_quick_stop(drive):
            return self._stop_exit.command(enable, statusword or 0, standstill, may_enable)
        if drive is State.SWITCHED_ON and enable and not may_enable:
            return Command.SWITCH_ON  # stay: the mode comes first
        return next_command(drive, state_of_goal(self.goal, self.disabled_state))

    def begin(self, command: Command | None, drive: State | None, now: int) -> None:
        """Time the step of `command`, if it is another one."""
        if self.step.must_arm(command):
            self.step.arm(command, self._step_number(command, drive), now)

    def _is_leaving_quick_stop(self, drive: State | None) -> bool:
        return drive is State.QUICK_STOP_ACTIVE and self.goal in (Goal.ENABLED, Goal.DISABLED)

    def _step_number(self, command: Command | None, drive: State | None) -> int | None:
        """Return the transition that the step asks for, or that it waits for; None for a drive that is to stay."""
        if drive in _AUTOMATIC:
            return _AUTOMATIC[drive] if self.goal is Goal.ENABLED else None
        if drive is State.OPERATION_ENABLED and self.state is Intent.OVERTAKING:
            return SETTLE
        if drive is State.QUICK_STOP_ACTIVE and self._stop_exit.stage is StopStage.WAIT:
            return 12
        return transition_number(drive, command)
