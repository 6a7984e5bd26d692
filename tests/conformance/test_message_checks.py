"""Checks of SYNC, EMCY, storing and identifiers, at our own drive and at one that errs."""

from canopen_control.conformance.run import CHECKS, run_checks


def verdict(node, check_id):
    report = run_checks(node, [check for check in CHECKS if check.id == check_id])
    return report.results[0].verdict


def test_a_drive_that_keeps_the_clause_passes(bench):
    node = bench()
    assert [verdict(node, check_id) for check_id in ("R05e", "Y04")] == ["passed", "passed"]


def test_a_drive_that_does_not_is_found(bench):
    node = bench()
    node.device.store.set_guard(0x1014, None)
    assert verdict(node, "R05e") == "failed"
