"""Opens a service session with one node: on a bare bus (--can CHANNEL, --eds FILE), or through the robot that runs.

The law of this file is that of `target`: an SDO server has one client. A bus on which a robot runs is that robot's, and
its nodes are reached through it, also where --can names the channel.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from canopen_control.cia301.nmt import RESETS, NmtState, NmtUnconfirmed
from canopen_control.cli.support.arguments import timeout_seconds
from canopen_control.cli.support.target import (
    BusTarget,
    RobotTarget,
    add_target_arguments,
    find_eds,
    robot_on,
)
from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError, DriveError
from canopen_control.service.node_session import NodeSession, Transfers

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Iterator

    from canopen_control.cia301.nmt import NmtCommand
    from canopen_control.cli.support.target import TargetNode

__all__ = ["add_session_arguments", "open_session", "open_sessions"]

_HEARTBEATS = 2.5  # of its own heartbeat times, a node is listened to
_LONGEST_S = 3.0
_HEARTBEAT = (0x1017, 0)
_NMT_S, _RESET_S = 0.3, 3.0  # what a node may take to show a state
_MUTE_S = 0.02  # for one that sends no heartbeat: it shows nothing, and takes the next request after the command


def add_session_arguments(parser: argparse.ArgumentParser, *, node: bool = True) -> None:
    """Declare NODE, --eds, --timeout, and --can or --name; `node` False for a verb that names its nodes itself."""
    if node:
        parser.add_argument("node", metavar="NODE", help="name or node id; on a bare bus the node id")
    parser.add_argument("--eds", metavar="FILE", help="EDS of the node: a path, or the name of a bundled file")
    parser.add_argument(
        "--timeout", type=timeout_seconds, metavar="S", help="timeout of each answer in s (default: 0.5, or bus.yml's)"
    )
    add_target_arguments(parser)


@contextlib.contextmanager
def open_session(args: argparse.Namespace, node: str | None = None) -> Iterator[NodeSession]:
    """Open a session with `node`, else with that of the arguments; raises CanopenError where nobody answers.

    Where --can names the channel of a running robot, its nodes are reached through that robot.
    """
    word = args.node if node is None else node
    with open_sessions(args, [word]) as (sessions, _):
        yield sessions[word]


@contextlib.contextmanager
def open_sessions(
    args: argparse.Namespace, nodes: Iterable[str]
) -> Iterator[tuple[dict[str, NodeSession], RobotClient | None]]:
    """Open a session with each of `nodes`, by the words given, and the robot that carries them, None on a bare bus."""
    with _open(args) as target:
        client = target.robot if isinstance(target, RobotTarget) else None
        robot = "" if client is None else client.robot
        sessions = {}
        for word in dict.fromkeys(nodes):
            node = target.node(word)
            transfers = target.transfers(node) if isinstance(target, RobotTarget) else BusTransfers(target, node)
            sessions[word] = NodeSession(transfers, node.node_id, node.dictionary(), name=node.name, robot=robot)
        yield sessions, client


def _open(args: argparse.Namespace) -> RobotTarget | BusTarget:
    eds = find_eds(args.eds) if args.eds else None
    owner = None if args.can is None else robot_on(args.can)
    if args.can is not None and owner is None:
        return BusTarget(args.can, eds, args.timeout)
    name = args.name if owner is None else owner[0]
    return RobotTarget(RobotClient.connect(name), eds, args.timeout)


class BusTransfers(Transfers):
    """The transfers of one node of a bare bus."""

    def __init__(self, target: BusTarget, node: TargetNode) -> None:
        self._target, self._node = target, node
        self._mute = False  # it was seen to send no heartbeat

    def read(self, index: int, subindex: int, *, block: bool = False) -> bytes:
        """Upload an object."""
        return self._target.read(self._node, index, subindex, block=block)

    def write(self, index: int, subindex: int, data: bytes) -> None:
        """Download an object."""
        self._target.write(self._node, index, subindex, data)

    def be_patient(self, seconds: float | None) -> None:
        """Wait so long for each answer from now on."""
        self._target.be_patient(self._node, seconds)

    def progress(self) -> tuple[int, int | None]:
        """Return how far the transfer under way is."""
        return self._target.progress(self._node)

    def command(self, command: NmtCommand) -> None:
        """Send an NMT command to the node of a bare bus and wait until a heartbeat shows it, if it sends any."""
        bus = self._target.bus
        seconds = _RESET_S if command in RESETS else _MUTE_S if self._mute else _NMT_S
        for result in bus.command(command, self._node.node_id, seconds):
            if isinstance(result, NmtUnconfirmed) and result.state is not None:
                raise DriveError(
                    f"{self._node} is {result.state.text} after NMT {command.name.replace('_', ' ').lower()}"
                )

    def nmt_state(self) -> NmtState | None:
        """Listen for the node's next heartbeat, if it sends any."""
        bus, node_id = self._target.bus, self._node.node_id
        bus.heard.pop(node_id, None)
        try:
            period_ms = int.from_bytes(self.read(*_HEARTBEAT)[:2], "little")
        except CanopenError:
            period_ms = 0
        self._mute = not period_ms
        if period_ms and bus.heard.get(node_id) is None:
            bus.serve([], lambda: bus.heard.get(node_id) is not None, min(_LONGEST_S, _HEARTBEATS * period_ms / 1e3))
        return bus.heard.get(node_id)

    def taken_out(self) -> bool:
        """Return True: no robot runs on it."""
        return True
