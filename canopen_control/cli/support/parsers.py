"""Parsers of the command line; the module of a verb is imported only if its parser is needed."""

from __future__ import annotations

import argparse
import importlib
import os
import re
import sys
from typing import TYPE_CHECKING, Any

from canopen_control.cli.verbs import VERBS, WITHOUT_JSON, overview
from canopen_control.version import PURE, TO_COMPILE, __version__, build

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


XACRO = "xacro"  # attribute with the NAME:=VALUE arguments
_EXIT_CODES = "Exit codes: 0 success; 1 failure, or nothing was done; 2 wrong usage or configuration."
_ARGUMENT = re.compile(r"[A-Za-z_]\w*:=")
_NEGATIVE = re.compile(r"-\.?\d.*", re.DOTALL)


def parser_of(verb: str) -> argparse.ArgumentParser:
    """Import the module of a verb and return the verb's parser."""
    module = importlib.import_module(f"canopen_control.cli.{verb}")
    parser = _VerbParser(
        prog=f"canopen-control {verb}",
        description=_with_exit_codes(module.__doc__ or ""),
        epilog=f"example: {module.EXAMPLE}",
        formatter_class=_HelpFormatter,
    )
    module.add_arguments(parser)
    for path, action in actions_of(parser, verb):
        if path not in WITHOUT_JSON and "--json" not in action._option_string_actions:  # noqa: SLF001 - no public way
            action.add_argument("--json", action="store_true", help="print the result as JSON")
    _describe_actions(parser, module.EXAMPLE.splitlines())
    return parser


def add_robot_name(parser: argparse._ActionsContainer) -> None:
    """Declare --name, the running robot."""
    parser.add_argument("--name", help="name of the robot (default: the only one running)")


def actions_of(parser: argparse.ArgumentParser, path: str) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield the full name, such as `ros topic list`, and the parser of each action without further actions."""
    groups = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]  # noqa: SLF001 - no public way
    if not groups:
        yield path, parser
    for name, action in (item for group in groups for item in group.choices.items()):
        yield from actions_of(action, f"{path} {name}")


def _with_exit_codes(text: str) -> str:
    """Return the description of a verb; the common exit codes are added if it contains none."""
    return text.strip() if "Exit codes" in text else f"{text.strip()}\n\n{_EXIT_CODES}"


class _HelpFormatter(argparse.HelpFormatter):
    """Help formatter for the width of the terminal; indented lines, such as examples, are unchanged."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=_width())

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        parts = [
            part
            if re.search(r"^ |^example:", part, re.MULTILINE)
            else super(_HelpFormatter, self)._fill_text(part, width, indent)
            for part in text.split("\n\n")
        ]
        return "\n\n".join(parts)


def _width() -> int:
    """Return the width of help texts like argparse, but without importing shutil, which takes time."""
    try:
        return int(os.environ.get("COLUMNS", "")) - 2
    except ValueError:
        pass
    try:
        return os.get_terminal_size(sys.__stdout__.fileno() if sys.__stdout__ else 1).columns - 2
    except (OSError, ValueError):
        return 78


class _VerbParser(argparse.ArgumentParser):
    """Parser of a verb, and of each of its actions; a word that starts like a negative number is a value.

    Positional arguments that may be omitted are allowed anywhere on the line, as is NAME:=VALUE if the verb accepts
    xacro arguments. argparse itself accepts them in one place only, so that none could follow an option.
    """

    def __init__(self, **options: Any) -> None:  # noqa: ANN401 - argparse.ArgumentParser takes them
        super().__init__(**options)
        # argparse itself takes -20rpm, -1e3, -0x10 and -1,2 for options
        self._negative_number_matcher = _NEGATIVE  # argparse has no public option for it
        self._retrying = False

    def parse_known_args(  # type: ignore[override]  # of its three signatures, the one that is called
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse the arguments; every NAME:=VALUE before --ros-args goes to `XACRO`."""
        words = list(sys.argv[1:] if args is None else args)
        if self._retrying:
            return super().parse_known_args(words, namespace)
        if not any(action.dest == XACRO for action in self._actions):
            return self._parse(words, namespace)
        end = words.index("--ros-args") if "--ros-args" in words else len(words)
        mappings = [word for word in words[:end] if _ARGUMENT.match(word)]
        others = [word for word in words[:end] if not _ARGUMENT.match(word)]
        filled, unknown = self._parse([*others, *words[end:]], namespace)
        setattr(filled, XACRO, [*(getattr(filled, XACRO, None) or ()), *mappings])
        return filled, unknown

    def _parse(self, words: list[str], namespace: argparse.Namespace | None) -> tuple[argparse.Namespace, list[str]]:
        """Parse once, and again with options first if words other than options are left over."""
        filled, unknown = super().parse_known_args(words, namespace)
        positional = [action for action in self._actions if not action.option_strings]
        may_be_omitted = {"?", "*"} & {action.nargs for action in positional}
        if not may_be_omitted or all(word.startswith("--") for word in unknown):
            return filled, unknown
        self._retrying = True  # argparse calls `parse_known_args` twice
        try:
            return self.parse_known_intermixed_args(words, namespace)
        finally:
            self._retrying = False


def _describe_actions(parser: argparse.ArgumentParser, examples: Sequence[str]) -> None:
    """Add the exit codes of the verb and its examples to the help of each action."""
    codes = re.search(r"^Exit codes.*?(?=\n\n|\Z)", parser.description or "", re.MULTILINE | re.DOTALL)
    for group in (action for action in parser._actions if isinstance(action, argparse._SubParsersAction)):  # noqa: SLF001 - no public way
        texts = {choice.dest: choice.help or "" for choice in group._choices_actions}  # noqa: SLF001 - as above
        for name, action in group.choices.items():
            text = action.description or texts.get(name, "")
            action.description = f"{text[:1].upper()}{text[1:]}.\n\n{codes[0] if codes else _EXIT_CODES}"
            action.formatter_class = _HelpFormatter
            matching = [line.strip() for line in examples if _is_of(action.prog, line.strip())]
            if matching:
                action.epilog = "example: " + "\n         ".join(matching)
            _describe_actions(action, examples)


def _is_of(program: str, example: str) -> bool:
    """Whether an example calls an action; `program` is the action's full name, with positionals in upper case."""
    words = zip(program.split(), example.split(), strict=False)
    return len(example.split()) >= len(program.split()) and all(word.isupper() or word == used for word, used in words)


class _TopParser(argparse.ArgumentParser):
    """Parser before the verb; its help is the overview of the verbs."""

    def format_help(self) -> str:
        return overview()


def _build() -> str:
    kind = build()
    return f"{kind}; {TO_COMPILE}" if kind == PURE else kind


def top_parser() -> argparse.ArgumentParser:
    """Return the parser of the arguments before a verb."""
    parser = _TopParser(prog="canopen-control", usage="canopen-control VERB [OPTIONS]")
    parser.add_argument("--version", action="version", version=f"canopen-control {__version__} ({_build()})")
    parser.add_argument("verb", nargs="?", choices=list(VERBS), metavar="VERB")
    return parser
