from __future__ import annotations

from canopen_control.cia402.drive_goal import (
    DISABLED_STATES,
    FAULT_STATES,
    LADDER,
    DriveGoal,
    is_stopped,
    state_of_goal,
)
from canopen_control.cia402.state import State


def test_each_goal_is_a_state_to_aim_for():
    aims = {goal: state_of_goal(goal, State.READY_TO_SWITCH_ON) for goal in DriveGoal}
    assert aims == {
        DriveGoal.DISABLED: State.READY_TO_SWITCH_ON,
        DriveGoal.ENABLED: State.OPERATION_ENABLED,
        DriveGoal.QUICK_STOPPED: State.QUICK_STOP_ACTIVE,
        DriveGoal.VOLTAGE_DISABLED: State.SWITCH_ON_DISABLED,
    }


def test_a_stop_is_reached_at_its_height_or_below_and_never_with_torque_or_unseen():
    for goal in (DriveGoal.DISABLED, DriveGoal.VOLTAGE_DISABLED, DriveGoal.QUICK_STOPPED):
        for height in DISABLED_STATES:
            for state in (State.OPERATION_ENABLED, State.FAULT_REACTION_ACTIVE, State.NOT_READY_TO_SWITCH_ON, None):
                assert not is_stopped(goal, height, state)
            assert is_stopped(goal, height, State.SWITCH_ON_DISABLED)
            assert is_stopped(goal, height, State.FAULT)
    assert is_stopped(DriveGoal.DISABLED, State.SWITCHED_ON, State.SWITCHED_ON)
    assert not is_stopped(DriveGoal.DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON)
    assert not is_stopped(DriveGoal.VOLTAGE_DISABLED, State.SWITCHED_ON, State.SWITCHED_ON)
    assert is_stopped(DriveGoal.QUICK_STOPPED, State.SWITCH_ON_DISABLED, State.QUICK_STOP_ACTIVE)
    assert not is_stopped(DriveGoal.DISABLED, State.SWITCH_ON_DISABLED, State.QUICK_STOP_ACTIVE)


def test_every_state_but_the_faults_has_its_height():
    assert set(LADDER) == set(State) - set(FAULT_STATES)
