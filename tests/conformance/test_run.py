"""A run of checks at a virtual drive in virtual time."""

import pytest

from canopen_control.conformance.check import Check, CheckFailed, CheckLevel, CheckTouch
from canopen_control.conformance.run import CHECKS, choose, run_checks
from canopen_control.errors import ConfigError

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
