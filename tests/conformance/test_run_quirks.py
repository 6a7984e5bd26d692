"""The quirks of real drives as mutants: each makes a check of its clause fail, and a drive without quirks passes."""

import pytest

from canopen_control.conformance.check import CheckTouch, is_of_clause
from canopen_control.conformance.run import CHECKS, choose, run_checks
from canopen_control.virtual.quirks import QUIRKS

# Deviations that no check can call one: the standard demands a count of 0 before a mapping entry is written.
LEGAL = {"mapping_count_first", "sync_period_judged"}
OF_301 = [quirk for quirk in QUIRKS.values() if "CiA 301" in quirk.clause and quirk.name not in LEGAL]


def failures(node, checks):
    report = run_checks(node, checks)
    return {result.id for result in report.results if result.verdict in ("failed", "error")}


@pytest.mark.parametrize("quirk", OF_301, ids=lambda quirk: quirk.name)
def test_each_quirk_makes_a_check_of_its_clause_fail(bench, quirk):
    checks = [check for check in choose("all", CheckTouch) if is_of_clause(check, quirk.clause)]
    assert failures(bench(quirks=[quirk.name]), checks) - {"S15r", "Z01"}


def test_a_drive_without_quirks_passes_all_that_must(bench):
    report = run_checks(bench(), choose("all", CheckTouch))
    assert not report.failed
    assert {result.id for result in report.results if result.verdict == "failed"} == {"O07v", "S15r", "R04"}


def test_the_table_has_the_checks_of_both_documents():
    groups = [check.group for check in CHECKS]
    assert groups.count("301") >= 150
    assert groups.count("305") >= 5
