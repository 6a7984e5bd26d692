"""The quirks of real drives as mutants: each makes a check of its clause fail, and a drive without quirks passes."""

import pytest

from canopen_control.conformance.check import CheckTouch, is_of_clause
from canopen_control.conformance.run import CHECKS, choose, run_checks
from canopen_control.virtual.quirks import QUIRKS

# The check that finds each quirk; D checks are those of CiA 402.
FOUND_BY = {
    "sdo_after_boot": "N09",
    "sdo_late": "S27t",
    "sdo_stale": "N12",
    "sdo_four_bytes": "S01s",
    "sdo_size_unsaid": "S01s",
    "sdo_garbage": "S01u",
    "sdo_more_bytes": "S14",
    "sdo_acknowledges_with_data": "S02u",
    "sdo_short_frames": "S01l",
    "sdo_aborts_general": "S06c",
    "sdo_aborts_zero": "S05",
    "sdo_no_block": "S17y",
    "storing_silent": "R02t",
    "mapping_fixed": "P11",
    "mapping_in_preop": "P16o",
    "mapping_short": "P11m",
    "cob_id_fixed": "P05",
    "cob_ids_of_node": "P01d",
    "foreign_pdo_unmappable": "P16f",
    "mapping_swapped": "P02d",
    "tpdo_by_event": "P21t",
    "inhibit_time": "P20n",
    "length_error_8220": "P17e",
    "boot_delay": "N08",
    "boot_unsaid": "N01",
    "already_operational": "N10",
    "start_without_errors": "N13",
    "start_after_boot": "N11",
    "heartbeat_absent": "H00",
    "heartbeat_at_start": "H02d",
    "consumer_rounded": "H03r",
    "consumer_refused": "H03r",
    "sync_counter_absent": "Y05e",
    "emcy_own_register": "M09",
    "emcy_own_data": "M09",
    "emcy_zeros_at_boot": "M08",
    "modes_listed_without": "D12",
    "modes_not_listed": "D02",
    "own_velocity_mode": "D12n",
    "own_torque_mode": "D12n",
    "own_position_mode": "D12n",
    "one_mode": "D11",
    "mode_shown_late": "D11",
    "mode_display_zero_until_enabled": "D11",
    "mode_display_late": "D11t",
    "mode_fixed_while_halted": "D68h",
    "mode_fixed_while_enabled": "D68e",
    "enable_needs_mode": "D46",
    "enable_delay": "D23t",
    "switch_on_delay": "D22t",
    "link_empty_after_fault": "D38e",
    "transition_slow": "D21t",
    "not_ready_time": "D20t",
    "quick_stop_ends_switched_on": "D30",
    "quick_stop_unseen": "D30",
    "quick_stop_off": "D30",
    "fault_reset_twice": "D36",
    "fault_reset_slow": "D36t",
    "fault_reset_level": "D36t",
    "fault_reaction_endless": "D35",
    "enable_faults": "D23",
    "enabled_in_preop": "D42",
    "remote_when_enabled": "D08",
    "remote_never": "D08",
    "voltage_never": "D23v",
    "warning_always": "D08w",
    "internal_limit_always": "D08l",
    "own_bits_change": "D08m",
    "controlword_write_only": "D03",
    "period_refused": "D15p",
    "period_rounded": "D15p",
    "parameter_clamped": "D13",
    "homing_zero_refused": "D65m",
    "homing_method_fixed": "D65w",
    "error_code_absent": "D093f",
    "velocity_absent": "D096c",
}


@pytest.mark.parametrize("name", FOUND_BY)
def test_each_quirk_makes_a_check_of_its_clause_fail(bench, name):
    check = next(check for check in CHECKS if check.id == FOUND_BY[name])
    assert is_of_clause(check, QUIRKS[name].clause)
    assert run_checks(bench(quirks=[name]), [check]).results[0].verdict == "failed"
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
