"""Checks of a master's SDO client: each detects a master with one fault."""

import pytest
from support.broken_masters import REQUESTS, Overlaps, failures, ids


@pytest.mark.parametrize(("check_id", "kind", "faults"), REQUESTS, ids=ids(REQUESTS))
def test_a_broken_master_is_found(check_id, kind, faults):
    failed = failures(kind, faults)
    assert check_id in failed, failed


def test_two_requests_at_once_are_found():
    assert "MT01" in failures(Overlaps, [("reset", 2)])
