"""A run of checks at a virtual drive in virtual time."""

from dataclasses import replace

import pytest

from canopen_control.conformance.check import Check, CheckFailed, CheckLevel, CheckTouch, clause_names
from canopen_control.conformance.report import DEVIATIONS
from canopen_control.conformance.run import CHECKS, choose, run_checks
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.od.eds import read_eds
from canopen_control.virtual.device import make_device
from canopen_control.virtual.fault_effects import power_stage_off, supply_low
from canopen_control.virtual.node_host import NodeHost
from canopen_control.virtual.quirks import QUIRKS, switches_of

NOT_STORED = frozenset((CheckTouch.READ, CheckTouch.CONFIGURE))


def test_a_node_that_does_not_answer_is_an_error_of_usage(bench):
    with pytest.raises(ConfigError, match=r"node 6 .* does not answer; list the nodes"):
        run_checks(bench(node_id=6), choose("all", NOT_STORED))


@pytest.mark.parametrize("eds", ["generic_cia402.eds", "generic_cia402_program.eds", "generic_cia401.eds"])
def test_without_an_option_no_node_is_commanded_and_no_value_written(bench, eds):
    node = bench(eds)
    version = node.device.store.version
    run_checks(node, choose("all", [CheckTouch.READ]))
    sent = [frame for label, frame in node.bus.history if label == "conform"]
    assert {frame.can_id for frame in sent} <= {0x605, 0x7E5}
    assert node.device.store.version == version


def test_ids_of_checks_are_unique():
    assert len({check.id for check in CHECKS}) == len(CHECKS)


def test_a_device_that_dies_ends_in_a_report_that_states_this(bench):
    session = bench()
    checks = choose("301", NOT_STORED)
    run_checks(session, checks[:1])
    done = []

    def die(count, _total):
        done.append(count)
        if count == 3:
            session.device.receive = lambda _frame, _now: None
            session.device.receive_records = lambda *_: 0

    report = run_checks(session, checks, die)
    assert report.failed
    assert [result.observed for result in report.results].count("not run: the device stopped answering") > 10
    assert report.results[-1].observed.startswith("a parameter could not be restored")


def test_parameters_that_a_check_changed_are_restored_and_named(bench):
    session = bench()
    before = session.read(0x1017)
    careless = Check(
        "X", "301", "", "", CheckLevel.MUST, CheckTouch.CONFIGURE, lambda s: s.write(0x1017, 0, b"\x39\x05")
    )
    report = run_checks(session, [careless])
    assert report.results[-1].notes == ["0x1017:00 was restored"]
    assert session.read(0x1017) == before


def test_a_run_that_only_reads_names_what_changed_and_writes_nothing(bench):
    node = bench()
    other = Check("X", "301", "", "", CheckLevel.MUST, CheckTouch.READ, lambda n: n.device.store.set(0x1017, 0, 1234))
    report = run_checks(node, [other])
    assert report.results[-1].notes == ["0x1017:00 changed during the run, and was left so"]
    assert int.from_bytes(node.read(0x1017), "little") == 1234


@pytest.mark.parametrize(("clause", "runs", "verdict"), [("7.5.2.37", 2, "passed"), ("7.5.2.38", 1, "failed")])
def test_a_check_of_times_is_repeated_before_it_counts_as_failed(bench, clause, runs, verdict):
    begun = []

    def late_once(_node):
        begun.append(clause)
        if len(begun) == 1:
            raise CheckFailed("90 ms", "100 ms")

    check = Check("X", "301", clause, "", CheckLevel.MUST, CheckTouch.READ, late_once)
    result = run_checks(bench(), [check]).results[0]
    assert (len(begun), result.verdict) == (runs, verdict)
    repeated = ["failed at first and passed when repeated; first result: 90 ms"]
    assert result.notes == (repeated if verdict == "passed" else [])


def test_a_check_of_times_that_fails_three_times_has_failed(bench):
    def late(_node):
        raise CheckFailed("90 ms", "100 ms")

    check = Check("X", "301", "7.5.2.37", "", CheckLevel.MUST, CheckTouch.READ, late)
    assert run_checks(bench(), [check]).results[0].verdict == "failed"


# The quirks of real drives as mutants: each makes a check of its clause fail, and a drive without quirks passes.


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


# Devices that fail during a run, and devices that cannot be tested: the report, or one sentence.


EDS = data_path("eds", "generic_cia402.eds")
READING = choose("301", [CheckTouch.READ])


def run_with(node, act, at=3):
    """Run the checks that read; `act` is called before one of them."""
    return run_checks(node, READING, lambda done, _total: act() if done == at else None)


def reasons(report):
    return {result.observed for result in report.results if result.observed.startswith("not run: ")}


def test_a_device_that_answers_late_is_named_with_its_time(bench):
    node = bench()
    report = run_with(node, lambda: switches_of(node.device).set("sdo_late=0.8", True, node.reactor.now()))
    assert reasons(report) == {"not run: the device answers after 0.8 s, later than 0.5 s; give --timeout 1.6"}
    assert report.failed


def test_a_device_that_changes_its_node_id_is_found_there(bench):
    node = bench()

    def other_id():
        node.host.close()
        device = make_device(EDS, 9)
        device.store.preset(0x1018, 4, node.device.store.number(0x1018, 4))
        node.host = NodeHost(node.reactor, node.bus.open("other"), [device])

    report = run_with(node, other_id)
    assert reasons(report) == {"not run: the device changed its node-ID: node 9 has its identity now"}
    node.host.close()


def test_a_device_that_floods_the_bus_ends_in_a_report_that_states_this(bench):
    node = bench()
    flood = pack_records([CanFrame(0x85, bytes(8))] * 5)
    port = node.bus.open("flood")

    def send():
        port.send(flood)
        node.reactor.call_later(1_000_000, send)

    report = run_checks(node, READING[:12], lambda done, _total: send() if done == 3 else node.listen(0.3))
    assert "0x085 was received 5" in report.results[-2].observed
    assert report.results[-2].verdict == "failed"
    assert len(report.results) == 14


def test_a_device_that_dies_while_it_floods_is_both(bench):
    node = bench()
    port = node.bus.open("flood")

    def die():
        node.host.close()
        port.send(pack_records([CanFrame(0x85, bytes(8))] * 3000))

    assert reasons(run_with(node, die)) == {
        "not run: the device stopped answering; 0x085 was received 3000 times in a second"
    }


def test_two_nodes_with_one_id_are_refused(bench):
    node = bench()
    twin = NodeHost(node.reactor, node.bus.open("twin"), [make_device(EDS, 5)])
    node.reactor.run_for(100_000_000)
    with pytest.raises(ConfigError, match=r"two nodes on memory:.* answer as node 5; disconnect one of them"):
        run_checks(node, READING)
    twin.close()


def test_the_eds_of_another_device_is_refused(bench):
    node = bench("TMCM-1270.eds")
    vendor = int.from_bytes(node.read(0x1018, 1), "little")
    assert vendor
    node.eds = read_eds(EDS, 5)
    node.eds.od.entries[0x1018, 1] = replace(node.eds.od[0x1018, 1], default=0x1234)
    with pytest.raises(ConfigError, match="describes another device: its vendor is 0x00001234, node 5 has 0x"):
        run_checks(node, READING)
