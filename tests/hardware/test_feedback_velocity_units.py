"""Units of velocities that a motion gives away."""

import math
from types import SimpleNamespace

import pytest

from canopen_control.cia402.units import Scale
from canopen_control.hardware.feedback import unit_mismatch

pytestmark = pytest.mark.sources  # stand-ins for an axis
TURN = 65536.0  # position counts


def axis(counts_per_rad=TURN / math.tau, velocity=TURN / math.tau):
    return SimpleNamespace(scale=Scale(counts_per_rad, 1 / counts_per_rad, velocity, 1 / velocity), turn=TURN)


@pytest.mark.parametrize(
    ("unit", "per_turn"),
    [("rpm", 60), ("0.1 rpm", 600), ("deg/s", 360), ("0.1 deg/s", 3600), ("rev/s", 1), ("0.001 rev/s", 1000)],
)
@pytest.mark.parametrize("turns", [3.0, -20.0])
def test_each_unit_is_named(unit, per_turn, turns):
    doubt = unit_mismatch(axis(), turns * TURN, round(turns * per_turn), rising=False)
    assert doubt.faster
    assert f"velocities were in {unit} instead of counts per second" in doubt.text


def test_a_motion_that_is_as_commanded_is_not_a_doubt():
    assert unit_mismatch(axis(), 3.0 * TURN, round(3.0 * TURN), rising=False) is None
    assert unit_mismatch(axis(), 3.0 * TURN, round(1.1 * TURN), rising=False) is None  # less than three times as fast
    assert unit_mismatch(axis(), 0.0, 100, rising=True) is None
    assert unit_mismatch(axis(), 3.0 * TURN, 30, rising=False) is None  # a unit that no drive has


def test_while_it_gets_faster_all_that_may_be_are_named_the_likeliest_first():
    doubt = unit_mismatch(axis(), 3.0 * TURN * 0.8, 3 * 360, rising=True)
    assert "velocities were in deg/s or 0.1 rpm" in doubt.text
    assert "in bus.yml for deg/s (scale_vel_to_dev: 57.29578, " in doubt.text


def test_the_scale_that_is_reported_is_that_of_the_joint_and_has_its_sign():
    """A motor that makes 50 turns for one of the joint, and is mounted mirrored."""
    geared = axis(-50 * TURN / math.tau, -50 * TURN / math.tau)
    doubt = unit_mismatch(geared, 20 * TURN, 20 * 60, rising=False)
    assert "scale_vel_to_dev: -477.4648, scale_vel_from_dev: -0.002094395" in doubt.text


def test_a_motion_that_is_slower_is_named_as_well():
    doubt = unit_mismatch(axis(velocity=60 / math.tau), 3.0 * TURN, round(3.0 * TURN), rising=False)
    assert not doubt.faster
    assert "turns much slower" in doubt.text
    assert "in counts per second instead of another unit" in doubt.text
