"""`/tf` and `/tf_static`: the odometry of a base, and robot_state_publisher's job for the joints of the description.

The law of the file: both topics are absolute; static ones are kept for who comes later, moving ones are reliable and
follow the state stream, stamped with the time of its sample, the
joints' only while a broadcaster tells their states. Frames get the prefix of the namespace, so that two robots
fit into one graph. A frame has one parent: a joint that leads to the base of an active odometry is left out.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import TransformStamped

from canopen_control.ros.conversions import quaternion_of_yaw
from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import TF, TF_STATIC
from canopen_control.ros.transforms import JointFrame, Transform, read_joints

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros

__all__ = ["Frames"]


class Frames(Endpoint):
    """The transforms of one robot, `urdf` its description."""

    def __init__(self, ros: Ros, urdf: str, prefix: str) -> None:
        self._ros, self._prefix = ros, prefix
        self._tf_message = interface("tf2_msgs/msg/TFMessage")
        joints = read_joints(urdf)
        self._moving = [each for each in joints if not each.fixed]
        self._fixed = [each for each in joints if each.fixed]
        self._based: frozenset[str] = frozenset()  # the frames whose parent is an odometry frame
        self._times: dict[str, float] = {}
        self._publisher = ros.node.create_publisher(self._tf_message, "/tf", TF)
        self._static = ros.node.create_publisher(self._tf_message, "/tf_static", TF_STATIC)
        self._publish_fixed(0.0)

    def on_state(self, state: dict[str, Any]) -> None:
        """Publish where everything that moves is now."""
        time, odometry = state["time"], state.get("odometry") or {}
        based = frozenset(each["child_frame_id"] for each in odometry.values() if _broadcast(each))
        if based != self._based:
            self._based = based
            self._publish_fixed(time)
        transforms = [self._message(each, time) for each in self._of(self._moving, self._positions(state))]
        transforms += [
            self._message(_of_odometry(each), each["time"])
            for name, each in odometry.items()
            if self._is_new(name, each)
        ]
        if transforms:
            self._publisher.publish(self._tf_message(transforms=transforms))

    def close(self) -> None:
        """Leave the topics."""
        for publisher in (self._publisher, self._static):
            self._ros.node.destroy_publisher(publisher)

    def _positions(self, state: dict[str, Any]) -> dict[str, float]:
        if not any(each.is_broadcaster and each.active for each in self._ros.controllers.values()):
            return {}
        joints = state["joints"].items()
        return {name: value for name, each in joints if (value := each.get("position")) is not None}

    def _is_new(self, name: str, sample: dict[str, Any]) -> bool:
        known, self._times[name] = self._times.get(name), sample["time"]
        return _broadcast(sample) and known != sample["time"]

    def _publish_fixed(self, time: float) -> None:
        transforms = [self._message(each, time) for each in self._of(self._fixed, {})]
        self._static.publish(self._tf_message(transforms=transforms))

    def _of(self, joints: list[JointFrame], positions: dict[str, float]) -> list[Transform]:
        transforms = (each.transform(positions) for each in joints if each.child not in self._based)
        return [each for each in transforms if each is not None]

    def _message(self, transform: Transform, time: float) -> TransformStamped:
        message = TransformStamped()
        message.header.stamp = time_message(time)
        message.header.frame_id = self._prefix + transform.parent
        message.child_frame_id = self._prefix + transform.child
        moved, turned = message.transform.translation, message.transform.rotation
        moved.x, moved.y, moved.z = transform.translation
        turned.x, turned.y, turned.z, turned.w = transform.rotation
        return message


def _broadcast(sample: dict[str, Any]) -> bool:
    return bool(sample.get("enable_odom_tf", True)) and math.isfinite(sample["x"])


def _of_odometry(sample: dict[str, Any]) -> Transform:
    translation = (float(sample["x"]), float(sample["y"]), 0.0)
    return Transform(sample["frame_id"], sample["child_frame_id"], translation, quaternion_of_yaw(sample["heading"]))
