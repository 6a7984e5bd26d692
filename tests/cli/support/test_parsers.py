"""Parsers of the verbs: distinction of values and options."""

import argparse

import pytest

from canopen_control.cli.support.parsers import parser_of
from canopen_control.cli.verbs import VERBS

BENCH = "--can local:x --eds a.eds"
NEGATIVE = {
    f"jog 5 {BENCH} --velocity -20rpm": ("velocity", "-20rpm"),
    f"jog 5 {BENCH} --velocity -.5": ("velocity", "-.5"),
    f"jog 5 {BENCH} --position -90deg --for 2": ("position", "-90deg"),
    f"jog 5 {BENCH} --torque -1e2": ("torque", -100.0),
    f"tune 5 {BENCH} --step -30rpm": ("step", "-30rpm"),
    "scope 3:0x6064 --cursors -0.1,0.25": ("cursors", "-0.1,0.25"),
    "sdo write 3 0x60FF -0x10 --type i32": ("value", "-0x10"),
    "world payload 12 --at -0.1,0,0": ("at", "-0.1,0,0"),
    "world push -30,0,0 --for 0.3": ("value", "-30,0,0"),
    "trajectory play --waypoints -0.4": ("waypoints", "-0.4"),
    "axis home left --method -1": ("method", -1),
}


@pytest.mark.parametrize("line", NEGATIVE)
def test_a_negative_value_with_a_unit_may_follow_its_option(line):
    dest, value = NEGATIVE[line]
    verb, *words = line.split()
    assert getattr(parser_of(verb).parse_args(words), dest) == value


def test_waypoints_may_begin_with_a_negative_position():
    words = ["play", "--waypoints", "-0.4 -0.3; 0 0"]
    assert parser_of("trajectory").parse_args(words).waypoints == "-0.4 -0.3; 0 0"


def own_parsers(parser):
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for choice in action.choices.values():
                yield from own_parsers(choice)


@pytest.mark.parametrize("verb", VERBS)
def test_no_option_resembles_a_negative_number(verb):
    """Otherwise argparse takes every negative number for an option."""
    options = [
        option
        for parser in own_parsers(parser_of(verb))
        for option in parser._option_string_actions
        if parser._negative_number_matcher.match(option)
    ]
    assert options == []
