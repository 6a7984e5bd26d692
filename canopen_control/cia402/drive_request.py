"""Requested state of a drive: the request, the table of its changes, and the command of the current step.

An `EnableRequest` is a goal together with a command that may not be confirmed yet. `ENABLE_TABLE` has the next
request for each trigger; a trigger without a row changes nothing. Only ENABLE and OVERTAKE lead to the goal ENABLED;
a fault, and the loss of OPERATION_ENABLED without a command, lead away from it. A new goal starts a new step.

The request is apart from `drive`, which evaluates statuswords: this module holds what the master requests, `drive` what
the drive shows.
"""

from __future__ import annotations

from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.drive_goal import (
    AUTOMATIC,
    FAULT_STATES,
    LADDER,
    NEVER,
    SETTLE,
    DriveGoal,
    QuickStopExit,
    StepTimer,
    StopStage,
    state_of_goal,
    transition_number,
)
from canopen_control.cia402.state import Command, State, next_command

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.cia402.events import TransitionTimedOut


_TOLERATED_LOSSES: Final = 2  # losses of a state that are tolerated while enabling, as a late command may cause them


class EnableRequest(Enum):
    """Goal of the master for a drive, with its progress; each value is a description in words."""

    DISABLED = "disabled by the drive's own ramp"
    DISABLED_AFTER_STOP = "disabled after a quick stop, which is sent until the drive has left OPERATION_ENABLED"
    ENABLED = "operation enabled"
    OVERTAKING = "operation enabled, while an older command that would end this state may still take effect"
    QUICK_STOPPING = "stopped by a quick stop, which is sent until the drive has left OPERATION_ENABLED"
    QUICK_STOPPED = "stopped by a quick stop"
    VOLTAGE_DISABLED = "voltage disabled at once"


class EnableTrigger(Enum):
    """Trigger of a change of the `EnableRequest`; each value is a description in words."""

    ENABLE = "enable requested"
    OVERTAKE = "enable requested in OPERATION_ENABLED, after a command that ends this state was sent"
    DISABLE = "disable requested"
    QUICK_STOP = "quick stop requested"
    QUICK_STOP_ENABLED = "quick stop requested in OPERATION_ENABLED"
    DISABLE_VOLTAGE = "disable voltage requested"
    LEFT = "the statusword shows a state other than OPERATION_ENABLED"
    SETTLED = "the last command has taken effect, or its timeout has elapsed"
    LOST = "a fault, or an enable that ended without a command"


_END: Final = {
    EnableTrigger.DISABLE_VOLTAGE: EnableRequest.VOLTAGE_DISABLED,
    EnableTrigger.LOST: EnableRequest.DISABLED,
}
_ENABLE: Final = {EnableTrigger.ENABLE: EnableRequest.ENABLED, EnableTrigger.OVERTAKE: EnableRequest.OVERTAKING}
_STOP: Final = {
    EnableTrigger.QUICK_STOP: EnableRequest.QUICK_STOPPED,
    EnableTrigger.QUICK_STOP_ENABLED: EnableRequest.QUICK_STOPPING,
}
_ENABLED: Final = {**_END, **_STOP, EnableTrigger.DISABLE: EnableRequest.DISABLED}

