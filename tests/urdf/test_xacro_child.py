from __future__ import annotations

import pytest
from urdf.test_description_xacro_run import HEAD, run_xacro, write

from canopen_control.urdf.xacro_child import REFUSED, URDF, _run, _where


@pytest.mark.process
def test_find_searches_around_the_file_if_ros_has_no_such_package(tmp_path):
    package = tmp_path / "src" / "my_robot"
    (package / "urdf").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>my_description</name></package>", encoding="utf-8")
    (package / "part.xacro").write_text(f'{HEAD}<link name="part"/></robot>', encoding="utf-8")
    path = write(package / "urdf", '<xacro:include filename="$(find my_description)/part.xacro"/>')
    assert '<link name="part"/>' in run_xacro(path, {})


@pytest.mark.rest
def test_a_package_that_is_nowhere_is_reported_once_in_words(tmp_path):
    kind, text = _run(str(write(tmp_path, '<xacro:include filename="$(find far)/a.xacro"/>')), {})
    assert kind == REFUSED
    assert text.count("package 'far' of $(find far) is neither installed nor above") == 1
    assert "LookupError" not in text


def test_of_a_long_macro_stack_the_first_lines_are_reported():
    assert _where("") == ""
    assert _where("\x1b[31mwhen instantiating macro: m\x1b[0m\n\n in file: x\n") == (
        " (when instantiating macro: m; in file: x)"
    )
    assert _where("line\n" * 900) == " (line; line; line; line; line; ...)"


ARGUED = (
    '<xacro:arg name="prefix" default="a"/><xacro:arg name="use_mock" default="false"/><link name="$(arg prefix)"/>'
)


def made(folder, given, text=ARGUED):
    kind, answer = _run(str(write(folder, text)), given)
    return kind == URDF, answer


def test_an_argument_that_nothing_asks_for_is_refused_with_the_nearest(tmp_path):
    assert made(tmp_path, {"prefx": "b"}) == (False, "no argument 'prefx' (did you mean 'prefix'?)")
    assert made(tmp_path, {"colour": "b"}) == (False, "no argument 'colour'; it has prefix, use_mock")
    assert made(tmp_path, {"colour": "b"}, '<link name="a"/>') == (False, "no argument 'colour'; it has none")


def test_an_argument_with_a_question_mark_need_not_be_there(tmp_path):
    assert made(tmp_path, {"colour?": "b"})[0]
    assert '<link name="b"/>' in made(tmp_path, {"prefix?": "b"})[1]


def test_a_mistyped_argument_is_reported_alongside_the_one_that_is_missing(tmp_path):
    good, text = made(tmp_path, {"sid": "left"}, '<link name="$(arg side)"/>')
    assert not good
    assert "side" in text
    assert text.endswith("no argument 'sid' (did you mean 'side'?)")


def test_all_arguments_without_a_value_are_named_at_once(tmp_path):
    body = "<xacro:if value=\"${'$(arg kind)' == 'real'}\"/><link name=\"$(arg side)_$(arg part)_$(arg side)\"/>"
    assert made(tmp_path, {"part": "arm"}, body) == (
        False,
        "arguments kind, side have neither a value nor a default; "
        "give each as NAME:=VALUE, or the launch file with --launch",
    )
    assert made(tmp_path, {"part": "arm", "kind": "real"}, body) == (
        False,
        "argument side has neither a value nor a default; give it as side:=VALUE, or the launch file with --launch",
    )
    assert made(tmp_path, {"part": "arm", "kind": "real", "side": "left"}, body)[0]


def test_an_error_in_an_expression_is_one_line(tmp_path):
    good, text = made(tmp_path, {}, '<link name="${nothing}"/>')
    assert not good
    assert text.splitlines() == ["name 'nothing' is not defined, when evaluating expression 'nothing'"]
