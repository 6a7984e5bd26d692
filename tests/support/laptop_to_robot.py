"""The commands of the page "From the laptop to the robot", as they stand there."""

from __future__ import annotations

import re
import shlex

from support.documents import DOCS


def way_commands() -> list[list[str]]:
    """Return the commands of the page in their order, as words after ``canopen-control``."""
    text = (DOCS / "guide" / "hardware.md").read_text(encoding="utf-8")
    lines = re.findall(r"^ {7}canopen-control (.*?)(?:  +#.*)?$", text, re.MULTILINE)
    return [shlex.split(line) for line in lines]


def needs_a_card(words: list[str]) -> bool:
    """Whether a command is about a CAN card."""
    return any(re.fullmatch(r"can\d+", word) for word in words)


def runnable(words: list[str], robby: object, seconds: float) -> list[object]:
    """Return a command as a test runs it: with robby's times as the machine needs them, an end, and nobody to ask."""
    changed: list[object] = [robby if word == "robby" else word for word in words]
    return changed + {"run": ["--for", seconds], "preflight": ["--yes"]}.get(words[0], [])
