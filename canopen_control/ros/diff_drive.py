"""The topics of a diff drive controller: `~/cmd_vel`, `~/cmd_vel_unstamped`, `~/odom` and `~/cmd_vel_out`.

The law of the file (diff_drive_controller, Jazzy): `~/cmd_vel` is a TwistStamped; where Twist alone is published on it,
as for the controller of ROS 1, it is that. Only linear.x and angular.z count, the frame of a command is not
looked at, a stamp of zero means now; how old a stamp may be is the controller's `cmd_vel_timeout`, so the stamp goes to
the runtime with the command. A twist that is not finite is dropped, and does not refresh the timeout. Odometry is
planar: z is 0, the covariances are diagonals, and only linear.x and angular.z are measured.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry

from canopen_control.ros.conversions import diagonal, quaternion_of_yaw, seconds_of
from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.ros.twist_subscription import TwistSubscription

if TYPE_CHECKING:
    from canopen_control.ros.conversions import ControllerView
    from canopen_control.ros.endpoint import Ros

__all__ = ["BaseOdometry", "TwistCommands", "send_twist"]


class TwistCommands(Endpoint):
    """The two topics of one base controller."""

    def __init__(self, ros: Ros, controller: ControllerView) -> None:
        self._ros, self._controller = ros, controller
        name = controller.name
        self._either = TwistSubscription(ros, f"{name}/cmd_vel", self._on_message, first="TwistStamped")
        self._plain = ros.subscribe(Twist, f"{name}/cmd_vel_unstamped", self._on_message, SYSTEM_DEFAULT)

    def on_controller(self, controller: ControllerView) -> None:
        """Know whether it is active."""
        self._controller = controller

    def on_state(self, state: dict[str, Any]) -> None:
        """Follow who publishes."""
        self._either.look(state)

    def close(self) -> None:
        """Leave the topics."""
        self._either.close()
        self._ros.unsubscribe(self._plain)

    def _on_message(self, message: Twist | TwistStamped) -> None:
        send_twist(self._ros, self._controller, message)


class BaseOdometry(Endpoint):
    """`~/odom`, and `~/cmd_vel_out` where the controller publishes its limited twist, each time it has a new one.

    The state stream holds it under "odometry", by controller: time, x, y, heading, linear, angular, frame_id,
    child_frame_id, pose_covariance and twist_covariance (the six of a diagonal), and `limited` as [linear, angular].
    """

    def __init__(self, ros: Ros, controller: ControllerView) -> None:
        self._ros, self._name, self._time = ros, controller.name, -math.inf
        self._publisher = ros.node.create_publisher(Odometry, f"{self._name}/odom", SYSTEM_DEFAULT)
        self._limited: Any = None

    def on_state(self, state: dict[str, Any]) -> None:
        """Publish what is new."""
        sample = (state.get("odometry") or {}).get(self._name)
        if sample is None or sample["time"] == self._time:
            return
        self._time = sample["time"]
        self._publisher.publish(odometry_message(sample))
        if sample.get("limited") is not None:
            self._publish_limited(sample)

    def close(self) -> None:
        """Leave the topics."""
        for publisher in (self._publisher, self._limited):
            if publisher is not None:
                self._ros.node.destroy_publisher(publisher)

    def _publish_limited(self, sample: dict[str, Any]) -> None:
        if self._limited is None:
            topic = f"{self._name}/cmd_vel_out"
            self._limited = self._ros.node.create_publisher(TwistStamped, topic, SYSTEM_DEFAULT)
        message = TwistStamped()
        message.header.stamp = time_message(sample["time"])
        message.header.frame_id = sample["child_frame_id"]
        message.twist.linear.x, message.twist.angular.z = map(float, sample["limited"])
        self._limited.publish(message)


def send_twist(ros: Ros, controller: ControllerView, message: Twist | TwistStamped) -> None:
    """Hand a twist to a base controller, with its stamp where it has one; what is not finite is dropped."""
    twist, stamp = message, None
    if isinstance(message, TwistStamped):
        twist, stamp = message.twist, seconds_of(message.header.stamp.sec, message.header.stamp.nanosec)
    name, linear, angular = controller.name, twist.linear.x, twist.angular.z
    if not controller.active:
        ros.warn(f"{name}/cmd_vel", f"{name} is {controller.state}; activate it before commanding it")
    elif not (math.isfinite(linear) and math.isfinite(angular)):
        text = f"{name}: a twist is not finite: linear.x {linear:g}, angular.z {angular:g}; it was dropped"
        ros.warn(f"{name}/cmd_vel", text)
    else:
        params = {"linear": linear, "angular": angular}
        ros.command(name, "twist", params if stamp is None else {**params, "stamp": stamp})


def odometry_message(sample: dict[str, Any]) -> Odometry:
    """Return a sample of the state stream as a message."""
    message = Odometry()
    message.header.stamp = time_message(sample["time"])
    message.header.frame_id, message.child_frame_id = sample["frame_id"], sample["child_frame_id"]
    pose, twist = message.pose, message.twist
    pose.pose.position.x, pose.pose.position.y = float(sample["x"]), float(sample["y"])
    _, _, pose.pose.orientation.z, pose.pose.orientation.w = quaternion_of_yaw(sample["heading"])
    pose.covariance = diagonal(sample.get("pose_covariance") or ())
    twist.twist.linear.x, twist.twist.angular.z = float(sample["linear"]), float(sample["angular"])
    twist.covariance = diagonal(sample.get("twist_covariance") or ())
    return message
