from __future__ import annotations

import pytest

from canopen_control.cia402.objects import (
    CONTROLWORD,
    NAMES,
    SINGLE_DEVICE_TYPE,
    STATUSWORD,
    axis_count,
    axis_index,
    axis_of,
    is_drive_profile,
    object_name,
)


def test_each_axis_lies_0x800_higher():
    assert [axis_index(CONTROLWORD, axis) for axis in range(3)] == [0x6040, 0x6840, 0x7040]
    assert axis_index(SINGLE_DEVICE_TYPE, 7) == 0x9FFF


def test_objects_of_the_device_are_the_same_for_all_axes():
    assert axis_index(0x1018, 3) == 0x1018
    assert axis_index(0x2004, 3) == 0x2004


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


def test_names_are_words_and_say_the_axis():
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
