"""The nodes of a bus as ROS names them, from what `nodes` of the API tells: this file imports no ROS.

The law of the file (ros2_canopen): the services and topics of a node are `NAMESPACE/NODE/x`, where NODE is its key in
bus.yml; its own `namespace` stands in the place of the bridge's, its own `remappings` are followed. A name that ROS
does not allow gets underscores in the place of what is not allowed.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["NMT_STATES", "NodeView", "nodes_of", "resolve", "ros_name"]

#: what ros2_canopen calls an NMT state; one that is not known any more is an error
NMT_STATES: Final = {
    "INITIALISING": "BOOTUP",
    "PRE_OPERATIONAL": "PREOP",
    "OPERATIONAL": "START",
    "STOPPED": "STOP",
    None: "ERROR",
}
_FORBIDDEN: Final = re.compile(r"[^A-Za-z0-9_]")


class NodeView(NamedTuple):
    """A node of the bus; `remappings` are pairs of names that were made absolute."""

    name: str
    node_id: int
    namespace: str = ""
    remappings: tuple[tuple[str, str], ...] = ()
    lifecycle: bool = False

    def path(self, what: str) -> str:
        """Return the name of one of its services or topics, remapped."""
        path = resolve(self.namespace, f"{ros_name(self.name)}/{what}".rstrip("/"))
        return dict(self.remappings).get(path, path)


def nodes_of(answer: Mapping[str, Any], namespace: str) -> list[NodeView]:
    """Return the nodes of the API's answer; `namespace` is the bridge's."""
    return [_node(each, namespace) for each in answer.get("nodes") or ()]


def ros_name(name: str) -> str:
    """Return a name as ROS allows it: letters, digits and underscores, no digit first."""
    allowed = _FORBIDDEN.sub("_", name)
    return allowed if allowed[:1].isalpha() or allowed[:1] == "_" else f"_{allowed}"


def resolve(namespace: str, name: str, node: str = "") -> str:
    """Return an absolute name: of one that is absolute, private (`~/x`, below `node`) or relative to a namespace."""
    if name.startswith("/"):
        return name
    if name.startswith("~"):
        name = f"{node}/{name[1:].lstrip('/')}"
    return f"/{namespace.strip('/')}/{name}" if namespace.strip("/") else f"/{name}"


def _node(told: Mapping[str, Any], bridges: str) -> NodeView:
    name, own = str(told["name"]), str(told.get("namespace") or "")
    namespace = own or bridges
    rules = told.get("remappings")
    pairs = rules.items() if isinstance(rules, dict) else ()
    remappings = tuple(
        (resolve(namespace, str(old), ros_name(name)), resolve(namespace, str(new), ros_name(name)))
        for old, new in pairs
    )
    return NodeView(name, int(told["node_id"]), namespace, remappings, "Lifecycle" in str(told.get("driver") or ""))
