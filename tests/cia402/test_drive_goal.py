from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.cia402.drive_goal import (
    CONFIRMED,
    DISABLED_STATES,
    FAILED,
    FAULT_STATES,
    LADDER,
    DriveGoal,
    FaultReset,
    ModeRequest,
    ModeState,
    ModeTrigger,
    QuickStopExit,
    StepTimer,
    StopStage,
    SupplyWatch,
    is_stopped,
    state_of_goal,
    transition_number,
)
from canopen_control.cia402.drive_goal import MODE_TABLE as TABLE
from canopen_control.cia402.events import FaultResetFailed, ModeConfirmed, ModeTimedOut, TransitionTimedOut
from canopen_control.cia402.state import Command, State


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


# -- mode request


def test_nothing_asked_for_is_confirmed_whatever_the_display_shows():
    request = ModeRequest(100)
    assert request.update(0, False, 0) is None
    assert request.update(8, False, 1) is None
    assert request.confirmed
    assert request.mode is None


def test_a_mode_is_confirmed_by_the_display_alone_and_reported_once():
    request = ModeRequest(100)
    assert request.ask(8)
    assert not request.ask(8)
    assert not request.confirmed
    assert request.update(None, False, 0) is None
    assert request.update(1, False, 50) is None
    assert request.update(8, False, 99) == ModeConfirmed(99, 8)
    assert request.update(8, False, 200) is None
    assert request.confirmed


def test_a_display_that_never_follows_goes_back_to_the_last_mode_that_was_confirmed():
    request = ModeRequest(100)
    request.ask(1)
    request.update(1, False, 0)
    request.ask(8)
    request.update(1, False, 10)
    assert request.deadline == 110
    event = request.update(1, False, 110)
    assert event == ModeTimedOut(110, 8, 1, 1)
    assert (
        event.text == "mode CSP not confirmed, 0x6061 shows PP; back to PP; mode_timeout_ms in bus.yml allows more time"
    )
    assert (request.mode, request.confirmed, request.failed) == (1, True, True)
    request.ask(1)
    assert not request.failed


def test_a_first_mode_that_is_never_shown_leaves_none():
    request = ModeRequest(100)
    request.ask(8)
    request.update(None, False, 0)
    event = request.update(None, False, 100)
    assert event == ModeTimedOut(100, 8, None, None)
    assert "0x6061 shows nothing" in event.text
    assert (request.mode, request.confirmed, request.failed) == (None, False, True)


def test_a_mode_that_the_drive_leaves_by_itself_is_no_longer_confirmed():
    request = ModeRequest(100)
    request.ask(8)
    request.update(8, False, 0)
    assert request.update(6, False, 10) is None
    assert not request.confirmed
    assert request.update(8, False, 20) == ModeConfirmed(20, 8)
    request.update(6, False, 30)
    assert request.update(6, False, 130) == ModeTimedOut(130, 8, 6, None)
    assert not request.confirmed


def test_a_drive_that_shows_no_mode_until_it_is_enabled_may_be_enabled_and_shows_it_then():
    request = ModeRequest(100)
    request.ask(3)
    assert request.update(0, False, 0) is None
    assert (request.may_enable, request.deadline) == (False, 50)
    assert request.update(0, False, 50) is None
    assert (request.state, request.may_enable, request.confirmed) == (ModeState.UNSHOWN, True, False)
    assert request.update(0, False, 10_000) is None  # off for long: nothing runs out
    assert request.update(0, True, 10_010) is None
    assert request.update(3, True, 10_020) == ModeConfirmed(10_020, 3)
    assert request.update(0, False, 20_000) is None  # disabled: shows none again
    assert not request.may_enable
    assert request.update(0, False, 20_050) is None
    assert request.may_enable


def test_a_drive_that_is_enabled_and_shows_no_mode_in_time_has_failed():
    request = ModeRequest(100)
    request.ask(3)
    request.update(0, False, 0)
    request.update(0, False, 50)
    assert request.update(0, True, 60) is None
    assert request.update(0, True, 160) == ModeTimedOut(160, 3, 0, None, True)
    assert (request.failed, request.may_enable) == (True, False)


@pytest.mark.parametrize("display", [None, 1, -2])
def test_a_drive_that_shows_another_mode_or_nothing_is_not_enabled_without(display):
    request = ModeRequest(100)
    request.ask(3)
    request.update(display, False, 0)
    assert not request.may_enable
    assert request.update(display, False, 100) == ModeTimedOut(100, 3, display, None)
    assert not request.may_enable


def test_a_display_of_minus_one_is_a_change_under_way_and_has_five_times_the_time():
    request = ModeRequest(100)
    request.ask(7)
    for now in (0, 100, 499):
        assert request.update(-1, False, now) is None
    assert request.update(7, False, 499) == ModeConfirmed(499, 7)
    request.ask(8)
    request.update(-1, False, 500)
    assert request.update(-1, False, 1000) == ModeTimedOut(1000, 8, -1, 7)


