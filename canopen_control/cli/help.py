"""Show the most used verbs, all verbs, or the help of a verb or an action.

--man prints the man page of the program or of a verb, as in `canopen-control help run --man | man -l -`.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator


EXAMPLE = """canopen-control help run
         canopen-control help bus status
         canopen-control help run --man
         canopen-control help --all"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("verb", nargs="?", metavar="VERB", help="show the help of this verb")
    parser.add_argument("action", nargs="*", metavar="ACTION", help="show the help of this action of the verb")
    parser.add_argument("--all", action="store_true", help="list every verb")
    parser.add_argument("--man", action="store_true", help="print a man page (troff) of the program or of the verb")


def run(args: argparse.Namespace) -> int:
    """Print a man page, the overview of verbs, or the help of a verb or action."""
    from canopen_control.cli.main import main
    from canopen_control.cli.verbs import VERBS, overview

    if args.man:
        if args.verb is not None and args.verb not in VERBS:
            raise ConfigError(f"no verb {args.verb!r}; canopen-control help --all lists every verb")
        print(man_page(args.verb), end="")
        return 0
    if args.verb is not None:
        return main([args.verb, *args.action, "--help"])
    print(overview(everything=args.all), end="")
    return 0


def man_page(verb: str | None = None) -> str:
    """Return the man page of a verb, or of the program with all its verbs, in troff's man macros."""
    from canopen_control.cli.support.parsers import actions_of, parser_of
    from canopen_control.cli.verbs import GROUPS, VERBS
    from canopen_control.version import __version__

    name = "canopen-control" if verb is None else f"canopen-control-{verb}"
    summary = "CANopen and CiA 402 drives for robots" if verb is None else VERBS[verb]
    lines = [f'.TH "{_troff(name.upper())}" 1 "" "canopen_control {__version__}"']
    lines += [".SH NAME", f"{_troff(name)} \\- {_troff(summary)}"]
    if verb is None:
        lines += [".SH SYNOPSIS", r"canopen\-control VERB [OPTIONS]"]
        for group, verbs in GROUPS.items():
            lines.append(f".SH {group.upper()}")
            for verb, text in verbs.items():
                lines += [".TP", rf"\fBcanopen\-control\-{_troff(verb)}\fR(1)", _troff(text)]
        return "\n".join(lines) + "\n"
    parser = parser_of(verb)
    actions = list(actions_of(parser, verb))
    lines += [".SH SYNOPSIS", *(line for _, action in actions for line in (_synopsis(action), ".br"))]
    lines += [".SH DESCRIPTION", *_paragraphs(parser.description or ""), ".SH OPTIONS"]
    for path, action in actions:
        lines += [f".SS {_troff(path)}"] if len(actions) > 1 else []
        lines += _options(action)
    examples = (parser.epilog or "").removeprefix("example: ")
    lines += [".SH EXAMPLES", ".nf", *(_troff(line.strip()) for line in examples.splitlines()), ".fi"]
    return "\n".join([*lines, ".SH SEE ALSO", r"\fBcanopen\-control\fR(1)"]) + "\n"


def _synopsis(parser: argparse.ArgumentParser) -> str:
    return _troff(" ".join(parser.format_usage().removeprefix("usage: ").split()))


def _paragraphs(text: str) -> Iterator[str]:
    """Yield text as troff paragraphs; a paragraph that begins with a space keeps its line breaks."""
    for part in text.strip().split("\n\n"):
        lines = [_troff(line) for line in part.splitlines()]
        yield from (".nf", *lines, ".fi") if part.startswith(" ") else (".PP", *lines)


def _options(parser: argparse.ArgumentParser) -> Iterator[str]:
    formatter = parser._get_formatter()  # noqa: SLF001 - argparse has no public way to words of one option
    for action in parser._actions:  # noqa: SLF001 - as above
        if action.help is not argparse.SUPPRESS:
            yield ".TP"
            yield rf"\fB{_troff(formatter._format_action_invocation(action))}\fR"  # noqa: SLF001 - as above
            yield _troff(" ".join(formatter._expand_help(action).split()) if action.help else "")  # noqa: SLF001 - as above


def _troff(text: str) -> str:
    """Escape text for troff: control characters lose their effect, and hyphens become minus signs for copying."""
    escaped = text.replace("\\", r"\e").replace("-", r"\-")
    return rf"\&{escaped}" if escaped.startswith((".", "'")) else escaped
