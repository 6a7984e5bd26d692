"""What `diff`, `restore` and `clone` are given: a DCF file, or a node whose parameters are read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cli.support.open_session import open_session
from canopen_control.cli.support.output import Progress
from canopen_control.errors import ConfigError
from canopen_control.service.parameter_set import read_backup
from canopen_control.service.read_parameters import read_parameters, read_same

if TYPE_CHECKING:
    import argparse

    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.parameter_set import ParameterSet
    from canopen_control.service.read_parameters import LeftOut

__all__ = ["Side", "as_file", "backup_file", "like_file", "read_all", "read_like", "sides"]

_ENDINGS = (".dcf", ".eds")


@dataclass(frozen=True, slots=True)
class Side:
    """Parameters, and those that a node refused."""

    parameters: ParameterSet
    left_out: tuple[LeftOut, ...] = ()


def as_file(word: str) -> Path | None:
    """Return the file that a word names, None where it means a node; ConfigError for one that is not there."""
    path = Path(word).expanduser()
    if path.is_file():
        return path
    if path.suffix.lower() in _ENDINGS or "/" in word:
        what = "is a folder" if path.is_dir() else "no such file"
        raise ConfigError(f"{word}: {what}; a node is a name or a node id")
    return None


def backup_file(word: str) -> ParameterSet:
    """Read a DCF that has to be one."""
    path = as_file(word)
    if path is None:
        raise ConfigError(f"{word}: no such file; `backup NODE -o {word}` makes one")
    return read_backup(path)


def read_all(session: NodeSession, *, twice: bool = True) -> Side:
    """Read all parameters of a node, with progress."""
    with Progress(f"reading {session}", "objects") as progress:
        parameters, left_out = read_parameters(session, twice=twice, told=progress.at)
    return Side(parameters, tuple(left_out))


def like_file(session: NodeSession, file: ParameterSet) -> NodeSession:
    """Let a session without an EDS take the dictionary of the file, which is a complete one."""
    if session.od is None:
        session.od = file.od.for_node(session.node_id)
    return session


def read_like(session: NodeSession, file: ParameterSet) -> Side:
    """Read from a node what a file holds, by the types of the file, with progress."""
    with Progress(f"reading {session}", "objects") as progress:
        parameters, left_out = read_same(session, file, progress.at)
    return Side(parameters, tuple(left_out))


def sides(a: str, b: str, args: argparse.Namespace) -> tuple[Side, Side]:
    """Read what two words name; of a file and a node the node is asked for what the file holds."""
    files = [None if path is None else read_backup(path) for path in (as_file(a), as_file(b))]
    found = []
    for word, file, other in zip((a, b), files, reversed(files), strict=True):
        if file is not None:
            found.append(Side(file))
            continue
        with open_session(args, word) as session:
            found.append(
                read_all(session, twice=False) if other is None else read_like(like_file(session, other), other)
            )
    return found[0], found[1]
