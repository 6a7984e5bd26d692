"""Target of a verb: the nodes of a running robot through its API, or those of a bare bus.

An SDO server has one client. The nodes of a running robot are reached through the robot alone; on a bus on which a
robot runs, only the other nodes are reached directly.
"""

from __future__ import annotations

import abc
import os
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Self

from canopen_control.bus.channel import parse_channel
from canopen_control.cia301.nmt import COMMAND_NAMES, EXPECTED_STATE, RESETS, NmtCommand, NmtState, NmtUnconfirmed
from canopen_control.cli.support.arguments import eds_path
from canopen_control.cli.support.parsers import add_robot_name
from canopen_control.client import RobotClient, find_robots
from canopen_control.commissioning.node_session import NodeSession, RobotTransfers, Transfers
from canopen_control.data_files import data_names
from canopen_control.errors import CanopenError, ConfigError, DriveError, RemoteError, nearest
from canopen_control.frame import MAX_NODE_ID
from canopen_control.master.direct import DirectBus
from canopen_control.od.eds import SUFFIXES
from canopen_control.rpc.messages.robot import GetNodes, GetStatus, NmtRequest, NodeListing

if TYPE_CHECKING:
    import argparse

    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.rpc.messages.state import NodeReading


_HEARTBEATS = 2.5  # heartbeat periods for which a heartbeat is awaited
_SHORTEST_S, _LONGEST_S = 0.5, 3.0  # a busy computer reads a heartbeat late
_HEARTBEAT = (0x1017, 0)
_NMT_S, _RESET_S = 0.3, 3.0  # time in which a node must show a state
_MUTE_S = 0.02  # for a node without heartbeat: only a pause before the next request
ALL = "all"  # every node, in a request for an NMT command
NMT_TIMEOUT_S = 1.5  # longest heartbeat period that is awaited
RESET_TIMEOUT_S = 5.0
BOOT_TIMEOUT_S = 10.0  # `start` through a robot configures the node first
POLL_S = 0.05
ROBOT_TIMEOUTS = {
    NmtCommand.START: BOOT_TIMEOUT_S,
    NmtCommand.RESET_NODE: RESET_TIMEOUT_S,
    NmtCommand.RESET_COMMUNICATION: RESET_TIMEOUT_S,
}
_ADDRESS = re.compile(r"(?:0[xX](?!00)[0-9A-Fa-f]{4}|[0-9][0-9A-Fa-f]{3})(?::.*)?")  # a node-ID has at most 3 digits
LABEL = "canopen-control"  # label of a verb as a member of a bus


class Target(abc.ABC):
    """Nodes that a verb can reach, with a session for each; `eds` replaces the robot's own EDS files."""

    def __init__(self, eds: Path | None) -> None:
        self._eds = eds
        self._sessions: dict[int, NodeSession] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @abc.abstractmethod
    def session(self, word: str) -> NodeSession:
        """Return the session with the node selected by `word` (name or node-ID).

        Raise ConfigError if it does not exist.
        """

    @abc.abstractmethod
    def close(self) -> None:
        """Close the connection."""


def add_target_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare --can and --name."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--can", metavar="CHANNEL", help="channel of a bare bus (can0, local:NAME, ...), without a running robot"
    )
    add_robot_name(group)


def open_target(args: argparse.Namespace, *, through_robot: bool = False) -> RobotTarget | BusTarget:
    """Open the robot or bus selected by the arguments `can`, `name`, `eds` and `timeout` (s or None).

    With `through_robot`, a bus on which a robot runs is reached through that robot.
    """
    eds = find_eds(args.eds) if args.eds else None
    owner = robot_on(args.can) if through_robot and args.can is not None else None
    if args.can is not None and owner is None:
        return BusTarget(args.can, eds, args.timeout)
    return RobotTarget(RobotClient.connect(args.name if owner is None else owner[0]), eds, args.timeout)


def find_eds(text: str) -> Path:
    """Return the path of an EDS file, or of the bundled file of that name; raise ConfigError if neither exists."""
    path = eds_path(text)
    if not path.is_file():
        bundled = [name for name in data_names("eds") if name.lower().endswith(SUFFIXES)]
        reason = " (a folder)" if path.is_dir() else nearest(path.name, bundled, listed=False)
        raise ConfigError(f"no EDS file {text}{reason}")
    return path