ENABLE_TABLE: Final[Mapping[EnableRequest, Mapping[EnableTrigger, EnableRequest]]] = MappingProxyType(
    {
        EnableRequest.DISABLED: {**_END, **_ENABLE, **_STOP},
        EnableRequest.DISABLED_AFTER_STOP: {
            **_END,
            **_ENABLE,
            **_STOP,
            EnableTrigger.LEFT: EnableRequest.DISABLED,
            EnableTrigger.SETTLED: EnableRequest.DISABLED,
        },
        EnableRequest.ENABLED: _ENABLED,
        EnableRequest.OVERTAKING: {**_ENABLED, EnableTrigger.SETTLED: EnableRequest.ENABLED},
        EnableRequest.QUICK_STOPPING: {
            **_END,
            **_ENABLE,
            EnableTrigger.DISABLE: EnableRequest.DISABLED_AFTER_STOP,
            EnableTrigger.LEFT: EnableRequest.QUICK_STOPPED,
            EnableTrigger.SETTLED: EnableRequest.QUICK_STOPPED,
        },
        EnableRequest.QUICK_STOPPED: {**_END, **_ENABLE, EnableTrigger.DISABLE: EnableRequest.DISABLED},
        EnableRequest.VOLTAGE_DISABLED: {**_END, **_ENABLE},  # only ENABLE and OVERTAKE restore the voltage
    }
)
"""Next request for each request and trigger; other triggers have no effect."""

GOALS: Final[Mapping[EnableRequest, DriveGoal]] = MappingProxyType(
    {
        EnableRequest.DISABLED: DriveGoal.DISABLED,
        EnableRequest.DISABLED_AFTER_STOP: DriveGoal.DISABLED,
        EnableRequest.ENABLED: DriveGoal.ENABLED,
        EnableRequest.OVERTAKING: DriveGoal.ENABLED,
        EnableRequest.QUICK_STOPPING: DriveGoal.QUICK_STOPPED,
        EnableRequest.QUICK_STOPPED: DriveGoal.QUICK_STOPPED,
        EnableRequest.VOLTAGE_DISABLED: DriveGoal.VOLTAGE_DISABLED,
    }
)
"""Goal of each request."""

SENT_FIRST: Final[Mapping[EnableRequest, Command]] = MappingProxyType(
    {
        EnableRequest.DISABLED_AFTER_STOP: Command.QUICK_STOP,
        EnableRequest.QUICK_STOPPING: Command.QUICK_STOP,
        EnableRequest.VOLTAGE_DISABLED: Command.DISABLE_VOLTAGE,
    }
)
"""Commands sent in every state except a fault; for other requests `state.next_command` finds the next step."""


