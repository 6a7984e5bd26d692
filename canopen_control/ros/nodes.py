"""Nodes of a bus and their ROS names, by the API; without ROS.

Rules (ros2_canopen): the services and topics of a node are `NAMESPACE/NODE/x`, where NODE is its key in
bus.yml; its own `namespace` stands in the place of the bridge's, its own `remappings` are followed. Each axis of a node
with several has its own below its name in `channel_names`, else below `NODE/JOINT` (`NODE/0` of ros2_canopen is not
allowed by ROS). A name that ROS does not allow gets underscores in the place of what is not allowed.
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


#: what ros2_canopen calls an NMT state; one that is not known any more is an error
NMT_STATES: Final = {
    "INITIALISING": "BOOTUP",
    "PRE_OPERATIONAL": "PREOP",
    "OPERATIONAL": "START",
    "STOPPED": "STOP",
    None: "ERROR",
}
_FORBIDDEN: Final = re.compile(r"[^A-Za-z0-9_]")


class Channel(NamedTuple):
    """Axis of a multi-axis node: its joint, and the path of its services."""

    joint: str
    name: str


class RosNode(NamedTuple):
    """Node of the bus; `remappings` are pairs of absolute names.

    `rpdo` are the objects that its RPDOs map, with their bits, by index and subindex. `channels` is empty for a node
    with one axis or none. `joints` are what it moves, none for a proxy; `is_drive`: its EDS has a controlword.
    `place` is what its services and topics are below where that is not its name.
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
        """Return the remapped name of one of its services or topics, or of a channel's."""
        below = (self.place or ros_name(self.name)) if channel is None else channel.name
        path = resolve(self.namespace, f"{below}/{name}".rstrip("/"))
        return dict(self.remappings).get(path, path)


def nodes_of(
    listing: NodeListing, namespace: str, layout: Layout | None = None, states: Mapping[str, NodeReading] | None = None
) -> list[RosNode]:
    """Return the nodes of the API's listing; `namespace` is the bridge's; `states` are those of the status."""
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
    """Return a name with the characters that ROS allows: letters, digits and underscores, no digit first."""
    allowed = _FORBIDDEN.sub("_", name)
    return allowed if allowed[:1].isalpha() or allowed[:1] == "_" else f"_{allowed}"


def resolve(namespace: str, name: str, node: str = "") -> str:
    """Return the absolute form of a name: absolute, private (`~/x`, below `node`) or relative to a namespace."""
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
    """Yield the name of each node and the objects mapped in its RPDOs."""
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
