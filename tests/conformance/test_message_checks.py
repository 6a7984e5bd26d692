"""Checks of SYNC, EMCY, storing and identifiers, at our own drive and at one that errs."""

from support.verdicts import verdict


def test_a_drive_that_keeps_the_clause_passes(bench):
    node = bench()
    assert [verdict(node, check_id) for check_id in ("R05e", "Y04")] == ["passed", "passed"]


def test_a_drive_that_does_not_is_found(bench):
    node = bench()
    node.device.store.set_guard(0x1014, None)
    assert verdict(node, "R05e") == "failed"
