from __future__ import annotations

import pytest

from canopen_control.cia402 import objects
from canopen_control.cia402.objects import (
    ABORT_CONNECTION,
    CONTROLWORD,
    DEFAULTS,
    NAMES,
    OPTION_CODES,
    STATUSWORD,
    Reaction,
    axis_count,
    axis_index,
    axis_of,
    is_drive_profile,
    object_name,
)
from canopen_control.cia402.state import Command, State

QUICK_STOP = OPTION_CODES[objects.QUICK_STOP_OPTION]


def test_a_quick_stop_leaves_or_stays_as_its_code_specifies():
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


def test_an_axis_that_cannot_be_is_refused():
    for axis in (-1, 8):
        with pytest.raises(ValueError, match=f"axis {axis} does not exist"):
            axis_index(CONTROLWORD, axis)


def test_axis_of_is_the_inverse_of_axis_index():
    for axis in range(8):
        for index in NAMES:
            assert axis_of(axis_index(index, axis)) == (index, axis)
    assert axis_of(0x1018) == (0x1018, 0)
    assert axis_of(0xA000) == (0xA000, 0)


def test_axes_are_counted_without_gaps():
    assert axis_count({0x1000}) == 0
    assert axis_count({0x6040, 0x6840, 0x8040}) == 2
    assert axis_count({axis_index(CONTROLWORD, axis) for axis in range(8)}) == 8


def test_names_are_words_and_include_the_axis():
    assert object_name(STATUSWORD) == "statusword"
    assert object_name(0x6841) == "statusword (axis 1)"
    assert object_name(0x60FF) == "target velocity"
    assert object_name(0x6001) is None
    assert object_name(0x1000) is None
    assert len(NAMES) > 90


def test_the_profile_is_in_the_low_word_of_the_device_type():
    assert is_drive_profile(0xFFFF0192)
    assert is_drive_profile(0x00040192)
    assert not is_drive_profile(0x01920191)