def names_file(word: str) -> bool:
    """Whether a word can only name a file: it has a slash or an EDS suffix, or another suffix and the file exists."""
    path = Path(word).expanduser()
    return "/" in word or path.suffix.lower() in SUFFIXES or (bool(path.suffix) and path.is_file())


def refuse_as_node(
    args: argparse.Namespace, word: str, right: str, *, file: str | None = None, instead: str = ""
) -> None:
    """Raise ConfigError if the NODE `word` is a file or the address of an object; `right` is the command to give.

    `instead` is a command that shows the object in a file. `file` is the FILE of the same command: NODE also counts as
    a file if it exists as one and FILE does not.
    """
    exchanged = file is not None and Path(word).expanduser().is_file() and not Path(file).expanduser().is_file()
    kind = "a file" if names_file(word) or exchanged else "an object" if _ADDRESS.fullmatch(word) else ""
    if kind:
        chosen = ((option, getattr(args, option, None)) for option in ("can", "name", "eds"))
        options = "".join(f" --{option} {value}" for option, value in chosen if value)
        shown = f"; to show the object in the file: canopen-control {instead}" if instead else ""
        raise ConfigError(f"{word} is {kind}, not a node; write: canopen-control {right}{options}{shown}")


def robot_on(channel: str) -> tuple[str, NodeListing] | None:
    """Return the name and the node listing of the robot running on `channel`, or None."""
    address = str(parse_channel(channel))
    for name in find_robots():
        try:
            with RobotClient.connect(name, timeout=2.0) as robot:
                listing = robot.ask(GetNodes())
        except ConfigError:
            continue  # the robot has just ended
        except RemoteError as error:
            if error.kind == "BusClosed":
                continue
            raise  # a robot that hangs may still use the bus
        if any(bus.channel == address for bus in listing.buses.values()):
            return name, listing
    return None


class RobotTarget(Target):
    """Nodes of a running robot, reached through the robot."""

    def __init__(self, robot: RobotClient, eds: Path | None = None, timeout: float | None = None) -> None:
        super().__init__(eds)
        self.robot, self._timeout = robot, timeout
        self.listing = robot.ask(GetNodes())

    def close(self) -> None:
        for session in self._sessions.values():
            session.transfers.close()
        self.robot.close()

    @property
    def sessions(self) -> list[NodeSession]:
        """Sessions with all nodes of the robot, in order of node-ID."""
        return [self._with(place) for place in sorted(self.listing.nodes, key=lambda node: node.node_id)]

    def session(self, word: str) -> NodeSession:
        for session in self.sessions:
            if word in (session.name, str(session.node_id)):
                return session
        names = ", ".join(f"{node.node_id} {node.name}" for node in self.sessions) or "none (mock hardware)"
        raise ConfigError(
            f"robot {self.robot.robot} has no node {word!r}; its nodes: {names}; for others on its bus use --can"
        )

    def _with(self, place: NodePlace) -> NodeSession:
        if (session := self._sessions.get(place.node_id)) is None:
            label = f"{LABEL} (pid {os.getpid()})"
            transfers = RobotTransfers(self.robot, place.node_id, self._timeout, label)
            eds = self._eds or (Path(place.eds) if place.eds else None)
            session = NodeSession(transfers, place.node_id, name=place.name, robot=self.robot.robot, eds=eds)
            self._sessions[place.node_id] = session
        return session

    def command(
        self, command: NmtCommand, sessions: list[NodeSession], timeout: float, *, all_nodes: bool
    ) -> tuple[list[NodeSession], dict[str, NodeReading]]:
        """Send an NMT command to nodes; return the unconfirmed nodes and the last readings of all nodes."""
        begin = time.monotonic()
        name = next(name for name, known in COMMAND_NAMES.items() if known is command)
        self.robot.ask(NmtRequest(command=name, node=ALL if all_nodes else str(sessions[0].node_id)))
        waiting = sessions
        while True:
            time.sleep(POLL_S)
            nodes = self.robot.ask(GetStatus()).nodes
            elapsed = time.monotonic() - begin
            waiting = [requested for requested in waiting if not _shows(nodes[requested.name], command, elapsed)]
            if not waiting or elapsed >= timeout:
                return waiting, nodes


