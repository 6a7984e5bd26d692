"""LaserScan of the lidars of a simulated robot, on the topics of their tags (`/scan`), as mujoco_ros2_control has them.

The law of the file: rays are cast when they are asked for, at the lidar's rate in simulated time; a robot without a
lidar is asked once. While the simulation is paused there is nothing new.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.rpc.messages.simulation import GetLaserScans

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.simulation import LaserScanReading
    from canopen_control.rpc.messages.state import StateSample

__all__ = ["LaserScans"]

_CLOSE_S: Final = 1e-6


class LaserScans(Endpoint):
    """The publishers, each made with the first scan on its topic."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._publishers: dict[str, Any] = {}  # rclpy has no types
        self._asking = self._none = False
        self._due = 0.0  # simulated seconds of the next scan

    def on_state(self, state: StateSample) -> None:
        """Ask for a scan where one is due."""
        seconds = state.sim_time
        if seconds is None or state.sim_epoch is None or self._asking or self._none:
            return
        if seconds < self._due - _CLOSE_S:
            return
        self._asking = True
        offset = state.time - seconds  # of ROS's time from the simulation's

        def answer(scans: tuple[LaserScanReading, ...] | None, error: str | None) -> None:
            self._asking, self._none = False, error is None and not scans
            for scan in scans or ():
                self._publish(scan, offset)
            if scans:
                period = min(scan.scan_time for scan in scans)
                due = self._due + period  # on its grid, unless it has fallen behind
                self._due = due if due > seconds else seconds + period
            else:
                self._due = seconds + 1.0

        self._ros.ask(GetLaserScans(), answer)

    def _publish(self, scan: LaserScanReading, offset: float) -> None:
        if scan.topic not in self._publishers:
            kind = interface("sensor_msgs/msg/LaserScan")
            self._publishers[scan.topic] = self._ros.node.create_publisher(kind, scan.topic, SYSTEM_DEFAULT)
        message = interface("sensor_msgs/msg/LaserScan")()
        message.header.stamp = time_message(scan.seconds + offset)
        message.header.frame_id = self._ros.frame(scan.frame_id)
        for field in ("angle_min", "angle_max", "angle_increment", "range_min", "range_max", "scan_time"):
            setattr(message, field, getattr(scan, field))
        message.ranges = scan.ranges
        self._publishers[scan.topic].publish(message)

    def close(self) -> None:
        """Leave the topics."""
        for publisher in self._publishers.values():
            self._ros.node.destroy_publisher(publisher)
