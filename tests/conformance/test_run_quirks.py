"""The quirks of real drives as mutants: each makes a check of its clause fail, and a drive without quirks passes."""

import pytest

from canopen_control.conformance.check import CheckTouch, clause_names
from canopen_control.conformance.report import DEVIATIONS
from canopen_control.conformance.run import CHECKS, choose, run_checks
from canopen_control.virtual.fault_effects import power_stage_off, supply_low
from canopen_control.virtual.quirks import QUIRKS

SITUATIONS = {  # in which a quirk shows: the check is skipped in others, or has nothing to find
    "mains_awaited": lambda node: power_stage_off(node, True, node.clock.now),
    "inputs_shifted": lambda node: node.drives[0].mover.switches.close_positive(0.0),
    "fault_returns": lambda node: supply_low(node, True, node.clock.now),
}
# these show only when the power stage is switched off by hand while it is enabled
NOT_FOUND = {"sto_switched_on", "supply_loss_unseen"}


def belongs_to(check, clause):
    """Whether a check belongs to a clause, such as "CiA 301, 7.2.4.3 (SDO)", or to one of its subsections."""
    names, own = clause_names(clause), clause_names(check.clause)
    sections = {name for name in names if not name.startswith("0x")}
    if names & own - sections:
        return True  # an object has one meaning in all documents
    if ("402" in clause.split(",")[0]) != (check.group == "402"):
        return False
    return any(mine == section or mine.startswith(section + ".") for section in sections for mine in own)


@pytest.mark.parametrize("known", DEVIATIONS, ids=lambda known: known.quirk)
def test_each_quirk_makes_a_check_of_its_clause_fail(bench, known):
    check = next(check for check in CHECKS if check.id == known.check)
    assert belongs_to(check, QUIRKS[known.quirk].clause)
    verdicts = []
    for quirks in ([known.quirk], []):
        node = bench(quirks=quirks)
        SITUATIONS.get(known.quirk, bool)(node.device)
        verdicts.append(run_checks(node, [check]).results[0].verdict)
    assert verdicts == ["failed", "passed"]


def test_all_quirks_with_a_clause_are_found_except_those_that_need_a_hand():
    with_clause = {quirk.name for quirk in QUIRKS.values() if quirk.clause}
    quirks = {known.quirk for known in DEVIATIONS}
    assert with_clause - quirks == NOT_FOUND
    assert len(quirks & with_clause) >= 0.95 * len(with_clause)


def test_a_drive_without_quirks_passes_all_that_must(bench):
    report = run_checks(bench(), choose("all", CheckTouch))
    assert not report.failed
    assert {result.id for result in report.results if result.verdict == "failed"} == {"O07v", "R04"}


def test_the_table_has_the_checks_of_each_document():
    groups = [check.group for check in CHECKS]
    assert groups.count("301") >= 150
    assert groups.count("305") >= 5
    assert groups.count("402") >= 130
