"""`~/tpdo`, `~/rpdo`, `~/nmt_state` and services of ros2_canopen's device controllers: those of the node of one joint.

The law of the file (canopen_ros2_controllers): a CanopenProxyController has `~/nmt_reset_node`, `~/nmt_start_node`,
`~/sdo_read` and `~/sdo_write` (upstream's answer false to every SDO), a Cia402DeviceController the services of a drive
besides, for its own joint alone. They are made of what each node has below its own name, and answer the same. A joint
that no node drives may be the name of a node.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.ros.drive_services import DriveServices, Targets
from canopen_control.ros.drive_topics import DriveTopics
from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.nodes import nodes_of, ros_name
from canopen_control.rpc.messages.robot import GetLayout, GetNodes

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.layout import Layout
    from canopen_control.rpc.messages.robot import MappedValue, NodeListing
    from canopen_control.rpc.messages.state import ControllerReading, RobotEvent, StateSample

__all__ = ["DeviceNode", "ProxyNode"]


class ProxyNode(Endpoint):
    """What is below one controller; made when the robot has told its nodes."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._controller = ros, controller
        self._parts: list[Endpoint] = []
        self._asked = self._closed = False

    def on_controller(self, controller: ControllerReading) -> None:
        """Learn its joint, once it is configured, and find the node."""
        self._controller = controller
        if controller.joints and not self._asked:
            self._asked = True
            self._ask()

    def on_state(self, state: StateSample) -> None:
        """Let the node publish a sample."""
        for each in self._parts:
            each.on_state(state)

    def on_event(self, event: RobotEvent) -> None:
        """Let the node publish an EMCY message."""
        for each in self._parts:
            each.on_event(event)

    def on_process_data(self, nodes: dict[str, list[MappedValue]]) -> None:
        """Let the node publish what its TPDOs carry."""
        for each in self._parts:
            each.on_process_data(nodes)

    def close(self) -> None:
        """Leave the graph."""
        self._closed = True
        for each in self._parts:
            each.close()

    def own_joint(self) -> str | None:
        """Return the joint whose axis is served; None: what moves nothing."""
        return None

    def _ask(self) -> None:
        def listed(listing: NodeListing | None, error: str | None) -> None:
            if listing is None:
                self._tell(str(error))
            else:
                self._ros.ask(GetLayout(), lambda layout, _error: self._make(listing, layout))

        self._ros.ask(GetNodes(), listed)

    def _make(self, listing: NodeListing, layout: Layout | None) -> None:
        (joint,), name = self._controller.joints, self._controller.name
        node = next((each.name for each in listing.nodes if joint in each.joints), joint)
        namespace = str(self._ros.node.get_namespace())
        views = {view.name: view for view in nodes_of(listing, namespace, layout)}
        view = views.get(node)
        if view is None:
            self._tell(f"no node drives joint {joint!r}, and none has this name; `joint` is one of a node of bus.yml")
        elif not self._closed:
            own = self.own_joint()
            moved = () if own is None else (own,)
            below = view._replace(place=ros_name(name), namespace=namespace, remappings=(), joints=moved)
            self._parts = [DriveTopics(self._ros, below), DriveServices(self._ros, below, Targets(), own)]

    def _tell(self, text: str) -> None:
        self._ros.warn(self._controller.name, f"{self._controller.name} has no topics: {text}")


class DeviceNode(ProxyNode):
    """The same, and the services of a drive."""

    def own_joint(self) -> str | None:
        """Return the joint."""
        return self._controller.joints[0]
