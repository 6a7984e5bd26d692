"""Checks of block transfers, at our own drive and at one that errs."""

from support.verdicts import verdict

from canopen_control.virtual.quirks import switches_of


def test_a_drive_that_keeps_the_clause_passes(bench):
    node = bench()
    assert [verdict(node, check_id) for check_id in ("S17", "S29")] == ["passed", "passed"]


def test_a_drive_that_does_not_is_found(bench):
    node = bench()
    switches_of(node.device).set("sdo_no_block", on=True, now=node.reactor.now())
    assert verdict(node, "S17") == "skipped"
