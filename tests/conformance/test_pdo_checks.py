"""Checks of process data, at our own drive and at one that errs."""

from support.verdicts import verdict


def test_a_drive_that_keeps_the_clause_passes(bench):
    node = bench()
    assert [verdict(node, check_id) for check_id in ("P14", "P05")] == ["passed", "passed"]


def test_a_drive_that_does_not_is_found(bench):
    node = bench()
    for mapping in range(0x1A00, 0x1A04):
        node.device.store.set_guard(mapping, None)
    assert verdict(node, "P14") == "failed"
