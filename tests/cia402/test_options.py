from __future__ import annotations

from canopen_control.cia402 import objects
from canopen_control.cia402.options import (
    ABORT_CONNECTION,
    DEFAULTS,
    OPTION_CODES,
    Reaction,
    deceleration_object,
    option_of,
)
from canopen_control.cia402.state import Command, State


def test_a_quick_stop_leaves_or_stays_as_its_code_says():
    for code in range(5):
        assert option_of(objects.QUICK_STOP_OPTION, code).final_state is State.SWITCH_ON_DISABLED
    for code in range(5, 9):
        stays, leaves = option_of(objects.QUICK_STOP_OPTION, code), option_of(objects.QUICK_STOP_OPTION, code - 4)
        assert stays.final_state is State.QUICK_STOP_ACTIVE
        assert stays.reaction is leaves.reaction


def test_defaults_are_those_of_the_profile_and_always_a_row():
    assert [DEFAULTS[index] for index in (0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6007)] == [2, 0, 1, 1, 2, 1]
    for index in OPTION_CODES:
        assert option_of(index) == option_of(index, DEFAULTS[index])
    assert option_of(objects.QUICK_STOP_OPTION).reaction is Reaction.QUICK_STOP_RAMP
    assert option_of(objects.SHUTDOWN_OPTION).reaction is Reaction.DISABLE
    assert option_of(objects.DISABLE_OPERATION_OPTION).reaction is Reaction.SLOW_DOWN_RAMP


def test_each_option_ends_in_its_state():
    ends = {index: {option.final_state for option in codes.values()} for index, codes in OPTION_CODES.items()}
    assert ends[objects.SHUTDOWN_OPTION] == {State.READY_TO_SWITCH_ON}
    assert ends[objects.DISABLE_OPERATION_OPTION] == {State.SWITCHED_ON}
    assert ends[objects.HALT_OPTION] == {State.OPERATION_ENABLED}
    assert ends[objects.FAULT_REACTION_OPTION] == {State.FAULT}
    assert 0 not in OPTION_CODES[objects.HALT_OPTION]


def test_reserved_and_manufacturer_codes_mean_nothing_here():
    assert option_of(objects.QUICK_STOP_OPTION, 9) is None
    assert option_of(objects.QUICK_STOP_OPTION, -1) is None
    assert option_of(objects.CONTROLWORD, 0) is None
    assert option_of(objects.CONTROLWORD) is None


def test_ramps_take_their_deceleration_from_their_object():
    assert deceleration_object(Reaction.SLOW_DOWN_RAMP) == 0x6084
    assert deceleration_object(Reaction.QUICK_STOP_RAMP) == 0x6085
    assert deceleration_object(Reaction.CURRENT_LIMIT) is None


def test_a_lost_connection_does_nothing_faults_or_is_a_command():
    assert list(ABORT_CONNECTION.values()) == [None, State.FAULT, Command.DISABLE_VOLTAGE, Command.QUICK_STOP]
