"""The table of the checks of a master: each has a broken master that it finds."""

from support.broken_masters import COMMANDS, CONFIGURATION, CYCLIC, NETWORK_MANAGEMENT, REQUESTS

from canopen_control.conformance.check import CheckLevel
from canopen_control.conformance.master_checks import MASTER_CHECKS
from canopen_control.conformance.run import CHECKS


def test_ids_of_checks_are_unique_and_there_are_musts_and_shoulds():
    ids = [check.id for check in (*CHECKS, *MASTER_CHECKS)]
    assert len(set(ids)) == len(ids)
    assert len(MASTER_CHECKS) >= 70
    assert {check.level for check in MASTER_CHECKS} == set(CheckLevel)


def test_every_check_has_a_master_that_fails_it():
    rows = (*CONFIGURATION, *NETWORK_MANAGEMENT, *REQUESTS, *CYCLIC, *COMMANDS)
    assert {row[0] for row in rows} | {"MT01", "MW02", "MW03", "MW04"} == {check.id for check in MASTER_CHECKS}
