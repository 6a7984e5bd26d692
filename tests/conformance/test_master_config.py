"""Checks of boot, configuration and NMT: each detects a master with one fault."""

import pytest
from support.broken_masters import CONFIGURATION, NETWORK_MANAGEMENT, failures, ids

ROWS = [*CONFIGURATION, *NETWORK_MANAGEMENT]


@pytest.mark.parametrize(("check_id", "kind", "faults"), ROWS, ids=ids(ROWS))
def test_a_broken_master_is_found(check_id, kind, faults):
    failed = failures(kind, faults)
    assert check_id in failed, failed
