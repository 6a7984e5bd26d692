"""Sessions with nodes on a bare bus (--can CHANNEL, --eds FILE), or through a running robot.

An SDO server has one client, as explained in `target`. The nodes of a running robot are reached through the robot,
even if --can names its channel.
"""

from __future__ import annotations

import contextlib
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cia402.objects import CONTROLWORD, axis_index
from canopen_control.cli.support.arguments import one_name, timeout_seconds
from canopen_control.cli.support.output import Progress
from canopen_control.cli.support.target import RobotTarget, add_target_arguments, find_eds, names_file, open_target
from canopen_control.client import RobotClient
from canopen_control.commissioning.driven_axis import drive_of_robot, fault_words, why_not_free
from canopen_control.commissioning.jobs import Reached
from canopen_control.commissioning.parameter_jobs import like_file
from canopen_control.commissioning.parameter_set import read_backup, read_parameters, read_same
from canopen_control.commissioning.quantity import JogScale
from canopen_control.commissioning.restore import unfinished_words
from canopen_control.errors import ConfigError, DriveError
from canopen_control.runtime.observer import RobotObserver

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator

    from canopen_control.commissioning.driven_axis import JogDrive
    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.commissioning.parameter_set import LeftOut, ParameterSet
    from canopen_control.master.event_log import Event
    from canopen_control.scaffold.drive_choice import AxisChoice
    from canopen_control.scaffold.new_robot import Device, NewRobot


def add_session_arguments(parser: argparse.ArgumentParser, *, node: bool = True) -> None:
    """Declare NODE, --eds, --timeout, and --can or --name; `node` is False for verbs with their own node arguments."""
    if node:
        parser.add_argument("node", type=one_name, metavar="NODE", help="name or node-ID; on a bare bus the node-ID")
    parser.add_argument("--eds", metavar="FILE", help="EDS of the node: a path, or the name of a bundled file")
    parser.add_argument(
        "--timeout",
        type=timeout_seconds,
        metavar="S",
        help="timeout of each answer in s (default: 0.5, or the value in bus.yml)",
    )
    add_target_arguments(parser)


@contextlib.contextmanager
def open_session(args: argparse.Namespace, node: str | None = None) -> Iterator[NodeSession]:
    """Context manager for a session with a node, by default the NODE argument.

    If --can names the channel of a running robot, its nodes are reached through that robot.
    """
    word = args.node if node is None else node
    with open_sessions(args, [word]) as (sessions, _):
        yield sessions[word]


@contextlib.contextmanager
def open_sessions(
    args: argparse.Namespace, nodes: Iterable[str]
) -> Iterator[tuple[dict[str, NodeSession], RobotClient | None]]:
    """Context with a session for each of `nodes` and the client of the robot, which is None on a bare bus."""
    with open_target(args, through_robot=True) as target:
        sessions = {word: target.session(word) for word in dict.fromkeys(nodes)}
        for session in sessions.values():
            _ = session.od  # a file that cannot be read is refused before any work
        yield sessions, target.robot if isinstance(target, RobotTarget) else None


# The one drive that `jog` and `tune` move: identified on a bare bus, or found in a running robot.


def running_drive(
    args: argparse.Namespace, name: str | None, mode: str, stack: contextlib.ExitStack
) -> tuple[JogDrive, JogScale]:
    """Return a drive of a running robot, to be moved in `mode`, with the scale of the joint."""
    client = stack.enter_context(RobotClient.connect(name))
    drive = drive_of_robot(client, args.node, args.axis, mode)
    text = f"node {args.node} is {drive.joint} of the running robot {client.robot}, which moves it"
    print(text, file=sys.stderr if getattr(args, "json", False) else sys.stdout)
    return drive, JogScale(args.counts or math.tau, is_known=True, of_joint=True)


def read_bare_drive(args: argparse.Namespace, *, with_fault: bool = False) -> Device:
    """Read a drive on a bare bus, with the drive's own units; raise ConfigError or DriveError if it must not move."""
    from canopen_control.cli.init import ask_drives
    from canopen_control.scaffold.new_robot import Device

    with open_session(args) as node:
        if not len(node.axes()):
            raise ConfigError(f"{args.eds} has no controlword (0x6040), so the device is not a CiA 402 drive")
        if differing := node.identity_differences():
            raise ConfigError(f"{node} is not the device of {args.eds}: {'; '.join(differing)}; give its own EDS")
        if not with_fault and (words := fault_words(node)):
            command = f"canopen-control jog {args.node} --can {args.can} --eds {args.eds} --fault-reset"
            raise DriveError(f"{node} has a fault: {words}; reset it with: {command}")
        if reason := why_not_free(node):
            write = f"0x{axis_index(CONTROLWORD, args.axis):04X} 6 --can {args.can} --eds {args.eds}"
            disable = f"canopen-control sdo write {args.node} {write}"
            raise DriveError(f"{reason}, or if it has died, disable the drive with: {disable}")
        if unfinished := unfinished_words(node, reached(args)):
            raise DriveError(
                f"{unfinished}; the drive is not moved with mixed parameters; to allow it, delete the file"
            )
        device = Device(node.node_id, find_eds(args.eds).resolve(), node.dictionary)
    ask_drives(args.can, [device], args.timeout or 0.5)
    return device


