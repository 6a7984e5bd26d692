"""How much of each subpackage the tests reach: lines and branches, with a reason below the least."""

from subpackage_coverage import covered_by_subpackage, judged


def summary(lines, of_lines, branches=0, of_branches=0):
    counts = {"covered_lines": lines, "num_statements": of_lines}
    return {"summary": {**counts, "covered_branches": branches, "num_branches": of_branches}}


FILES = {
    "canopen_control/bus/a.py": summary(9, 10, 0, 5),
    "canopen_control/bus/deep/b.py": summary(5, 5),
    "canopen_control/frame.py": summary(19, 20),
    "canopen_control/data/__init__.py": summary(0, 0),
}


def test_lines_and_branches_count_and_a_subpackage_without_any_is_omitted():
    assert covered_by_subpackage(FILES) == {"bus": 70.0, "frame": 95.0}


def test_a_subpackage_below_the_minimum_needs_a_reason():
    covered = covered_by_subpackage(FILES)
    text, good = judged(covered, {})
    assert not good
    assert "bus             70.0 %  below 90 % WITHOUT A REASON" in text
    text, good = judged(covered, {"bus": "its cards are in guests"})
    assert (text, good) == ("bus             70.0 %  its cards are in guests\nframe           95.0 %", True)
    assert judged(covered, {}, ["frame"]) == ("frame           95.0 %", True)
