"""The quirks of real drives as mutants: each makes a check of its clause fail, and a drive without quirks passes."""

import pytest

from canopen_control.conformance.check import CheckTouch, is_of_clause
from canopen_control.conformance.html_report import DEVIATIONS
from canopen_control.conformance.run import CHECKS, choose, run_checks
from canopen_control.virtual.quirk_table import QUIRKS


@pytest.mark.parametrize("known", DEVIATIONS, ids=lambda known: known.quirk)
def test_each_quirk_makes_a_check_of_its_clause_fail(bench, known):
    check = next(check for check in CHECKS if check.id == known.check)
    assert is_of_clause(check, QUIRKS[known.quirk].clause)
    assert run_checks(bench(quirks=[known.quirk]), [check]).results[0].verdict == "failed"
    assert run_checks(bench(), [check]).results[0].verdict == "passed"


def test_a_drive_without_quirks_passes_all_that_must(bench):
    report = run_checks(bench(), choose("all", CheckTouch))
    assert not report.failed
    assert {result.id for result in report.results if result.verdict == "failed"} == {"O07v", "S15r", "R04"}


def test_the_table_has_the_checks_of_each_document():
    groups = [check.group for check in CHECKS]
    assert groups.count("301") >= 150
    assert groups.count("305") >= 5
    assert groups.count("402") >= 80