class DriveRequest:
    """Request to one drive and its current step; `disabled_state` is the final state of a disabled drive."""

    def __init__(self, step: StepTimer, disabled_state: State) -> None:
        self.step = step
        self.disabled_state = disabled_state
        self.state = EnableRequest.DISABLED
        self.goal = DriveGoal.DISABLED
        self.detour: State | None = None  # state to which an enabled drive goes first, to change its mode there
        self._losses = 0
        self._stop_exit = QuickStopExit()

    @property
    def waits(self) -> bool:
        """Whether the end of a quick stop is awaited; `standstill` may end the wait without a new statusword."""
        return self._stop_exit.stage is StopStage.WAIT

    def fire(self, trigger: EnableTrigger) -> bool:
        """Apply the row of `ENABLE_TABLE` for a trigger; return whether the goal has changed."""
        state = ENABLE_TABLE[self.state].get(trigger)
        if state is None:
            return False
        self.state, goal = state, GOALS[state]
        if goal is self.goal:
            return False
        self.goal = goal
        self._losses = 0
        self.step.rearm()
        self._stop_exit.restart()
        return True

    def on_state_entered(self, drive_state: State | None) -> None:
        """Reset the step timer and the quick-stop exit because the drive has entered the state `drive_state`."""
        self.step.enter()
        self._stop_exit.enter()
        if drive_state is not State.OPERATION_ENABLED:
            self.fire(EnableTrigger.LEFT)

    def record_quick_stop(self, statusword: int) -> None:
        """Record from a statusword in QUICK_STOP_ACTIVE whether the motor is still moving."""
        self._stop_exit.evaluate(statusword)

    def lost_enable(self, previous: State, drive_state: State) -> bool:
        """Whether a drive that should be enabled fell from the state `previous` to `drive_state` without a command.

        Two such falls are tolerated while the drive is being enabled.
        """
        # CiA 402-2, table 22, transitions 8 to 12: a drive may leave the states of the ladder without a command
        if self.goal is not DriveGoal.ENABLED or LADDER[drive_state] >= LADDER[previous]:
            return False
        if self.detour is not None and LADDER[drive_state] >= LADDER[self.detour]:
            return False
        self._losses += 1
        if (
            previous is State.OPERATION_ENABLED and self.state is EnableRequest.ENABLED
        ) or self._losses > _TOLERATED_LOSSES:
            return True
        self.fire(EnableTrigger.SETTLED)
        return False

    def handle_timeout(self, drive_state: State | None, statusword: int | None, now: int) -> TransitionTimedOut | None:
        """End a step after its timeout; return the event to report, or None."""
        self.step.deadline = NEVER
        if self.state is EnableRequest.OVERTAKING:
            self.fire(EnableTrigger.SETTLED)  # the overtaken command had no effect
            return None
        stage = self._stop_exit.stage if self._is_leaving_quick_stop(drive_state) else None
        if stage is StopStage.ENABLE or stage is StopStage.WAIT:
            self._stop_exit.advance()  # the next stage has another command
        if stage is StopStage.ENABLE:
            return None  # transition 16 is optional, so this is not reported
        gave_up = self.goal is DriveGoal.ENABLED and stage is not StopStage.WAIT
        return self.step.timeout_event(
            drive_state, state_of_goal(self.goal, self.disabled_state), statusword, gave_up, now
        )

    def choose(
        self, drive_state: State | None, statusword: int | None, standstill: bool, may_enable: bool
    ) -> Command | None:
        """Return the command for a drive in the state `drive_state`; None in a state that no command can change.

        `may_enable` is True if the mode is confirmed and the drive is not held in SWITCHED_ON, `standstill` if the
        motor is known to be at standstill.
        """
        # CiA 402-2, table 22: in its fault states a drive accepts no command but the fault reset
        if drive_state is None or drive_state in FAULT_STATES:
            return None
        if (sent := SENT_FIRST.get(self.state)) is not None:
            return sent
        enable = self.goal is DriveGoal.ENABLED
        if self._is_leaving_quick_stop(drive_state):
            return self._stop_exit.command(enable, statusword or 0, standstill, may_enable)
        if self.detour is not None and enable:
            # a turning motor would coast, unless the drive already ramps to a standstill because of an older command
            leaving = self.state is EnableRequest.OVERTAKING
            stays = drive_state is State.OPERATION_ENABLED and not standstill and not leaving
            return Command.ENABLE_OPERATION if stays else next_command(drive_state, self.detour)
        if drive_state is State.SWITCHED_ON and enable and not may_enable:
            return Command.SWITCH_ON  # stay until the mode is confirmed
        return next_command(drive_state, state_of_goal(self.goal, self.disabled_state))

    def begin(self, command: Command | None, drive_state: State | None, now: int) -> None:
        """Start the timer if `command` starts a new step."""
        if self.step.must_arm(command):
            self.step.arm(command, self._step_number(command, drive_state), now)

    def _is_leaving_quick_stop(self, drive_state: State | None) -> bool:
        return drive_state is State.QUICK_STOP_ACTIVE and self.goal in (DriveGoal.ENABLED, DriveGoal.DISABLED)

    def _step_number(self, command: Command | None, drive_state: State | None) -> int | None:
        """Return the number of the requested or awaited transition; None if the drive is to keep its state."""
        if drive_state in AUTOMATIC:
            return AUTOMATIC[drive_state] if self.goal is DriveGoal.ENABLED else None
        if drive_state is State.OPERATION_ENABLED and self.state is EnableRequest.OVERTAKING:
            return SETTLE
        # CiA 402-2, table 22, transition 12: follows the stop with 0x605A = 1 to 4, else disable voltage
        if drive_state is State.QUICK_STOP_ACTIVE and self._stop_exit.stage is StopStage.WAIT:
            return 12
        return transition_number(drive_state, command)