class BusTarget(Target):
    """Nodes on a bus, reached directly, except those of a robot that runs on the bus."""

    def __init__(self, channel: str, eds: Path | None = None, timeout: float | None = None) -> None:
        super().__init__(eds)
        self.owner = robot_on(channel)
        self.bus = DirectBus.open(channel, label=LABEL, timeout_s=timeout or 0.5)

    def close(self) -> None:
        self.bus.close()

    def session(self, word: str) -> NodeSession:
        """Return the session with a node-ID; raise ConfigError if it is invalid or a running robot has the node."""
        node_id = parse_node_id(word)
        name, listing = self.owner or ("", NodeListing())
        if any(node_id == node.node_id for node in listing.nodes):
            raise ConfigError(
                f"node {node_id} on {self.bus.port.channel} belongs to the running robot {name}, the one client of its "
                f"SDO server; use --name {name} instead of --can"
            )
        if node_id not in self._sessions:
            self._sessions[node_id] = NodeSession(BusTransfers(self.bus, node_id), node_id, eds=self._eds)
        return self._sessions[node_id]


class BusTransfers(Transfers):
    """SDO transfers and NMT commands for one node of a bare bus."""

    def __init__(self, bus: DirectBus, node_id: int) -> None:
        self._bus, self._node_id = bus, node_id
        self._mute = False  # the node sends no heartbeat

    def read(self, index: int, subindex: int, *, block: bool = False) -> bytes:
        return self._bus.read(self._node_id, index, subindex, block=block)

    def write(self, index: int, subindex: int, data: bytes) -> None:
        self._bus.write(self._node_id, index, subindex, data)

    def set_timeout(self, seconds: float | None) -> None:
        self._bus.client(self._node_id).timeout_ns = round((seconds or self._bus.timeout_s) * 1e9)

    def progress(self) -> tuple[int, int | None]:
        return self._bus.client(self._node_id).progress

    def cancel(self) -> None:
        self._bus.cancel()

    def command(self, command: NmtCommand) -> None:
        """Send an NMT command, and wait for a heartbeat with the expected state if the node sends heartbeats.

        Raise DriveError if the heartbeats have another state.
        """
        seconds = _RESET_S if command in RESETS else _MUTE_S if self._mute else _NMT_S
        for result in self._bus.command(command, self._node_id, seconds):
            if isinstance(result, NmtUnconfirmed) and result.state is not None:
                text = f"{result.state.text} after NMT {command.name.replace('_', ' ').lower()}"
                raise DriveError(f"node {self._node_id} is {text}")

    def nmt_state(self) -> NmtState | None:
        """Return the NMT state in the node's next heartbeat, or None if none arrives in time."""
        bus, node_id = self._bus, self._node_id
        bus.states.pop(node_id, None)
        try:
            period_ms = int.from_bytes(self.read(*_HEARTBEAT)[:2], "little")
        except CanopenError:
            period_ms = 0
        self._mute = not period_ms
        if period_ms and bus.states.get(node_id) is None:
            seconds = min(max(_SHORTEST_S, _HEARTBEATS * period_ms / 1e3), _LONGEST_S)
            bus.serve([], lambda: bus.states.get(node_id) is not None, seconds)
        return bus.states.get(node_id)

    def taken_out(self) -> bool:
        """Return True, since no robot uses the node."""
        return True

    def close(self) -> None:
        """Do nothing; the bus belongs to the target."""


def parse_node_id(text: str) -> int:
    """Return the node-ID in a text, decimal or 0x; raise ConfigError if it is not from 1 to 127."""
    try:
        node_id = int(text, 0)
    except ValueError:
        raise ConfigError(f"node {text!r}: on a bare bus a node is a number, 1 to {MAX_NODE_ID}") from None
    if not 1 <= node_id <= MAX_NODE_ID:
        raise ConfigError(f"node {node_id}: node-IDs are 1 to {MAX_NODE_ID}")
    return node_id


def _shows(node: NodeReading, command: NmtCommand, elapsed: float) -> bool:
    """Whether a node has reached the state that the command leads to, `elapsed` s after the command."""
    if command is NmtCommand.START and not node.ready:  # the robot must also have configured the node
        return False
    # CiA 301 7.3.2: after a reset a node enters PRE-OPERATIONAL by itself
    expected = NmtState.PRE_OPERATIONAL if command in RESETS else EXPECTED_STATE[command]
    return node.nmt_state == expected.name and node.age is not None and node.age <= elapsed
