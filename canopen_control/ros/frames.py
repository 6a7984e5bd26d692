"""Publisher of `/tf` and `/tf_static`, which includes the URDF's joints like robot_state_publisher.

Both topics have absolute names; static transforms are transient local for later subscribers, and moving ones are
reliable and sent once for each joint state, odometry and pose that a controller publishes, with the stamp of that
sample. Frames get the prefix of the namespace, here and in all other messages, so that two robots fit into one graph. A
frame has one parent: a joint is omitted if odometry or a pose sample already defines the frame of its child.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from geometry_msgs.msg import TransformStamped

from canopen_control.ros.conversions import located_frames, odometry_pose, positions_of, transform_of
from canopen_control.ros.endpoint import Endpoint, NewSamples
from canopen_control.ros.interfaces import interface
from canopen_control.ros.qos import TF, TF_STATIC
from canopen_control.ros.sample_publisher import time_message
from canopen_control.rpc.messages.samples import JointStatesSample, OdometrySample, PoseSample
from canopen_control.urdf.robot_model import read_model

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import NodeContext
    from canopen_control.rpc.messages.state import StateSample
    from canopen_control.urdf.joint_element import Joint, Transform


class Frames(Endpoint):
    """Publisher of the transforms of one robot; `urdf` is the URDF text."""

    def __init__(self, ros: NodeContext, urdf: str) -> None:
        self._ros = ros
        self._tf_message = interface("tf2_msgs/msg/TFMessage")
        joints = read_model(urdf).joints.values()
        self._moving = [joint for joint in joints if not joint.fixed]
        self._fixed = [joint for joint in joints if joint.fixed]
        self._based: frozenset[str] = frozenset()  # frames whose transform comes from odometry or a pose sample
        self._joint_states = NewSamples(JointStatesSample)
        self._odometry, self._poses = NewSamples(OdometrySample), NewSamples(PoseSample)
        self._publisher = ros.node.create_publisher(self._tf_message, "/tf", TF)
        self._static = ros.node.create_publisher(self._tf_message, "/tf_static", TF_STATIC)
        self._publish_fixed(0.0)

    def on_state(self, state: StateSample) -> None:
        based = located_frames(state)
        if based != self._based:
            self._based = based
            self._publish_fixed(state.time)
        transforms = [
            self._message(transform, joint_states.time)
            for joint_states in self._joint_states.of(state).values()
            for transform in self._of(self._moving, positions_of(joint_states))
        ]
        transforms += [
            self._message(transform, joint_states.time)
            for joint_states in (*self._odometry.of(state).values(), *self._poses.of(state).values())
            if (transform := transform_of(joint_states)) is not None
        ]
        if transforms:
            self._publisher.publish(self._tf_message(transforms=transforms))

    def close(self) -> None:
        for publisher in (self._publisher, self._static):
            self._ros.node.destroy_publisher(publisher)

    def _publish_fixed(self, time: float) -> None:
        transforms = [self._message(transform, time) for transform in self._of(self._fixed, {})]
        self._static.publish(self._tf_message(transforms=transforms))

    def _of(self, joints: list[Joint], positions: dict[str, float]) -> list[Transform]:
        transforms = (joint.transform(positions) for joint in joints if joint.child not in self._based)
        return [transform for transform in transforms if transform is not None]

    def _message(self, transform: Transform, time: float) -> TransformStamped:
        return transform_message(self._ros, transform, time)


def transform_message(ros: NodeContext, transform: Transform, time: float) -> TransformStamped:
    """Return a transform as a stamped ROS message, with the robot's prefix in the frame names."""
    message = TransformStamped()
    message.header.stamp = time_message(time)
    message.header.frame_id = ros.frame(transform.parent)
    message.child_frame_id = ros.frame(transform.child)
    translation, rotation = message.transform.translation, message.transform.rotation
    translation.x, translation.y, translation.z = transform.pose.position
    rotation.w, rotation.x, rotation.y, rotation.z = transform.pose.rotation
    return message


def odometry_transform(ros: NodeContext, sample: OdometrySample) -> TransformStamped:
    """Return the pose of an odometry sample as a transform message."""
    return transform_message(ros, odometry_pose(sample), sample.time)
