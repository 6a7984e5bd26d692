"""What `check` says, as lines and as data."""

from canopen_control.runtime.finding import Finding, Severity, sorted_findings


def test_a_finding_is_told_with_its_place_its_weight_and_its_fix():
    assert str(Finding("bus.yml", 7, Severity.WARNING, "it is late", "start earlier")) == (
        "bus.yml:7: warning: it is late; start earlier"
    )
    assert str(Finding("bus.yml", 0, Severity.ERROR, "it is empty")) == "bus.yml: error: it is empty"
    placed = Finding("bus.yml", 7, Severity.NOTE, "odd", column=3, source="    a: b\n      ^")
    assert str(placed) == "bus.yml:7:3: note: odd\n    a: b\n      ^"


def test_a_finding_is_plain_data_for_programs():
    assert Finding("a", 1, Severity.NOTE, "b").as_dict() == {
        "path": "a",
        "line": 1,
        "column": 0,
        "severity": "note",
        "text": "b",
        "fix": "",
    }


def test_findings_come_by_file_and_line_the_worst_first_and_each_once():
    note, error = Finding("a", 2, Severity.NOTE, "n"), Finding("a", 2, Severity.ERROR, "e")
    first, other = Finding("a", 1, Severity.NOTE, "n"), Finding("b", 1, Severity.ERROR, "e")
    assert sorted_findings([other, note, error, first, note]) == [first, error, note, other]
