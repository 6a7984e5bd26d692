"""Requests to a drive: forbidden entries of the table, and sequences of requests."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.cia402.drive_goal import FAULT_STATES, DriveGoal, StepTimer
from canopen_control.cia402.drive_request import ENABLE_TABLE as TABLE
from canopen_control.cia402.drive_request import GOALS, SENT_FIRST, DriveRequest, EnableRequest, EnableTrigger
from canopen_control.cia402.state import Command, State

ENABLES = (EnableTrigger.ENABLE, EnableTrigger.OVERTAKE)


def make(*triggers: EnableTrigger) -> DriveRequest:
    intent = DriveRequest(StepTimer(1000, {}), State.SWITCH_ON_DISABLED)
    for trigger in triggers:
        intent.fire(trigger)
    return intent


def test_every_intent_has_its_rows_and_can_be_reached():
    assert set(TABLE) == set(GOALS) == set(EnableRequest)
    reached = {EnableRequest.DISABLED}
    for _ in EnableRequest:
        reached |= {after for intent in reached for after in TABLE[intent].values()}
    assert reached == set(EnableRequest)
    assert {trigger for rows in TABLE.values() for trigger in rows} == set(EnableTrigger)


@pytest.mark.parametrize("intent", EnableRequest)
def test_only_an_enable_leads_to_the_goal_enabled_and_every_stop_away_from_it(intent):
    for trigger, after in TABLE[intent].items():
        if GOALS[after] is DriveGoal.ENABLED and GOALS[intent] is not DriveGoal.ENABLED:
            assert trigger in ENABLES
    stops = set(EnableTrigger) - {*ENABLES, EnableTrigger.LEFT, EnableTrigger.SETTLED}
    if GOALS[intent] is DriveGoal.ENABLED:
        assert stops <= set(TABLE[intent])
        assert all(GOALS[TABLE[intent][trigger]] is not DriveGoal.ENABLED for trigger in stops)


def test_voltage_that_was_cut_stays_away_until_an_enable_or_a_fault():
    rows = TABLE[EnableRequest.VOLTAGE_DISABLED]
    away = {trigger for trigger, after in rows.items() if after is not EnableRequest.VOLTAGE_DISABLED}
    assert away == {*ENABLES, EnableTrigger.LOST}


def test_what_is_sent_whatever_the_state_enables_nothing():
    assert set(SENT_FIRST.values()) == {Command.QUICK_STOP, Command.DISABLE_VOLTAGE}
    assert not any(GOALS[intent] is DriveGoal.ENABLED for intent in SENT_FIRST)


def test_a_quick_stop_of_an_enabled_drive_continues_until_it_is_left_whatever_is_requested_afterwards():
    intent = make(EnableTrigger.ENABLE, EnableTrigger.QUICK_STOP_ENABLED, EnableTrigger.DISABLE)
    assert intent.goal is DriveGoal.DISABLED
    assert intent.choose(State.OPERATION_ENABLED, 0x237, standstill=False, may_enable=True) is Command.QUICK_STOP
    intent.on_state_entered(State.QUICK_STOP_ACTIVE)
    assert intent.state is EnableRequest.DISABLED


def test_an_enable_that_overtook_a_disable_tolerates_it_once():
    intent = make(EnableTrigger.OVERTAKE)
    assert not intent.lost_enable(State.OPERATION_ENABLED, State.SWITCHED_ON)
    assert intent.state is EnableRequest.ENABLED
    assert intent.lost_enable(State.OPERATION_ENABLED, State.SWITCHED_ON)


@given(st.lists(st.sampled_from(list(EnableTrigger)), max_size=40), st.sampled_from([None, *State]), st.booleans())
def test_enable_operation_is_chosen_only_after_an_enable_that_nothing_has_ended(triggers, drive, may_enable):
    intent, enabled = make(), False
    for trigger in triggers:
        before = intent.goal
        assert intent.fire(trigger) is (intent.goal is not before)
        enabled = trigger in ENABLES or (enabled and trigger in (EnableTrigger.LEFT, EnableTrigger.SETTLED))
        assert enabled or intent.goal is not DriveGoal.ENABLED
        command = intent.choose(drive, 0, standstill=False, may_enable=may_enable)
        if command is Command.ENABLE_OPERATION:
            assert enabled
            assert may_enable or drive is State.OPERATION_ENABLED
        assert command is None or drive not in (None, *FAULT_STATES)
        assert command is not Command.FAULT_RESET
