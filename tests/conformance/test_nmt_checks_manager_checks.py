"""Checks of the objects of CiA 302."""

from canopen_control.conformance.check import CheckTouch
from canopen_control.conformance.nmt_checks import MANAGER_CHECKS
from canopen_control.conformance.run import choose, run_checks


def verdicts(node):
    return {result.id: result.verdict for result in run_checks(node, MANAGER_CHECKS).results if result.group == "302"}


def test_the_objects_of_the_program_pass_and_absent_ones_are_skipped(bench):
    result = verdicts(bench("generic_cia402_program.eds"))
    assert {name for name, verdict in result.items() if verdict == "passed"} == {"G05", "G06", "G07", "G08"}
    assert {result[name] for name in result.keys() - {"G05", "G06", "G07", "G08"}} == {"skipped"}
    assert set(verdicts(bench()).values()) == {"skipped"}


def test_a_flash_error_is_found(bench):
    node = bench("generic_cia402_program.eds")
    node.device.store.set_source(0x1F57, 1, lambda: 4 << 1)
    assert verdicts(node)["G07"] == "failed"


def test_no_check_of_the_level_downloads_a_program(bench):
    node = bench("generic_cia402_program.eds")
    run_checks(node, choose("302", list(CheckTouch)))
    requests = [frame.data for label, frame in node.bus.history if frame.can_id == 0x605]
    assert requests
    assert not [data for data in requests if data[0] >> 5 in (1, 6) and data[1:3] in (b"\x50\x1f", b"\x51\x1f")]
