"""What the last word of a command line may become: found by the verbs' own parsers, so that it cannot differ from them.

The law of the file: nothing here raises and nothing waits: what cannot be known at once is not offered. Only the module
of the verb that stands on the line is imported. `@files` and `@dirs` let the shell offer paths.
"""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import CanopenError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    Found = Iterable[tuple[str, str]]

__all__ = ["DIRS", "FILES", "complete"]

FILES, DIRS = "@files", "@dirs"
_TIMEOUT_S: Final = 0.3  # of a robot; who types does not wait
_CAN_HARDWARE: Final = "280"  # ARPHRD_CAN, the type of a network interface in /sys


def complete(words: Sequence[str]) -> list[tuple[str, str]]:
    """Return (word, explanation) of what the last of `words`, which follow the program's name, may become."""
    from canopen_control.cli.main import VERBS, parser_of

    *before, current = words
    if not before:
        found: Found = [*VERBS.items(), ("--help", ""), ("--version", "")]
    elif before[0] in VERBS:
        found = _Line(parser_of(before[0]), before).candidates(current)
    else:
        return []
    unique = dict(reversed([each for each in found if each[0].startswith(current) or each[0] in (FILES, DIRS)]))
    return list(reversed(unique.items()))


class _Line:
    """A command line as far as it is typed: which parser is in charge, which value is due."""

    def __init__(self, parser: argparse.ArgumentParser, words: Sequence[str]) -> None:
        self.verb, self.words = words[0], words
        self._enter(parser)
        for word in words[1:]:
            self._take(word)

    def _enter(self, parser: argparse.ArgumentParser) -> None:
        self.parser = parser
        self.options: dict[str, argparse.Action] = parser._option_string_actions  # noqa: SLF001 - no public way
        self.positionals = [each for each in parser._actions if not each.option_strings]  # noqa: SLF001 - as above
        self.due: argparse.Action | None = None

    def _take(self, word: str) -> None:
        if word.startswith("-") and word in self.options:
            action = self.options[word]
            self.due = None if action.nargs == 0 else action
        elif self.due is not None:
            self.due = self.due if self.due.nargs in ("*", "+") else None
        elif self.positionals and not word.startswith("-"):
            action = self.positionals[0]
            if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 - argparse has no other name for it
                chosen = action.choices.get(word)
                self._enter(chosen) if chosen is not None else self.positionals.clear()
            elif action.nargs not in ("*", "+"):
                self.positionals.pop(0)

    def candidates(self, current: str) -> Iterator[tuple[str, str]]:
        """Yield what may stand here."""
        option, equals, _ = current.partition("=")
        if equals and option in self.options:
            yield from ((f"{option}={word}", text) for word, text in self._values(self.options[option]))
        elif current.startswith("-"):
            yield from ((name, _help(action)) for name, action in self.options.items() if name.startswith("--"))
        else:
            if self.due is not None:
                yield from self._values(self.due)
            if self.due is None or self.due.nargs in ("*", "+", "?"):
                yield from self._values(self.positionals[0]) if self.positionals else ()

    def _values(self, action: argparse.Action) -> Found:
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 - argparse has no other name for it
            texts = {each.dest: each.help or "" for each in action._choices_actions}  # noqa: SLF001 - no public way
            return [(str(name), texts.get(name, "")) for name in action.choices]
        if action.choices is not None:
            return [(str(choice), "") for choice in action.choices]
        name = next((each for each in action.option_strings if each.startswith("--")), action.dest)
        keys = ((self.verb, name), name, str(action.metavar))
        kind = next((_KINDS[key] for key in keys if key in _KINDS), None)
        found: list[tuple[str, str]] = []
        with contextlib.suppress(CanopenError, OSError, KeyError, ValueError):
            found.extend(kind(self) if kind is not None else ())
        return found

    @property
    def robot(self) -> str | None:
        """The robot that --name names on this line."""
        at = self.words.index("--name") + 1 if "--name" in self.words else 0
        return self.words[at] if 0 < at < len(self.words) else None


def _help(action: argparse.Action) -> str:
    return "" if action.help in (None, argparse.SUPPRESS) else str(action.help)


def _robots(_line: _Line) -> Found:
    from canopen_control.client import find_robots

    return [(name, "running") for name in find_robots()]


def _ask(line: _Line, method: str) -> Any:  # noqa: ANN401 - what JSON holds
    from canopen_control.client import RobotClient

    with RobotClient.connect(line.robot, timeout=_TIMEOUT_S) as robot:
        return robot.call(method)


def _controllers(line: _Line) -> Found:
    return [(each["name"], each["state"]) for each in _ask(line, "controllers")]


def _nodes(line: _Line) -> Found:
    if "--can" in line.words:
        return []  # a bare bus: node ids
    return [(each["name"], f"node {each['node_id']}") for each in _ask(line, "nodes")["nodes"]]


def _nodes_or_all(line: _Line) -> Found:
    yield "all", "every node"
    yield from _nodes(line)


def _channels(_line: _Line) -> Found:
    from canopen_control.host.sockets import list_sockets

    yield from ((f"local:{name}", "embedded bus") for name in list_sockets("bus"))
    yield from _interfaces(_line)


def _interfaces(_line: _Line) -> Found:
    for folder in sorted(Path("/sys/class/net").glob("*")):
        with contextlib.suppress(OSError):
            if (folder / "type").read_text().strip() == _CAN_HARDWARE:
                yield folder.name, "SocketCAN"


def _configs(_line: _Line) -> Found:
    from canopen_control.data_files import data_names

    return [*((name, "bundled robot") for name in data_names("config")), (DIRS, "")]


def _eds(_line: _Line) -> Found:
    from canopen_control.data_files import data_names

    return [*((name, "bundled EDS") for name in data_names("eds")), (FILES, "")]


def _faults(_line: _Line) -> Found:
    from canopen_control.virtual.faults import FAULTS

    return [(fault.name, fault.does) for fault in FAULTS.values()]


def _services(_line: _Line) -> Found:
    from canopen_control.trace.decoder import SERVICES

    return [(service, "") for service in SERVICES]


def _modes(_line: _Line) -> Found:
    from canopen_control.cia402.modes import OperationMode

    return [(mode.name, f"mode {mode.value}") for mode in OperationMode if mode]


#: (verb, option or positional), option or positional, or metavar -> what it may be
_KINDS: Final[dict[tuple[str, str] | str, Callable[[_Line], Found]]] = {
    ("run", "--name"): lambda _line: (),  # a new one
    ("demo", "--name"): lambda _line: (),
    ("fault", "name"): _faults,
    ("fault", "what"): lambda _line: [("list", "explain all faults")],
    ("drive", "--fault"): _faults,
    ("axis", "mode"): _modes,
    ("axis", "node"): _nodes_or_all,
    ("nmt", "node"): _nodes_or_all,
    "--service": _services,
    ("record", "--can"): lambda _line: [(FILES, "")],
    **{("eds", name): _eds for name in ("file", "files", "a", "b")},
    "--name": _robots,
    "--controller": _controllers,
    "controller": _controllers,
    "CONTROLLER": _controllers,
    "node": _nodes,
    "--node": _nodes,
    "NODE": _nodes,
    "CHANNEL": _channels,
    "[BUS=]CHANNEL": _channels,
    "INTERFACE": _interfaces,
    "CONFIG": _configs,
    "ROBOT": _configs,
    "--eds": _eds,
    "FILE": lambda _line: [(FILES, "")],
    "FILE.html": lambda _line: [(FILES, "")],
    "DIR": lambda _line: [(DIRS, "")],
}
