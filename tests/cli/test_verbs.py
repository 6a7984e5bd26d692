"""The verbs and their parsers."""

import importlib
import shlex

import pytest

from canopen_control.cli.main import main
from canopen_control.cli.support.parsers import parser_of
from canopen_control.cli.verbs import VERBS


@pytest.mark.parametrize("verb", VERBS)
def test_the_examples_are_right_by_the_parsers_of_their_verbs(verb):
    """The last is one of the verb; others may prepare it."""
    examples = importlib.import_module(f"canopen_control.cli.{verb}").EXAMPLE.splitlines()
    for example in examples:
        program, first, *arguments = shlex.split(example, comments=True)
        assert program == "canopen-control", example
        parser_of(first).parse_args(arguments)  # exits where it is wrong
    assert first == verb


def test_the_help_of_an_action_shows_the_examples_of_that_action(capsys):
    with pytest.raises(SystemExit):
        main(["sdo", "upload", "--help"])
    output = capsys.readouterr().out
    assert "example: canopen-control sdo upload 5" in output
    assert "sdo read" not in output
    with pytest.raises(SystemExit):
        main(["ros", "service", "call", "--help"])
    assert "example: canopen-control ros service call" in capsys.readouterr().out


@pytest.mark.parametrize("verb", ["run", "demo", "check", "preflight"])
def test_arguments_of_a_description_stand_anywhere(verb):
    words = ["--can", "local:x", "prefix:=a", "--strict", "side:=left right"]
    args = parser_of(verb).parse_args(["robby", *words])
    assert (args.config, args.xacro, args.strict) == ("robby", ["prefix:=a", "side:=left right"], True)


def test_they_are_not_taken_for_the_robot_and_end_where_ros_begins():
    # which robot is shown when none is named, `demo` decides when it knows of all files
    args = parser_of("demo").parse_args(["prefix:=a", "--ros", "--ros-args", "-r", "a:=b"])
    assert (args.config, args.xacro, args.ros_args) == (None, ["prefix:=a"], ["-r", "a:=b"])


def test_a_verb_without_a_description_takes_none():
    with pytest.raises(SystemExit):
        parser_of("scan").parse_args(["a:=b"])
