"""`/robot_description`, as robot_state_publisher publishes it: the URDF, kept for who comes later."""

from __future__ import annotations

from typing import TYPE_CHECKING

from std_msgs.msg import String

from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.qos import LATCHED

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros

__all__ = ["RobotDescription"]


class RobotDescription(Endpoint):
    """Published once, when the bridge starts; transient local."""

    def __init__(self, ros: Ros, urdf: str) -> None:
        self._ros = ros
        self._publisher = ros.node.create_publisher(String, "robot_description", LATCHED)
        self._publisher.publish(String(data=urdf))

    def close(self) -> None:
        """Leave the topic."""
        self._ros.node.destroy_publisher(self._publisher)
