from __future__ import annotations

from canopen_control.cia402.events import TransitionTimedOut
from canopen_control.cia402.state import Command, State
from canopen_control.cia402.step_timer import StepTimer, transition_number

NEVER = (1 << 62) - 1


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


def test_the_same_command_is_one_step_until_the_state_or_the_wish_changes():
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


def test_the_event_names_the_transition_or_else_what_was_wanted_in_the_end():
    timer = StepTimer(100, {})
    timer.arm(Command.SHUTDOWN, 2, 0)
    assert timer.timed_out(State.SWITCH_ON_DISABLED, State.OPERATION_ENABLED, 0x0240, True, 100) == TransitionTimedOut(
        100, State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, Command.SHUTDOWN, 2, 0x0240, True
    )
    timer.arm(None, 0, 0)
    assert timer.timed_out(None, State.OPERATION_ENABLED, None, True, 100) == TransitionTimedOut(
        100, None, State.OPERATION_ENABLED, None, None, None, True
    )
