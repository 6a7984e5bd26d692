"""Reports of a run: lines, JUnit, and the comparison with an older one."""

from xml.etree import ElementTree as Xml

from canopen_control.conformance.report import changed_verdicts, junit, report_lines
from canopen_control.conformance.run import CheckResult, ConformanceReport


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
