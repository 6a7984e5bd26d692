from __future__ import annotations

import pytest

from canopen_control.errors import BusConfigError, RobotConfigError
from canopen_control.yamlfile.node import Node, Problem, Problems, raising


def node(problems: Problems, line: int = 1, column: int = 1, where: str = "a") -> Node:
    return Node("scalar", line, column, where, problems)


def test_a_problem_keeps_tabs_so_that_the_caret_stands_right():
    text = str(Problem(1, 3, "f", "w", "bad", "\tab"))
    assert text == "f:1:3: w: bad\n    \tab\n    \t ^"
    assert str(Problem(0, 0, "f", "", "bad")) == "f: bad"


def test_problems_are_reported_once_in_the_order_of_lines_and_warnings_do_not_raise():
    problems = Problems("f", "one\ntwo\n")
    problems.warning(node(problems), "odd")
    problems.raise_if_any()
    for line in (2, 1, 2):
        problems.error(node(problems, line), "bad")
    assert [item.line for item in problems.errors] == [1, 2]
    with pytest.raises(RobotConfigError, match="2 errors"):
        problems.raise_if_any(RobotConfigError)
    with pytest.raises(BusConfigError) as caught:
        problems.raise_if_any()
    assert (caught.value.path, caught.value.line, caught.value.key) == ("f", 1, "a")


def test_what_is_suspicious_is_an_error_only_when_strict():
    strict, lenient = Problems("f"), Problems("f", strict=False)
    for problems in (strict, lenient):
        problems.deviation(node(problems), "odd")
    assert (len(strict.errors), len(strict.warnings)) == (1, 0)
    assert (len(lenient.errors), len(lenient.warnings)) == (0, 1)


def test_a_part_is_judged_apart_from_what_was_found_before():
    problems = Problems("f")
    problems.error(node(problems), "before")
    with pytest.raises(RobotConfigError) as caught, raising([problems], RobotConfigError):
        problems.error(node(problems), "inside")
    assert str(caught.value) == "f:1:1: a: inside"
    with raising([problems], RobotConfigError):
        pass
    assert [item.message for item in problems.errors] == ["before"]
