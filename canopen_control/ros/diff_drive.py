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

from canopen_control.ros.conversions import diagonal, seconds_of
from canopen_control.ros.endpoint import COMMANDER, Endpoint, NewSamples
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.ros.twist_subscription import TwistSubscription
from canopen_control.rpc.messages.robot import TwistController
from canopen_control.rpc.messages.samples import OdometrySample
from canopen_control.urdf.geometry import from_yaw

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.state import ControllerReading, StateSample

__all__ = ["BaseOdometry", "TwistCommands", "send_twist"]


class TwistCommands(Endpoint):
    """The two topics of one base controller."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._controller = ros, controller
        name = controller.name
        self._either = TwistSubscription(ros, f"{name}/cmd_vel", self._on_message, first="TwistStamped")
        self._plain = ros.subscribe(Twist, f"{name}/cmd_vel_unstamped", self._on_message, SYSTEM_DEFAULT)

    def on_controller(self, controller: ControllerReading) -> None:
        """Know whether it is active."""
        self._controller = controller

    def on_state(self, state: StateSample) -> None:
        """Follow who publishes."""
        self._either.look(state)

    def close(self) -> None:
        """Leave the topics."""
        self._either.close()
        self._ros.unsubscribe(self._plain)

    def _on_message(self, message: Twist | TwistStamped) -> None:
        send_twist(self._ros, self._controller, message)


class BaseOdometry(Endpoint):
    """`~/odom`, and `~/cmd_vel_out` where the controller publishes its limited twist, each time it has a new one."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._name, self._samples = ros, controller.name, NewSamples(OdometrySample)
        self._publisher = ros.node.create_publisher(Odometry, f"{self._name}/odom", SYSTEM_DEFAULT)
        self._limited: Any = None

    def on_state(self, state: StateSample) -> None:
        """Publish what is new."""
        sample = self._samples.of(state).get(self._name)
        if sample is None:
            return
        self._publisher.publish(odometry_message(sample))
        if sample.limited is not None:
            self._publish_limited(sample, *sample.limited)

    def close(self) -> None:
        """Leave the topics."""
        for publisher in (self._publisher, self._limited):
            if publisher is not None:
                self._ros.node.destroy_publisher(publisher)

    def _publish_limited(self, sample: OdometrySample, linear: float, angular: float) -> None:
        if self._limited is None:
            topic = f"{self._name}/cmd_vel_out"
            self._limited = self._ros.node.create_publisher(TwistStamped, topic, SYSTEM_DEFAULT)
        message = TwistStamped()
        message.header.stamp = time_message(sample.time)
        message.header.frame_id = sample.child_frame_id
        message.twist.linear.x, message.twist.angular.z = linear, angular
        self._limited.publish(message)


def send_twist(ros: Ros, controller: ControllerReading, message: Twist | TwistStamped) -> None:
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
        ros.command(
            TwistController(
                controller=name, linear=linear, angular=angular, stamp=stamp, source=COMMANDER, dead_man=True
            )
        )


def odometry_message(sample: OdometrySample) -> Odometry:
    """Return a sample of the state stream as a message."""
    message = Odometry()
    message.header.stamp = time_message(sample.time)
    message.header.frame_id, message.child_frame_id = sample.frame_id, sample.child_frame_id
    pose, twist = message.pose, message.twist
    pose.pose.position.x, pose.pose.position.y = sample.x, sample.y
    pose.pose.orientation.w, _, _, pose.pose.orientation.z = from_yaw(sample.heading)
    pose.covariance = diagonal(sample.pose_covariance)
    twist.twist.linear.x, twist.twist.angular.z = sample.linear, sample.angular
    twist.covariance = diagonal(sample.twist_covariance)
    return message
