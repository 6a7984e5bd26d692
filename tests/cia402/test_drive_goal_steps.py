from __future__ import annotations

from canopen_control.cia402.drive_goal import (
    FaultReset,
    QuickStopExit,
    StepTimer,
    StopStage,
    SupplyWatch,
    transition_number,
)
from canopen_control.cia402.events import FaultResetFailed, TransitionTimedOut
from canopen_control.cia402.state import Command, State

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