def test_a_drive_that_was_gone_confirms_again():
    request = ModeRequest(100)
    request.ask(8)
    request.update(8, False, 0)
    request.forget_display()
    assert not request.confirmed
    assert request.update(8, False, 1000) == ModeConfirmed(1000, 8)


def test_every_state_and_every_trigger_has_its_rows_and_can_be_reached():
    assert set(TABLE) == set(ModeState)
    reached = {ModeState.NONE}
    for _ in ModeState:
        reached |= {after for state in reached for after in TABLE[state].values()}
    assert reached == set(ModeState)
    assert {trigger for rows in TABLE.values() for trigger in rows} == set(ModeTrigger)


@pytest.mark.parametrize("state", ModeState)
def test_only_what_0x6061_shows_or_an_ask_for_what_it_shows_confirms(state):
    for trigger, after in TABLE[state].items():
        if after in CONFIRMED and state not in CONFIRMED:
            assert trigger in (ModeTrigger.SHOWN, ModeTrigger.OVERDUE_STAYED)
        if state in FAILED and after not in FAILED:
            assert trigger in (ModeTrigger.ASK, ModeTrigger.ASK_AGAIN), "until somebody asks again"
    assert TABLE[state][ModeTrigger.ASK] is ModeState.REQUESTED


STEPS = st.one_of(
    st.tuples(st.just("ask"), st.integers(1, 3)),
    st.tuples(st.just("show"), st.none() | st.integers(0, 3)),
    st.just(("gone", None)),
)


@given(st.lists(st.tuples(STEPS, st.integers(0, 60)), max_size=60))
def test_a_confirmed_mode_is_the_one_that_0x6061_showed_last(steps):
    request, now, display, requested = ModeRequest(100), 0, None, set()
    for (what, value), passed in steps:
        now += passed
        if what == "ask":
            requested.add(value)
            before = request.mode
            assert request.ask(value) is (value != before)
            assert not request.failed
        elif what == "gone":
            display = None
            request.forget_display()
        else:
            display = value
            event = request.update(display, False, now)
            assert request.failed or not isinstance(event, ModeTimedOut)
            assert request.state in CONFIRMED + FAILED or request.deadline > now
        assert request.mode is None or request.mode in requested
        assert (request.mode is None) is (request.state in (ModeState.NONE, ModeState.REFUSED))
        assert request.confirmed <= (request.mode in (None, display))


def test_a_mode_that_was_not_confirmed_in_time_is_kept_until_it_is():
    request = ModeRequest(100)
    request.ask(3)
    for now in (0, 100):
        assert request.missed is None
        request.update(0, True, now)
    assert request.missed == 3
    request.ask(3)
    request.update(0, True, 200)
    assert request.missed == 3
    request.update(3, True, 210)
    assert request.missed is None


# -- steps


NEVER = (1 << 62) - 1
MOVING, REACHED = 0x0217, 0x0617
WORD = 0x0218


def test_a_step_is_the_number_of_its_transition_or_none():
    assert transition_number(State.SWITCHED_ON, Command.ENABLE_OPERATION) == 4
    assert transition_number(State.SWITCHED_ON, Command.SWITCH_ON) is None
    assert transition_number(None, Command.SHUTDOWN) is None
    assert transition_number(State.FAULT, None) is None


def test_a_transition_has_its_own_time_or_the_default():
    timer = StepTimer(100, {4: 7})
    timer.arm(Command.ENABLE_OPERATION, 4, 1000)
    assert timer.deadline == 1007
    timer.arm(Command.SHUTDOWN, 2, 1000)
    assert timer.deadline == 1100
    timer.arm(Command.SHUTDOWN, None, 1000)
    assert timer.deadline == NEVER


def test_the_same_command_is_one_step_until_the_state_or_the_goal_changes():
    timer = StepTimer(100, {})
    assert timer.must_arm(None)
    timer.arm(Command.SHUTDOWN, 2, 0)
    assert not timer.must_arm(Command.SHUTDOWN)
    assert timer.must_arm(Command.SWITCH_ON)
    timer.rearm()
    assert timer.must_arm(Command.SHUTDOWN)
    assert timer.deadline == 100
    timer.arm(Command.SHUTDOWN, 2, 5)
    timer.enter()
    assert timer.must_arm(Command.SHUTDOWN)
    assert timer.deadline == NEVER


