"""Shell completion of verbs, options and names of running robots, by argcomplete.

Completion raises no error, and offers only words that are available without delay. Only the module of the verb on the
line is imported.
"""

from __future__ import annotations

import argparse
import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

import argcomplete
from argcomplete.completers import DirectoriesCompleter, FilesCompleter, SuppressCompleter

from canopen_control.cli.support.known_nodes import known_nodes
from canopen_control.cli.support.parsers import parser_of
from canopen_control.cli.verbs import VERBS
from canopen_control.client import RobotClient, find_robots
from canopen_control.errors import CanopenError
from canopen_control.rpc.messages.robot import GetNodes

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from canopen_control.rpc.messages.declare import Request

    Candidates = Iterable[tuple[str, str]]


A = TypeVar("A")
FILES, DIRS = "@files", "@dirs"  # placeholders for the paths that begin with the typed word
_PATHS: Final = {FILES: FilesCompleter(), DIRS: DirectoriesCompleter()}
_TIMEOUT_S: Final = 0.3  # for an answer of a robot; completion must be fast
_CAN_HARDWARE: Final = "280"  # ARPHRD_CAN, the type of a network interface in /sys


def answer_shell() -> None:
    """Answer the completion request of a shell (its script sets _ARGCOMPLETE and COMP_LINE), and exit."""
    line = os.environ.get("COMP_LINE", "")[: int(os.environ.get("COMP_POINT", "0"))]
    argcomplete.autocomplete(
        parser_for(line.split()[1:]), always_complete_options=False, default_completer=SuppressCompleter()
    )


