"""Checks of a drive that turns its shaft."""

import pytest

from canopen_control.cia402 import objects as o
from canopen_control.conformance.motion_checks import MOTION_CHECKS
from canopen_control.conformance.run import CHECKS, run_checks


def test_a_drive_without_bounds_is_not_moved(bench):
    node = bench()
    for index, subindex in ((o.MAX_PROFILE_VELOCITY, 0), (o.FEED_CONSTANT, 1), (o.POSITION_ENCODER_RESOLUTION, 1)):
        node.device.store.set(index, subindex, 0)
    result = run_checks(node, [check for check in MOTION_CHECKS if check.id == "D50"]).results[0]
    assert (result.verdict, result.observed) == (
        "skipped",
        "the objects give no bounds of a motion; give --speed and --distance",
    )
    assert node.device.drives[0].mover.plant.position == 0


def test_a_drive_with_a_slower_ramp_than_its_object_is_found(bench):
    node = bench(quirks=["parameter_clamped=100000"])
    checks = [check for check in MOTION_CHECKS if check.id == "D50"]
    assert run_checks(node, checks).results[0].verdict == "failed"


@pytest.mark.parametrize("check_id", ["D58", "D59", "D61"])
def test_set_points_follow_a_sync_with_a_counter(bench, check_id):
    node = bench()
    node.put(0x1019, 0, 10, 1)
    next(check for check in CHECKS if check.id == check_id).run(node)
    assert node.number(0x1003) == 0  # a SYNC without a counter would raise EMCY 0x8240
