"""Checks of NMT, error control and LSS, at our own drive and at one that errs."""

from support.verdicts import verdict


def test_a_drive_that_keeps_the_clause_passes(bench):
    node = bench()
    assert [verdict(node, check_id) for check_id in ("N05", "H01")] == ["passed", "passed"]


def test_a_drive_that_does_not_is_found(bench):
    node = bench()
    node.device.nmt.command = lambda _command: True  # obeys no command
    assert verdict(node, "N05") == "failed"
