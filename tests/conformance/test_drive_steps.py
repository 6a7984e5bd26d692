"""Steps of the checks of a drive."""

import pytest

from canopen_control.cia402.state import State
from canopen_control.conformance.checked_node import CheckFailed
from canopen_control.conformance.drive_steps import OE, SOD, drive_at, reaches, statusword


def test_a_drive_is_brought_to_a_state_and_loses_its_power_at_the_end(bench):
    node = bench()
    with drive_at(node, OE):
        assert statusword(node) & 0x6F == OE.value
    reaches(node, SOD, 0.0)


def test_a_state_that_is_not_reached_is_named(bench):
    with pytest.raises(CheckFailed, match=r"\(SWITCH_ON_DISABLED\) after 0.1 s; expected: FAULT"):
        reaches(bench(), State.FAULT, 0.1)
