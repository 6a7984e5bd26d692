"""The report page of a run: a verdict per clause, decoded frames, and the summary for buyers."""

from xml.etree import ElementTree as Xml

from canopen_control.conformance.report import changed_verdicts, frame_name, html_page, junit, report_lines
from canopen_control.conformance.run import CHECKS, CheckResult, ConformanceReport, run_checks
from canopen_control.virtual.quirks import QUIRKS

DOES = {quirk.name: quirk.does for quirk in QUIRKS.values()}


def page_of(node, *ids):
    return html_page(run_checks(node, [check for check in CHECKS if check.id in ids]), DOES, ["a.eds:7: <odd>"])


def test_a_failure_names_its_frames_the_quirk_and_the_key_of_the_bus_file(bench):
    page = page_of(bench(quirks=["remote_never"]), "D01", "D08")
    assert "No mandatory check failed" in page
    assert "<code>remote_never</code>: never sets bit 9" in page
    assert "Key of bus.yml: <code>ignore_remote</code>" in page
    assert "SDO request: upload of 0x6041:00" in page
    assert "will refuse to enable the drive" in page
    assert "recommendation not kept" in page


def test_the_page_needs_no_network_and_escapes_what_it_shows(bench):
    page = page_of(bench(), "S01", "P09")
    assert "http" not in page.replace("<!DOCTYPE html>", "")
    assert "a.eds:7: &lt;odd&gt;" in page
    assert "P09, a remote frame" in page


def test_frames_have_names():
    assert frame_name("1.0 < 585 80 04 10 00 00 00 02 06").startswith("SDO answer: abort of 0x1004:00, 0x06020000 (obj")
    assert frame_name("1.0 < 705 7F") == "HEARTBEAT of node 5"
    assert frame_name("1.0 > 080") == "SYNC"
    assert frame_name("1.0 > 7FF 01") == ""


# Reports of a run: lines, JUnit, and the comparison with an older one.


def result(check_id, verdict, level="must", came=""):
    return CheckResult(check_id, "301", "7.2", "title", level, verdict, came, "60", frames=["< 585 80"])


REPORT = ConformanceReport(
    5,
    {"vendor": "0000001B"},
    [
        result("A", "passed"),
        result("B", "failed", came="\x00 came"),
        result("C", "failed", "should"),
        result("D", "skipped"),
        result("E", "error"),
    ],
)


def test_junit_has_failures_for_what_must_pass_only():
    root = Xml.fromstring(junit(REPORT))
    assert {key: root.attrib[key] for key in ("tests", "failures", "errors", "skipped")} == {
        "tests": "5",
        "failures": "1",
        "errors": "1",
        "skipped": "1",
    }
    failure = root.find("testsuite/testcase/failure")
    assert failure.attrib["message"] == "observed: ? came; expected: 60; CiA 301 7.2"
    assert failure.text == "< 585 80"


def test_lines_name_what_failed_and_count_the_rest():
    lines = list(report_lines(REPORT))
    assert lines[0] == "B failed (must, CiA 301 7.2): title"
    assert lines[-1] == "node 5: 5 checks: 1 passed, 2 failed, 1 skipped, 1 error"


def test_a_comparison_names_what_changed_came_and_went():
    old = {"A": "failed", "B": "failed", "C": "failed", "D": "skipped", "Z": "passed"}
    assert changed_verdicts(REPORT, old) == [
        "A (title): failed -> passed",
        "E (title): not run -> error",
        "Z: passed -> not run",
    ]