def test_the_event_names_the_transition_or_else_what_was_requested_in_the_end():
    timer = StepTimer(100, {})
    timer.arm(Command.SHUTDOWN, 2, 0)
    assert timer.timeout_event(
        State.SWITCH_ON_DISABLED, State.OPERATION_ENABLED, 0x0240, True, 100
    ) == TransitionTimedOut(100, State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, Command.SHUTDOWN, 2, 0x0240, True)
    timer.arm(None, 0, 0)
    assert timer.timeout_event(None, State.OPERATION_ENABLED, None, True, 100) == TransitionTimedOut(
        100, None, State.OPERATION_ENABLED, None, None, None, True
    )
    slow = timer.timeout_event(State.NOT_READY_TO_SWITCH_ON, State.OPERATION_ENABLED, 0x0600, True, 100)
    assert slow.transition == 1
    assert slow.text.endswith("not enabled; `transition_timeouts_ms: {1: 20000}` in bus.yml allows more time")


def test_to_enable_transition_16_is_asked_for_when_the_mode_is_confirmed():
    leave = QuickStopExit()
    assert leave.command(True, MOVING, False, False) is Command.QUICK_STOP
    assert leave.command(True, MOVING, False, True) is Command.ENABLE_OPERATION
    leave.advance()
    assert leave.command(True, MOVING, False, True) is Command.QUICK_STOP
    leave.advance()
    assert leave.command(True, MOVING, False, True) is Command.DISABLE_VOLTAGE


def test_to_disable_the_end_of_the_stop_is_waited_for():
    leave = QuickStopExit()
    leave.enter()
    leave.evaluate(MOVING)
    assert leave.command(False, MOVING, False, True) is Command.QUICK_STOP
    assert leave.stage is StopStage.WAIT
    leave.evaluate(REACHED)
    assert leave.command(False, REACHED, False, True) is Command.DISABLE_VOLTAGE
    assert leave.command(False, MOVING, False, True) is Command.DISABLE_VOLTAGE


def test_a_bit_10_that_was_there_before_the_stop_is_not_a_standstill():
    leave = QuickStopExit()
    leave.evaluate(REACHED)
    assert leave.command(False, REACHED, False, True) is Command.QUICK_STOP
    assert leave.command(False, REACHED, True, True) is Command.DISABLE_VOLTAGE
    leave.enter()
    leave.evaluate(REACHED)
    assert leave.command(False, REACHED, False, True) is Command.QUICK_STOP


def test_another_goal_begins_again():
    leave = QuickStopExit()
    leave.advance()
    leave.advance()
    leave.restart()
    assert leave.command(True, MOVING, False, True) is Command.ENABLE_OPERATION


def test_bit_7_is_seen_low_then_high_once():
    reset = FaultReset(100)
    reset.start()
    assert [(reset.update(State.FAULT, WORD, now), reset.bit) for now in range(3)] == [
        (None, 0),
        (None, 0x80),
        (None, 0x80),
    ]
    reset.cancel()
    assert (reset.active, reset.bit) == (False, 0)


def test_asking_again_does_not_start_another_edge():
    reset = FaultReset(100)
    reset.start()
    reset.update(State.FAULT, WORD, 0)
    reset.update(State.FAULT, WORD, 1)
    reset.start()
    reset.update(State.FAULT, WORD, 2)
    assert reset.bit == 0x80


def test_the_edge_waits_for_the_end_of_the_fault_reaction():
    reset = FaultReset(100)
    reset.start()
    for now in range(5):
        reset.update(State.FAULT_REACTION_ACTIVE, WORD, now)
        assert reset.bit == 0
        assert not reset.rising
    reset.update(State.FAULT, WORD, 5)
    assert (reset.bit, reset.rising) == (0, True)
    reset.update(State.FAULT, WORD, 6)
    assert (reset.bit, reset.rising) == (0x80, False)


def test_a_cause_that_is_still_there_is_reported_when_the_time_is_over_and_bit_7_falls():
    reset = FaultReset(100)
    reset.start()
    for now in range(0, 100, 10):
        assert reset.update(State.FAULT, WORD, now) is None
    assert reset.deadline == 100
    event = reset.update(State.FAULT, WORD, 100)
    assert event == FaultResetFailed(100, WORD)
    assert "the cause is still present (statusword 0x0218)" in event.text
    assert (reset.active, reset.bit) == (False, 0)


# -- the supply of an enabled drive


def test_a_bit_4_that_has_fallen_for_long_is_a_lost_supply_once():
    watch, on, off = SupplyWatch(), 0x0237, 0x0227
    assert not watch.lost(off, 0)
    assert watch.deadline == NEVER, "a drive that never sets it does not maintain it"
    watch.lost(on, 1)
    assert not watch.lost(off, 2)
    assert watch.deadline == 100_000_002
    assert not watch.lost(on, 50_000_000)
    assert watch.deadline == NEVER
    assert not watch.lost(off, 60_000_000)
    assert not watch.lost(off, 159_999_999)
    assert watch.lost(off, 160_000_000)
    assert not watch.lost(off, 500_000_000)
    watch.lost(on, 600_000_000)
    watch.lost(off, 700_000_000)
    watch.restart()
    assert not watch.lost(off, 900_000_000)
