"""Nodes of a bus and their ROS names, created from API messages without importing ROS.

Rules (ros2_canopen): the services and topics of a node are `NAMESPACE/NODE/x`, where NODE is the key in bus.yml; the
node's `namespace` replaces the bridge's namespace, and its `remappings` are applied. Every axis of a multi-axis node
has its own services below its name in `channel_names`, or without this list below `NODE/JOINT` (`NODE/0` of
ros2_canopen is not a valid ROS name). Characters that ROS does not allow in a name are replaced by underscores.
"""

from __future__ import annotations

import re
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from canopen_control.rpc.messages.layout import Layout
    from canopen_control.rpc.messages.robot import NodeListing, NodePlace
    from canopen_control.rpc.messages.state import NodeReading


#: names of the NMT states in ros2_canopen; an unknown state is "ERROR"
NMT_STATES: Final = {
    "INITIALISING": "BOOTUP",
    "PRE_OPERATIONAL": "PREOP",
    "OPERATIONAL": "START",
    "STOPPED": "STOP",
    None: "ERROR",
}
_FORBIDDEN: Final = re.compile(r"[^A-Za-z0-9_]")


class Channel(NamedTuple):
    """Axis of a multi-axis node; the services of the axis are below the path `name`."""

    joint: str
    name: str


class RosNode(NamedTuple):
    """Node of a bus with its ROS names; `remappings` are pairs of absolute names.

    `rpdo` has the number of bits of each object that is mapped in an RPDO, by index and subindex. `channels` is empty
    for nodes with fewer than two axes. `joints` are the joints that the node moves, none for a proxy. `is_drive` is
    True if the EDS has a controlword. `place` is the path below which the node has its services and topics, "" for its
    name.
    """

    name: str
    node_id: int
    namespace: str = ""
    remappings: tuple[tuple[str, str], ...] = ()
    lifecycle: bool = False
    rpdo: Mapping[tuple[int, int], int] = MappingProxyType({})
    channels: tuple[Channel, ...] = ()
    joints: tuple[str, ...] = ()
    is_drive: bool = False
    place: str = ""

    def path(self, name: str, channel: Channel | None = None) -> str:
        """Return the absolute name of a service or topic of the node or of a channel, after remapping."""
        below = (self.place or ros_name(self.name)) if channel is None else channel.name
        path = resolve(self.namespace, f"{below}/{name}".rstrip("/"))
        return dict(self.remappings).get(path, path)


def nodes_of(
    listing: NodeListing, namespace: str, layout: Layout | None = None, states: Mapping[str, NodeReading] | None = None
) -> list[RosNode]:
    """Return the nodes in an API listing, with their ROS names.

    `namespace` is the bridge's namespace; `states` are the nodes in the robot's status, with their axes.
    """
    mapped = {} if layout is None else dict(_mapped(layout))
    known_states = states or {}
    return [
        _node(node, namespace)._replace(
            rpdo=mapped.get(node.name, {}),
            channels=_channels(node, known_states.get(node.name)),
            joints=tuple(
                node.joints
                or (axis.joint for axis in (known_states[node.name].axes if node.name in known_states else ()))
            ),
        )
        for node in listing.nodes
    ]


def ros_name(name: str) -> str:
    """Replace characters that ROS does not allow by underscores; an underscore precedes a leading digit."""
    allowed = _FORBIDDEN.sub("_", name)
    return allowed if allowed[:1].isalpha() or allowed[:1] == "_" else f"_{allowed}"


def resolve(namespace: str, name: str, node: str = "") -> str:
    """Return the absolute form of a name that is absolute, private (`~/x`, below `node`) or relative to `namespace`."""
    if name.startswith("/"):
        return name
    if name.startswith("~"):
        name = f"{node}/{name[1:].lstrip('/')}"
    return f"/{namespace.strip('/')}/{name}" if namespace.strip("/") else f"/{name}"


def _node(place: NodePlace, bridges: str) -> RosNode:
    namespace = place.namespace or bridges
    remappings = tuple(
        (resolve(namespace, old, ros_name(place.name)), resolve(namespace, new, ros_name(place.name)))
        for old, new in place.remappings.items()
    )
    lifecycle, is_drive = "Lifecycle" in (place.driver or ""), place.axes > 0
    return RosNode(place.name, place.node_id, namespace, remappings, lifecycle, is_drive=is_drive)


def _mapped(layout: Layout) -> Iterator[tuple[str, dict[tuple[int, int], int]]]:
    """Yield the name of each node with the numbers of bits of the objects that are mapped in its RPDOs."""
    for bus in layout.buses.values():
        for node in bus.nodes:
            objects = [entry for pdo in node.pdos if pdo.direction == "rpdo" for entry in pdo.objects]
            yield node.name, {(entry.index, entry.subindex): entry.bits for entry in objects}


def _channels(place: NodePlace, state: NodeReading | None) -> tuple[Channel, ...]:
    axes = () if state is None else state.axes
    if len(axes) < 2:
        return ()
    names = [ros_name(name) for name in place.channel_names or ()]
    node = ros_name(place.name)
    return tuple(
        Channel(axis.joint, names[axis.axis] if axis.axis < len(names) else f"{node}/{ros_name(axis.joint)}")
        for axis in axes
    )
