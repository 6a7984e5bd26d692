"""`ground_truth`: where the base of a simulated robot truly is, in the frame of its odometry (PoseStamped).

The law of the file: published for each new true pose, with its stamp, once a base controller has told the name of its
odometry frame, so that RViz shows it in the same fixed frame as `odom`; a robot whose true pose nobody knows has no
publisher of it. It is no transform: a frame has one parent, and that of the base is its odometry's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseStamped

from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.rpc.messages.samples import OdometrySample
from canopen_control.urdf.geometry import from_rpy

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.state import StateSample, TruePose

__all__ = ["GroundTruth"]


class GroundTruth(Endpoint):
    """The publisher, made with the first true pose that odometry can be compared with."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._publisher: Any = None  # rclpy has no types
        self._frame, self._last = "", 0.0

    def on_state(self, state: StateSample) -> None:
        """Publish what is new."""
        for sample in state.told(OdometrySample).values():
            self._frame = sample.frame_id
        truth = state.true_pose
        if truth is None or truth.odom is None or not self._frame or truth.time == self._last:
            return
        if self._publisher is None:
            self._publisher = self._ros.node.create_publisher(PoseStamped, "ground_truth", SYSTEM_DEFAULT)
        self._last = truth.time
        self._publisher.publish(pose_message(truth, self._ros.frame(self._frame)))

    def close(self) -> None:
        """Leave the topic."""
        if self._publisher is not None:
            self._ros.node.destroy_publisher(self._publisher)


def pose_message(truth: TruePose, frame: str) -> PoseStamped:
    """Return a true pose as a message in the frame of odometry."""
    message = PoseStamped()
    message.header.stamp, message.header.frame_id = time_message(truth.time), frame
    place, turn = message.pose.position, message.pose.orientation
    place.x, place.y, _ = truth.in_odometry or (0.0, 0.0, 0.0)
    place.z = truth.z
    turn.w, turn.x, turn.y, turn.z = from_rpy(truth.rpy or (0.0, 0.0, 0.0))
    return message
