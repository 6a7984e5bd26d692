"""Faults of inputs: what a stuck, noisy or jumping input makes of a value."""

import pytest

from canopen_control.errors import ConfigError
from canopen_control.virtual.io_device import JUMP, KINDS, NOISE, InputFaults

MS = 1_000_000


def test_a_healthy_input_shows_what_is_there_and_never_wakes():
    faults = InputFaults()
    assert faults.value("a", 5.0, 100.0, 0) == faults.line("a", 5.0) == 5.0
    assert (faults.next_deadline(), faults.due(10**12)) == (None, False)


def test_a_stuck_input_keeps_what_it_showed_first_until_it_is_mended():
    faults = InputFaults()
    faults.switch("stuck", on=True, now=0)
    assert [faults.value("a", each, 100.0, 0) for each in (1.0, 2.0)] == [1.0, 1.0]
    assert [faults.line("b", each) for each in (0.0, 1.0)] == [0.0, 0.0]
    faults.switch("stuck", on=False, now=0)
    assert faults.value("a", 2.0, 100.0, 0) == 2.0


def test_noise_stays_within_its_share_changes_and_is_the_same_each_time():
    courses = []
    for _ in range(2):
        faults = InputFaults()
        faults.switch("noise", on=True, now=0)
        course = []
        for _step in range(50):
            now = faults.next_deadline()
            assert faults.due(now)
            assert not faults.due(now)
            course.append(faults.value("a", 0.0, 1000.0, now))
        courses.append(course)
    assert courses[0] == courses[1]
    assert max(map(abs, courses[0])) <= NOISE * 1000.0
    assert len(set(courses[0])) > 20


def test_a_jump_adds_a_quarter_and_lines_do_not_jump():
    faults = InputFaults()
    faults.switch("jump", on=True, now=0)
    assert faults.value("a", 1.0, 100.0, 0) == 1.0 + JUMP * 100.0
    assert faults.line("a", 1.0) == 1.0


def test_a_fault_that_there_is_not_is_refused_with_those_there_are():
    with pytest.raises(ConfigError, match=", ".join(KINDS)):
        InputFaults().switch("wet", on=True, now=0)
