"""Drives that take targets without a controller, and the meaning of a target in each mode."""

import pytest
from support.pages import BASE, FORWARD, TARGET, drive_state, state
from support.samples import controllers_of

from canopen_control.view.targets import MODES, DriveTarget, drive_targets


def of(state, *controllers):
    return drive_targets(state, controllers_of(controllers))


def test_a_drive_is_known_by_its_controller_and_its_axis():
    assert of(drive_state(), TARGET) == (DriveTarget("left", "left_drive", "left", enabled=True, mode="PV"),)
    (off,) = of(drive_state({"cia402_state": "SWITCH_ON_DISABLED", "mode": None}), TARGET)
    assert (off.enabled, off.mode, off.quantity, off.unit) == (False, "", "", "")


@pytest.mark.parametrize(
    ("mode", "quantity", "unit"),
    [("PP", "position", "rad"), ("CSV", "velocity", "rad/s"), ("TQ", "effort", "effort"), ("HM", "", "")],
)
def test_the_mode_reports_what_a_target_is(mode, quantity, unit):
    (drive,) = of(drive_state({"mode": mode}), TARGET)
    assert (drive.quantity, drive.unit) == (quantity, unit)
    assert (drive.mode in MODES) is bool(quantity)


def test_other_controllers_and_those_that_are_not_active_take_none():
    assert of(drive_state(), FORWARD, BASE) == ()
    assert of(drive_state(), TARGET | {"state": "inactive"}) == ()
    assert of(state(nodes={}), TARGET) == ()
