from __future__ import annotations

from canopen_control.cia402 import objects
from canopen_control.cia402.objects import (
    ABORT_CONNECTION,
    DEFAULTS,
    OPTION_CODES,
    Reaction,
)
from canopen_control.cia402.state import Command, State

QUICK_STOP = OPTION_CODES[objects.QUICK_STOP_OPTION]


def test_a_quick_stop_leaves_or_stays_as_its_code_says():
    for code in range(5):
        assert QUICK_STOP[code].final_state is State.SWITCH_ON_DISABLED
    for code in range(5, 9):
        stays, leaves = QUICK_STOP[code], QUICK_STOP[code - 4]
        assert stays.final_state is State.QUICK_STOP_ACTIVE
        assert stays.reaction is leaves.reaction


def test_defaults_are_those_of_the_profile_and_always_a_row():
    assert [DEFAULTS[index] for index in (0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6007)] == [2, 0, 1, 1, 2, 1]
    meant = {index: codes[DEFAULTS[index]].reaction for index, codes in OPTION_CODES.items()}
    assert meant[objects.QUICK_STOP_OPTION] is Reaction.QUICK_STOP_RAMP
    assert meant[objects.SHUTDOWN_OPTION] is Reaction.DISABLE
    assert meant[objects.DISABLE_OPERATION_OPTION] is Reaction.SLOW_DOWN_RAMP


def test_each_option_ends_in_its_state():
    ends = {index: {option.final_state for option in codes.values()} for index, codes in OPTION_CODES.items()}
    assert ends[objects.SHUTDOWN_OPTION] == {State.READY_TO_SWITCH_ON}
    assert ends[objects.DISABLE_OPERATION_OPTION] == {State.SWITCHED_ON}
    assert ends[objects.HALT_OPTION] == {State.OPERATION_ENABLED}
    assert ends[objects.FAULT_REACTION_OPTION] == {State.FAULT}
    assert 0 not in OPTION_CODES[objects.HALT_OPTION]


def test_reserved_and_manufacturer_codes_mean_nothing_here():
    assert set(OPTION_CODES[objects.QUICK_STOP_OPTION]) == set(range(9))
    assert all(0 <= code < 9 for codes in OPTION_CODES.values() for code in codes)
    assert objects.CONTROLWORD not in OPTION_CODES


def test_a_lost_connection_does_nothing_faults_or_is_a_command():
    assert list(ABORT_CONNECTION.values()) == [None, State.FAULT, Command.DISABLE_VOLTAGE, Command.QUICK_STOP]
