"""Nodes of running robots by the names that users type: node name, node id or joint name.

For verbs that access the buses and virtual drives of a robot directly. A robot that does not answer is skipped, because
these verbs must work while a robot hangs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.bus.channel import parse_channel
from canopen_control.client import RobotClient, find_robots
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.rpc.messages.robot import GetNodes

if TYPE_CHECKING:
    from collections.abc import Iterable


_TIMEOUT_S = 2.0


@dataclass(frozen=True, slots=True)
class KnownNode:
    """Node of a running robot, with its channel, node id, name and joints."""

    robot: str
    channel: str
    node_id: int
    name: str
    joints: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.name} ({self.node_id})"

    @property
    def words(self) -> tuple[str, ...]:
        """Names that select the node: node name, node id and joint names."""
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
    """Return the node selected by `word` (node name, node id or joint), or None; ConfigError if ambiguous."""
    matching = [node for node in nodes if word in node.words]
    if len(matching) > 1:
        places = ", ".join(f"{node} of {node.robot} on {node.channel}" for node in matching)
        raise ConfigError(f"{word!r} means more than one: {places}; choose one with --can CHANNEL")
    return matching[0] if matching else None