def parser_for(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return a parser with completers for a command line; `words` follow the program's name."""
    parser = argparse.ArgumentParser(prog="canopen-control")
    parser.add_argument("--version", action="version")
    verb = words[0] if words else ""
    verbs = parser.add_subparsers()
    for name, text in VERBS.items():
        verbs.add_parser(name, help=text)
    with contextlib.suppress(CanopenError):  # without an optional package of the verb only its name is offered
        if verb in VERBS:
            verbs.choices[verb] = parser_of(verb)
            _attach_completers(verbs.choices[verb], verb)
    return parser


def _attach_completers(parser: argparse.ArgumentParser, verb: str) -> None:
    for action in parser._actions:  # noqa: SLF001 - no public way
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 - argparse has no other name for it
            for choice in action.choices.values():
                _attach_completers(choice, verb)
        elif action.choices is None:
            name = next(
                (option_string for option_string in action.option_strings if option_string.startswith("--")),
                action.dest,
            )
            keys = ((verb, name), name, str(action.metavar))
            kind = next((_KINDS[key] for key in keys if key in _KINDS), None)
            if kind is not None:
                action.completer = _Completer(kind)  # type: ignore[attr-defined]  # where argcomplete looks for it


class _Completer:
    """Argcomplete completer for one argument; `kind` yields words with explanations."""

    def __init__(self, kind: Callable[[argparse.Namespace], Candidates]) -> None:
        self.kind = kind

    def __call__(
        self, *, prefix: str, action: argparse.Action, parser: argparse.ArgumentParser, parsed_args: argparse.Namespace
    ) -> dict[str, str]:
        """Return the words to offer, with explanations; none if their source fails or is slow."""
        words: dict[str, str] = {}
        with contextlib.suppress(CanopenError, OSError, KeyError, ValueError):
            for word, text in self.kind(parsed_args):
                if word in _PATHS:
                    paths = _PATHS[word](prefix=prefix, action=action, parser=parser, parsed_args=parsed_args)
                    words.update(dict.fromkeys(paths, ""))
                else:
                    words[word] = text
        return words


def _robots(_line: argparse.Namespace) -> Candidates:
    return [(name, "running") for name in find_robots()]


def _ask(line: argparse.Namespace, request: Request[A]) -> A:
    with RobotClient.connect(line.name, timeout=_TIMEOUT_S) as robot:
        return robot.ask(request)


def _controllers(line: argparse.Namespace) -> Candidates:
    from canopen_control.rpc.messages.robot import ListControllers

    return [(controller.name, controller.state) for controller in _ask(line, ListControllers())]


def _nodes(line: argparse.Namespace) -> Candidates:
    if getattr(line, "can", None) is not None:
        return []  # a bare bus has node-IDs, and no names
    return [(node.name, f"node {node.node_id}") for node in _ask(line, GetNodes()).nodes]


def _nodes_or_all(line: argparse.Namespace) -> Candidates:
    yield "all", "every node"
    yield from _nodes(line)


def _drives(_line: argparse.Namespace) -> Candidates:
    """Return the nodes of all running robots, in the form expected by `fault` and `bus fault`."""
    return [(node.name, f"node {node.node_id}") for node in known_nodes()]


def _channels(_line: argparse.Namespace) -> Candidates:
    from canopen_control.host.sockets import list_sockets

    yield from ((f"local:{name}", "built-in software bus") for name in list_sockets("bus"))
    yield from _interfaces(_line)


def _interfaces(_line: argparse.Namespace) -> Candidates:
    for folder in sorted(Path("/sys/class/net").glob("*")):
        with contextlib.suppress(OSError):
            if (folder / "type").read_text().strip() == _CAN_HARDWARE:
                yield folder.name, "SocketCAN"


def _configs(_line: argparse.Namespace) -> Candidates:
    from canopen_control.data_files import data_names

    return [*((name, "bundled robot") for name in data_names("config")), (DIRS, "")]


def _eds(_line: argparse.Namespace) -> Candidates:
    from canopen_control.data_files import data_names

    return [*((name, "bundled EDS") for name in data_names("eds") if name.endswith(".eds")), (FILES, "")]


def _verbs(_line: argparse.Namespace) -> Candidates:
    return VERBS.items()


def _quirks(_line: argparse.Namespace) -> Candidates:
    from canopen_control.virtual.quirks import QUIRKS

    return [(quirk.name, quirk.does) for quirk in QUIRKS.values()]


def _personalities(_line: argparse.Namespace) -> Candidates:
    from canopen_control.personality import personality_names, read_personality

    return [(name, read_personality(name).title) for name in personality_names()]


def _faults(_line: argparse.Namespace) -> Candidates:
    from canopen_control.virtual.fault_table import FAULTS

    return [(fault.name, fault.does) for fault in FAULTS.values()]


def _services(_line: argparse.Namespace) -> Candidates:
    from canopen_control.trace.decoder import SERVICES

    return [(service, "") for service in SERVICES]


def _modes(_line: argparse.Namespace) -> Candidates:
    from canopen_control.cia402.modes import OperationMode

    return [(mode.name, f"mode {mode.value}") for mode in OperationMode if mode]


#: (verb, option or positional), option or positional, or metavar -> function that yields the words to offer
_KINDS: Final[dict[tuple[str, str] | str, Callable[[argparse.Namespace], Candidates]]] = {
    "--as": lambda _line: (),  # a new name
    ("help", "verb"): _verbs,
    ("fault", "name"): _faults,
    ("fault", "what"): lambda line: [("list", "explain all faults"), *_drives(line)],
    ("bus", "label"): lambda line: [*_drives(line), ("master", "the running robot")],
    ("quirk", "name"): _quirks,
    ("quirk", "what"): lambda line: [("list", "explain all quirks"), *_drives(line)],
    ("drive", "--fault"): _faults,
    ("drive", "--quirk"): _quirks,
    ("device", "--quirk"): _quirks,
    ("drive", "--like"): _personalities,
    ("device", "--like"): _personalities,
    ("init", "--like"): _personalities,
    ("run", "--like"): _personalities,
    ("demo", "--like"): _personalities,
    ("simulate", "--like"): _personalities,
    ("simulate", "--quirk"): _quirks,
    ("device", "--fault"): _faults,
    ("axis", "mode"): _modes,
    ("axis", "node"): _nodes_or_all,
    ("nmt", "node"): _nodes_or_all,
    "--service": _services,
    ("record", "-o"): lambda _line: [(FILES, "")],
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
    "ROBOT": _configs,
    "--eds": _eds,
    "FILE": lambda _line: [(FILES, "")],
    "FILE.html": lambda _line: [(FILES, "")],
    "DIR": lambda _line: [(DIRS, "")],
}
