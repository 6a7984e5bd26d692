"""Words that a native reader stumbles over stand neither in the pages nor in the help nor on the page of the robot.

Only words without a right use are here, each with what is written instead; "at least" or "way" are none of them.
"""

import argparse
import ast
import re

import pytest
from support.documents import README, ROOT, pages

from canopen_control.cli.support.parsers import parser_of
from canopen_control.cli.verbs import GROUPS, VERBS, overview

#: pattern -> what is written instead
INSTEAD = {
    r"\banew\b": "again, from the start",
    r"\bmakers?\b": "manufacturer",
    r"\bmend(s|ed|ing)?\b": "repair, clear",
    r"\bwhoever\b": "any client",
    r"\bhangs? on it\b": "the load",
    r"\bfor who\b": "for users who",
    r"\bseldom\b": "rarely",
    r"\bwaited for for\b": "wait for",
    r"\blets? go of\b": "release",
    r"\b(the|a) house\b": "code layout",
    r"\bis told\b(?! (to|apart))": "is reported",
    r"\b(is|are) no safety function": "is not a safety function",
    r"\bas of `": "same as for",
    r"(?<!there )\b(?:is|are) no (?!longer\b|faster\b|news\b|concern\b|failure there\b)": "is not a",
}
WORDS = re.compile("|".join(INSTEAD), re.IGNORECASE)
#: programs do not want, and what they say has a subject
MORE = (r"\b(?:nobody|somebody)\b", r"\bwants?\b", r"\b(?:is|are) wanted\b", r"\blet go\b")
IN_MESSAGES = re.compile("|".join([*INSTEAD, *MORE]), re.IGNORECASE)
#: how a message of the program begins that a page quotes, and whose words are the message's
QUOTED = re.compile(r"^`.*`$", re.MULTILINE)


def found(text, words=WORDS):
    """Return what is there of the list, with its surroundings."""
    return [text[max(0, match.start() - 40) : match.end() + 20] for match in words.finditer(text)]


@pytest.mark.parametrize(
    "path", [pytest.param(path, id=str(path.relative_to(ROOT))) for path in {README, *pages()} if path.stem != "seeds"]
)
def test_the_pages_have_none_of_them(path):
    assert found(QUOTED.sub("", path.read_text(encoding="utf-8"))) == []


def helps(parser):
    """Yield the help of a parser and of its actions."""
    yield parser.format_help()
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for choice in action.choices.values():
                yield from helps(choice)


@pytest.mark.parametrize("verb", VERBS)
def test_the_help_has_none_of_them(verb):
    assert [word for text in helps(parser_of(verb)) for word in found(" ".join(text.split()))] == []


def test_the_overview_has_none_of_them():
    assert found(overview(everything=True)) == []
    assert all(GROUPS.values())


@pytest.mark.parametrize("folder", sorted(path.name for path in (ROOT / "canopen_control").iterdir()))
def test_messages_and_the_texts_of_the_page_have_none_of_them(folder):
    paths = [path for path in (ROOT / "canopen_control").rglob("*.py") if path.relative_to(ROOT).parts[1] == folder]
    texts = [(path, path.read_text(encoding="utf-8")) for path in paths]
    words = [f"{path}: {word}" for path, text in texts if IN_MESSAGES.search(text) for word in in_strings(text)]
    assert words == []


def in_strings(text):
    """Yield what the strings of a module have of the list; its docstrings are for readers of code."""
    tree = ast.parse(text)
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        text = node.value if isinstance(node, ast.Constant) and id(node) not in docstrings else None
        if isinstance(text, str) and " " in text:
            yield from found(text, IN_MESSAGES)


def test_a_word_of_the_list_would_be_seen():
    assert found("a transfer is begun anew by its maker") == [
        "a transfer is begun anew by its maker",
        "a transfer is begun anew by its maker",
    ]
    assert found("LSS tells them apart; a drive is told to stand; at least one way") == []
