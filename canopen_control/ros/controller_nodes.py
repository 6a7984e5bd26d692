"""A ROS node for each controller that is loaded, and one for `/controller_manager`, each with its parameters.

The law of the file (controller_manager, Jazzy): the node of a controller has its name and the manager's namespace, and
its topics, services and actions are that node's. All nodes share the bridge's participant and the thread of its
callbacks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.ros.on_node import OnNode
from canopen_control.ros.parameter_services import ParameterServices
from canopen_control.ros.rcl import further_node

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.ros.on_node import Shared
    from canopen_control.ros.rcl import Context, Node
    from canopen_control.ros.spinner import Spinner

__all__ = ["ControllerNodes"]


class ControllerNodes:
    """Makes the nodes beside `first`, the bridge's; `of` tells what the endpoints of one are given."""

    def __init__(self, shared: Shared, first: Node, context: Context, spinner: Spinner) -> None:
        self._shared, self._first, self._context, self._spinner = shared, first, context, spinner
        self._nodes: dict[str, tuple[OnNode, ParameterServices]] = {}

    def of(self, name: str, arguments: Sequence[str] = ()) -> OnNode:
        """Return what is on the node of this name, which is made when it is first asked for; whatever rclpy raises."""
        if name not in self._nodes:
            node = further_node(name, self._context, str(self._first.get_namespace()), arguments)
            self._spinner.add(node)
            ros = OnNode(self._shared, node)
            self._nodes[name] = (ros, ParameterServices(ros, name))
        return self._nodes[name][0]

    def forget(self, name: str) -> None:
        """Remove a node, once what was on it has been closed."""
        found = self._nodes.pop(name, None)
        if found is not None:
            ros, parameters = found
            parameters.close()
            self._spinner.remove(ros.node)

    def close(self) -> None:
        """Remove all."""
        for name in list(self._nodes):
            self.forget(name)
