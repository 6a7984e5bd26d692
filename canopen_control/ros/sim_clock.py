"""`/clock` of a simulated robot, for programs with `use_sim_time`.

The law of the file: published only while the robot says what time its simulation has; a real robot has no `/clock`, and
no publisher of one, since whoever uses simulated time would stand still on it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rosgraph_msgs.msg import Clock

from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import SYSTEM_DEFAULT

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.state import StateSample

__all__ = ["SimClock"]


class SimClock(Endpoint):
    """The publisher, made with the first sample that carries a simulated time."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._publisher: Any = None  # rclpy has no types

    def on_state(self, state: StateSample) -> None:
        """Publish the time of a sample."""
        seconds = state.sim_time
        if seconds is None:
            return
        if self._publisher is None:
            self._publisher = self._ros.node.create_publisher(Clock, "/clock", SYSTEM_DEFAULT)
        self._publisher.publish(Clock(clock=time_message(seconds)))

    def close(self) -> None:
        """Leave the topic."""
        if self._publisher is not None:
            self._ros.node.destroy_publisher(self._publisher)
