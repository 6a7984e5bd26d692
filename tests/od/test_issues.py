"""Issues as data and as text."""

from canopen_control.od.issues import Issue, Report, Severity


def test_an_issue_names_file_line_severity_and_code():
    issue = Issue("a.eds", 7, "value-form", Severity.ERROR, "DefaultValue=x is not a number")
    assert str(issue) == "a.eds:7: error: DefaultValue=x is not a number [value-form]"


def test_a_report_collects_by_severity():
    report = Report("a.eds")
    report.error(1, "a", "x")
    report.warning(2, "b", "y")
    report.note(3, "c", "z")
    assert [(issue.line, issue.severity) for issue in report.issues] == [
        (1, Severity.ERROR),
        (2, Severity.WARNING),
        (3, Severity.NOTE),
    ]
    report.note(0, "d", "the file as a whole")
    assert report.issues[-1].line == 1
    assert {issue.path for issue in report.issues} == {"a.eds"}
