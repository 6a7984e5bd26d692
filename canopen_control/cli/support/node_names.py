"""The nodes of running robots by the words of their users: node name, joint name or node id.

For the verbs that reach past the robot, to its wires and its virtual drives. A robot that does not answer has no names
here: what these verbs do must work while it hangs.
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

__all__ = ["KnownNode", "ask_nodes", "find_node", "known_nodes"]

_TIMEOUT_S = 2.0


@dataclass(frozen=True, slots=True)
class KnownNode:
    """A node of a running robot: where it is, and all its names."""

    robot: str
    channel: str
    node_id: int
    name: str
    joints: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.name} ({self.node_id})"

    @property
    def words(self) -> tuple[str, ...]:
        """What a user may call it."""
        return (self.name, str(self.node_id), *self.joints)


def known_nodes(channel: str | None = None) -> list[KnownNode]:
    """Return the nodes of the robots that run; those on `channel` alone where one is given."""
    return ask_nodes(channel)[0]


def ask_nodes(channel: str | None = None) -> tuple[list[KnownNode], dict[str, CanopenError]]:
    """Return the nodes as `known_nodes`, and why robots that run have told none: they hang, or end just now."""
    wanted = None if channel is None else str(parse_channel(channel))
    found: list[KnownNode] = []
    silent: dict[str, CanopenError] = {}
    for name in find_robots():
        try:
            found.extend(_nodes_of(name))
        except CanopenError as error:
            silent[name] = error
    return [node for node in found if wanted in (None, node.channel)], silent


def _nodes_of(robot: str) -> list[KnownNode]:
    with RobotClient.connect(robot, timeout=_TIMEOUT_S) as client:
        listing = client.ask(GetNodes())
    channels = {name: bus.channel for name, bus in listing.buses.items()}
    return [KnownNode(robot, channels[node.bus], node.node_id, node.name, tuple(node.joints)) for node in listing.nodes]


def find_node(word: str, nodes: Iterable[KnownNode]) -> KnownNode | None:
    """Return the node that `word` means, None where it means none; ConfigError where several robots have one."""
    found = [node for node in nodes if word in node.words]
    if len(found) > 1:
        places = ", ".join(f"{node} of {node.robot} on {node.channel}" for node in found)
        raise ConfigError(f"{word!r} means more than one: {places}; choose one with --can CHANNEL")
    return found[0] if found else None
