"""The messages that the page on troubleshooting quotes are those of the code."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
#: a message is a term of a definition list; "..." stands for what goes on
QUOTED = re.findall(r"^`([^`]+)`\n: ", PAGE, re.MULTILINE)
FIELD = "\0"  # stands for a value in a message


def text_of(node):
    """Return a string of the source with FIELD for each value in it, None for anything else."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else FIELD for part in node.values)
    return None


@cache
def sayings():
    """Return every part of a sentence in the strings of the package: two words at least, between two values."""
    result = set()
    for path in (ROOT / "canopen_control").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            result.update(re.split(rf"{FIELD}|{{\w*}}", text_of(node) or ""))
    return {part for item in result if len(part := item.strip(" :;,.")) >= 7 and " " in part}


def uncovered(message):
    """Return what of a message is in no string of the code; a message that ends early may end within one."""
    left = list(message)
    for saying in sayings():
        at = message.find(saying[:7])
        if at >= 0 and (message.startswith(saying, at) or saying.startswith(message[at:])):
            left[at : at + len(saying)] = " " * min(len(saying), len(message) - at)
    return "".join(left)


def letters(text):
    return sum(map(str.isalpha, text))


@pytest.mark.parametrize("message", QUOTED)
def test_a_quoted_message_is_one_of_the_codes(message):
    sentence = message.removesuffix("...").strip()
    rest = uncovered(sentence)
    assert letters(rest) < 0.6 * letters(sentence), f"nobody says {rest!r}"


def test_the_page_has_messages_and_each_once():
    assert len(QUOTED) > 30
    assert len(set(QUOTED)) == len(QUOTED)


def test_a_message_that_is_never_sent_would_be_detected():
    assert letters(uncovered("no heartbeat for 0.5 s; is it powered and connected?")) < 3
    assert "heart has gone" in uncovered("node 3 (left_drive): its heart has gone for 0.5 s; is it plugged in?")
