"""Commands in messages and docstrings of the package: their verbs and options exist."""

import argparse
import ast
import functools
import re
from pathlib import Path

import pytest

import canopen_control
from canopen_control.cli.support.parsers import parser_of
from canopen_control.cli.verbs import VERBS

PACKAGE = Path(canopen_control.__file__).parent
COMMAND = re.compile(r"canopen-control ([a-z][a-z-]*)((?: [^\s;,)`]+)*)")
FORWARDED = {"ros": {"--name"}}  # options that a verb passes to the program that it starts
NO_VERBS = {"with"}  # "install canopen-control with pip"


def texts_of(tree):
    """Yield the strings of a module; an f-string is one text, with VALUE for each value."""
    parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(part.value if isinstance(part, ast.Constant) else "VALUE" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in parts:
            yield node.value


parser_of_verb = functools.cache(parser_of)


def options_of(parser, words):
    """Return the options of a parser, and of its actions among the words."""
    options = {*parser._option_string_actions}
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name in words & action.choices.keys():
                options |= options_of(action.choices[name], words)
    return options


@pytest.mark.sources
def test_commands_in_messages_have_verbs_and_options_that_exist():
    found, wrong = 0, []
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        commands = COMMAND.findall("\n".join(texts_of(ast.parse(text)))) if "canopen-control " in text else []
        for verb, rest in commands:
            if verb in NO_VERBS:
                continue
            found += 1
            words = set(rest.split())
            options = set(re.findall(r" (--[a-z][a-z-]*)", rest))
            if verb not in VERBS or options - FORWARDED.get(verb, set()) - options_of(parser_of_verb(verb), words):
                wrong.append(f"{path}: canopen-control {verb}{rest}")
    assert not wrong
    assert found > 250
