"""What a drive is to become: the goals of the master's side of an axis, and when each is reached.

Law of this file: a goal is a state to aim for with `state.next_command`. A stop is reached wherever the drive has no
torque any more, at the height it was to end or below; a drive in a fault counts as stopped once its reaction is over.
"""

from __future__ import annotations

from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING

from canopen_control.cia402.state import State

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["DISABLED_STATES", "FAULT_STATES", "LADDER", "Goal", "is_stopped", "state_of_goal"]

FAULT_STATES = (State.FAULT_REACTION_ACTIVE, State.FAULT)
DISABLED_STATES = (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)
LADDER: Mapping[State, int] = MappingProxyType(
    {
        State.NOT_READY_TO_SWITCH_ON: -1,
        State.SWITCH_ON_DISABLED: 0,
        State.QUICK_STOP_ACTIVE: 0,  # both ways out of it lead up again
        State.READY_TO_SWITCH_ON: 1,
        State.SWITCHED_ON: 2,
        State.OPERATION_ENABLED: 3,
    }
)
"""How far a state is on the way to OPERATION_ENABLED; a drive that is being enabled and comes down has a reason."""


class Goal(Enum):
    """What the master works towards."""

    DISABLED = "disabled, by the drive's own ramp"
    ENABLED = "operation enabled"
    QUICK_STOPPED = "stopped by a quick stop"
    VOLTAGE_DISABLED = "without voltage at once"


def state_of_goal(goal: Goal, disabled_state: State) -> State:
    """Return the state to aim for; `disabled_state` is where a disabled drive ends."""
    if goal is Goal.ENABLED:
        return State.OPERATION_ENABLED
    if goal is Goal.QUICK_STOPPED:
        return State.QUICK_STOP_ACTIVE
    return disabled_state if goal is Goal.DISABLED else State.SWITCH_ON_DISABLED


def is_stopped(goal: Goal, disabled_state: State, state: State | None) -> bool:
    """Whether a drive in `state` (None: unknown) has reached `goal`, one of the three that are a stop."""
    if state is State.FAULT:
        return True
    if goal is Goal.QUICK_STOPPED:
        return state in (State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED)
    return state in DISABLED_STATES and LADDER[state] <= LADDER[state_of_goal(goal, disabled_state)]
