"""Nodes of running robots by the names that users type (node name, joint name or node-ID), and their virtual drives.

For verbs that access the buses and virtual drives of a robot directly. A robot that does not answer is skipped, because
these verbs must work while a robot hangs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.bus.channel import parse_channel
from canopen_control.client import RobotClient, find_robots
from canopen_control.errors import CanopenError, ConfigError, RemoteError
from canopen_control.host.sockets import drive_name, list_sockets
from canopen_control.rpc.messages.robot import GetNodes

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.client.drive_client import DriveClient


_TIMEOUT_S = 2.0


@dataclass(frozen=True, slots=True)
class KnownNode:
    """Node of a running robot, with its channel, node-ID, name and joints."""

    robot: str
    channel: str
    node_id: int
    name: str
    joints: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.name} ({self.node_id})"

    @property
    def words(self) -> tuple[str, ...]:
        """Names that select the node: node name, node-ID and joint names."""
        return (self.name, str(self.node_id), *self.joints)


def known_nodes(channel: str | None = None) -> list[KnownNode]:
    """Return the nodes of all running robots, or only those on `channel`."""
    return ask_nodes(channel)[0]


def ask_nodes(channel: str | None = None) -> tuple[list[KnownNode], dict[str, CanopenError]]:
    """Return the nodes like `known_nodes`, and the errors of robots that do not respond, by robot name."""
    selected = None if channel is None else str(parse_channel(channel))
    nodes: list[KnownNode] = []
    silent: dict[str, CanopenError] = {}
    for name in find_robots():
        try:
            nodes.extend(_nodes_of(name))
        except CanopenError as error:
            silent[name] = error
    return [node for node in nodes if selected in (None, node.channel)], silent


def _nodes_of(robot: str) -> list[KnownNode]:
    with RobotClient.connect(robot, timeout=_TIMEOUT_S) as client:
        listing = client.ask(GetNodes())
    channels = {name: bus.channel for name, bus in listing.buses.items()}
    return [KnownNode(robot, channels[node.bus], node.node_id, node.name, tuple(node.joints)) for node in listing.nodes]


def find_node(word: str, nodes: Iterable[KnownNode]) -> KnownNode | None:
    """Return the node selected by `word` (node name, node-ID or joint), or None; raise ConfigError if ambiguous."""
    matching = [node for node in nodes if word in node.words]
    if len(matching) > 1:
        places = ", ".join(f"{node} of {node.robot} on {node.channel}" for node in matching)
        raise ConfigError(f"{word!r} is ambiguous: {places}; choose the bus with --can CHANNEL")
    return matching[0] if matching else None


# -- virtual drives: their control sockets need no robot


def drive_of(word: str, can: str | None) -> tuple[str, int]:
    """Return the channel and node-ID of the drive named `word`; raise ConfigError with the valid names if none."""
    nodes, silent = ask_nodes(can)
    node = find_node(word, nodes)
    if node is not None:
        return node.channel, node.node_id
    choices = _alternatives(nodes, silent, can)
    node_id = _node_id(word, choices)
    if can is None:
        raise ConfigError(f"no node {word!r}{choices}" if choices else _WHICH_BUS)
    return str(parse_channel(can)), node_id


def _alternatives(nodes: list[KnownNode], silent: dict[str, CanopenError], can: str | None) -> str:
    """Return the end of an error message, with the existing nodes or an error; "" if no robot runs."""
    if nodes:
        scope = "of a running robot" if can is None else f"on {can}"
        choices = f" {scope}; available: {', '.join(map(str, nodes))}"
        return f"{choices}; for another bus: --can CHANNEL" if can is None else choices
    if silent:
        why = "; ".join(f"the robot {robot!r} does not list its nodes: {error}" for robot, error in silent.items())
        return f" is known: {why}; with --can CHANNEL a drive is reached by its node-ID, without the robot"
    return ""


_WHICH_BUS = "no robot runs, so name the bus of the drive with --can CHANNEL, as in --can local:robby"


def _node_id(text: str, choices: str) -> int:
    try:
        node_id = int(text, 0)
    except ValueError:
        raise ConfigError(
            f"no node {text!r}{choices or ' is known: no robot runs there; a node-ID is 1 to 127'}"
        ) from None
    if not 1 <= node_id <= 127:
        raise ConfigError(f"{text!r} is not a node-ID: 1 to 127, or list")
    return node_id


def connect_to(channel: str, node_id: int) -> DriveClient:
    """Connect to the control socket of a virtual drive; raise RemoteError with the available drives if not running."""
    from canopen_control.client.drive_client import DriveClient

    try:
        return DriveClient.connect(channel, node_id)
    except RemoteError as error:
        if error.kind != "BusClosed":
            raise
        buses = _running_drives(drive_name(channel, node_id).rpartition("-")[0])
        raise RemoteError(error.kind, f"no virtual drive with node-ID {node_id} runs on {channel}; {buses}") from error


def _running_drives(bus: str) -> str:
    """Return a text with the node-IDs of the virtual drives on a bus, or on all buses if the bus has none."""
    drives: dict[str, list[int]] = {}
    for other, _, number in (name.rpartition("-") for name in list_sockets("drive")):
        if number.isdecimal():
            drives.setdefault(other, []).append(int(number))
    if bus in drives:
        return f"available: {', '.join(map(str, sorted(drives[bus])))}"
    if not drives:
        return "no virtual drive runs; start one with: canopen-control drive"
    elsewhere = "; ".join(f"{', '.join(map(str, sorted(ids)))} on the bus {name}" for name, ids in drives.items())
    return f"available: {elsewhere}"
