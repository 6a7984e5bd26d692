"""Checks of a drive by CiA 402."""

import pytest

from canopen_control.conformance.check import CheckTouch
from canopen_control.conformance.drive_checks import DRIVE_CHECKS
from canopen_control.conformance.run import run_checks

READING = [check for check in DRIVE_CHECKS if check.touch is CheckTouch.READ]


def verdicts(report):
    return {result.id: result.verdict for result in report.results if result.group == "402"}


@pytest.mark.parametrize(("eds", "verdict"), [("generic_cia402.eds", "passed"), ("generic_cia401.eds", "skipped")])
def test_our_drive_passes_and_a_device_that_is_none_is_skipped(bench, eds, verdict):
    assert set(verdicts(run_checks(bench(eds), READING)).values()) == {verdict}


def test_an_option_code_that_the_profile_does_not_list_is_found(bench):
    node = bench()
    node.device.store.set(0x605A, 0, 77)
    report = run_checks(node, READING)
    assert verdicts(report)["D04"] == "failed"
    assert not report.failed  # a recommendation
