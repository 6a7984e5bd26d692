"""The verbs and their parsers."""

import importlib
import shlex

import pytest

from canopen_control.cli.main import main
from canopen_control.cli.verbs import VERBS, parser_of


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
    said = capsys.readouterr().out
    assert "example: canopen-control sdo upload 5" in said
    assert "sdo read" not in said
    with pytest.raises(SystemExit):
        main(["ros", "service", "call", "--help"])
    assert "example: canopen-control ros service call" in capsys.readouterr().out