def axis_of(robot: NewRobot, args: argparse.Namespace) -> AxisChoice:
    """Return the axis selected by --axis; raise ConfigError if the node does not have it."""
    number: int = args.axis
    if number >= len(robot.joints):
        raise ConfigError(f"node {args.node} has no axis {number}; it has {len(robot.joints)}, counted from 0")
    return robot.joints[number].axis


def with_counts(robot: NewRobot, counts: float | None) -> NewRobot:
    """Return the robot with the user's counts per revolution for every axis; unchanged if `counts` is None."""
    if counts is None:
        return robot
    nodes = tuple(
        replace(
            node,
            drive=node.drive and replace(node.drive, axes=tuple(replace(a, counts=counts) for a in node.drive.axes)),
            joints=tuple(replace(joint, axis=replace(joint.axis, counts=counts)) for joint in node.joints),
        )
        for node in robot.nodes
    )
    return replace(robot, nodes=nodes)


class WarningPrinter(RobotObserver):
    """Observer that prints warnings and errors while the drive is booted and moved."""

    def event(self, event: Event) -> None:
        from canopen_control.master.event_log import Level

        if event.level >= Level.WARNING:
            text = f"\r\x1b[K{event.sentence}" if sys.stdout.isatty() else event.sentence
            print(text, file=sys.stderr, flush=True)


# Operands of `diff`, `restore` and `clone`: a DCF file, or a node whose parameters are read.


@dataclass(frozen=True, slots=True)
class ReadParameters:
    """Parameters of one side of a comparison; `left_out` are the objects that a node refused."""

    parameters: ParameterSet
    left_out: tuple[LeftOut, ...] = ()


def as_file(word: str) -> Path | None:
    """Return the path if `word` names a file, or None if it names a node; raise ConfigError if the file is missing."""
    path = Path(word).expanduser()
    if path.is_file():
        return path
    if names_file(word):
        problem = "is a folder" if path.is_dir() else "no such file"
        raise ConfigError(f"{word}: {problem}; a node is a name or a node-ID")
    return None


def backup_file(word: str) -> ParameterSet:
    """Read the DCF file that `word` names; raise ConfigError if it does not exist."""
    path = as_file(word)
    if path is None:
        raise ConfigError(f"{word}: no such file; create one with: canopen-control backup NODE -o {word}")
    return read_backup(path)


def read_all(session: NodeSession, *, twice: bool = True) -> ReadParameters:
    """Read all parameters of a node, by default twice to find changing values, and show the progress."""
    with Progress(f"reading {session}", "objects") as progress:
        parameters, left_out = read_parameters(session, twice=twice, progress=progress.at)
    return ReadParameters(parameters, tuple(left_out))


def read_like(session: NodeSession, file: ParameterSet) -> ReadParameters:
    """Read the objects of a DCF file from a node, with the data types of the file, and show the progress."""
    with Progress(f"reading {session}", "objects") as progress:
        parameters, left_out = read_same(session, file, progress.at)
    return ReadParameters(parameters, tuple(left_out))


def read_both(a: str, b: str, args: argparse.Namespace) -> tuple[ReadParameters, ReadParameters]:
    """Read both sides of a comparison; if one side is a file, only its objects are read from the node."""
    files = [None if path is None else read_backup(path) for path in (as_file(a), as_file(b))]
    result = []
    for word, file, other_file in zip((a, b), files, reversed(files), strict=True):
        if file is not None:
            result.append(ReadParameters(file))
            continue
        with open_session(args, word) as session:
            result.append(
                read_all(session, twice=False)
                if other_file is None
                else read_like(like_file(session, other_file), other_file)
            )
    return result[0], result[1]


def reached(args: argparse.Namespace) -> Reached:
    """Return the options that select the node of the arguments, for commands shown to the user."""
    include = bool(getattr(args, "include_protected", False))
    return Reached(getattr(args, "can", None) or "", getattr(args, "name", None) or "", include)
