"""Checks of guarding, heartbeats, SYNC and RPDOs: each detects a master with one fault."""

import pytest
from support.broken_masters import CYCLIC, Counts, Csp, Guards, failures, ids, worked


@pytest.mark.parametrize(("check_id", "kind", "faults"), CYCLIC, ids=ids(CYCLIC))
def test_a_broken_master_is_found(check_id, kind, faults):
    failed = failures(kind, faults)
    assert check_id in failed, failed


@pytest.mark.parametrize(("kind", "checks"), [(Guards, {"MG02", "MG03"}), (Counts, {"MY03"}), (Csp, {"MY05", "MW06"})])
def test_other_masters_that_keep_everything_pass(kind, checks):
    failed, passed = worked(kind).verdicts()
    assert failed == {}
    assert checks <= passed
