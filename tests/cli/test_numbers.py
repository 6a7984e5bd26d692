import argparse
import contextlib

import pytest

from canopen_control.cli.main import VERBS, parser_of
from canopen_control.cli.numbers import node_id, whole


@pytest.mark.parametrize(("text", "number"), [("12", 12), ("0x1F", 31), ("-3", -3)])
def test_whole_numbers(text, number):
    assert whole(text) == number


@pytest.mark.parametrize("text", ["0", "128", "-1", "x", "1.5", ""])
def test_what_is_no_node_id_is_told_with_what_is(text):
    with pytest.raises(argparse.ArgumentTypeError) as caught:
        node_id(text)
    assert str(caught.value) == f"{text!r} is no node id: 1 to 127"


def test_node_ids():
    assert [node_id("1"), node_id("0x7f")] == [1, 127]


def own_types(parser):
    """Yield every function of ours that reads an argument."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for each in action.choices.values():
                yield from own_types(each)
        elif action.type not in (None, int, float, str):
            yield action.type


@pytest.mark.parametrize("verb", VERBS)
def test_no_argument_is_refused_with_the_name_of_a_function(verb):
    """A ValueError would become "invalid _number value: 'zz'"."""
    for read in own_types(parser_of(verb)):
        with contextlib.suppress(argparse.ArgumentTypeError):
            read("zz")  # whatever else it raises fails here
