"""The topics and the service of base controllers: twists come, odometry goes, and is set.

The law of the file (ros2_controllers, Jazzy): twists are TwistStamped on `~/cmd_vel` (diff drive, omni) or
`~/reference` (steering, mecanum); where Twist alone is published there, as for the controller of ROS 1, it is that, and
`~/cmd_vel_unstamped` takes it too. Only the axes that the base has count, the frame of a command is not looked at, a
stamp of zero means now; how old a stamp may be is the controller's timeout, so the stamp goes to the runtime with the
command. A twist that is not finite is dropped, and does not refresh the timeout. Odometry is planar: z is 0, and the
covariances are diagonals. `~/set_odometry` takes a pose in the plane from the next update on, while the controller is
active. Where upstream has `~/tf_odometry` to be remapped to `/tf`, both are there.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry

from canopen_control.ros.conversions import diagonal, seconds_of
from canopen_control.ros.endpoint import COMMANDER, Endpoint, NewSamples, success_of
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import REFERENCE, SYSTEM_DEFAULT
from canopen_control.ros.twist_subscription import TwistSubscription
from canopen_control.rpc.messages.robot import SetOdometry, TwistController
from canopen_control.rpc.messages.samples import OdometrySample
from canopen_control.urdf.geometry import from_yaw

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Reply, Ros, RosMessage
    from canopen_control.rpc.messages.state import ControllerReading, StateSample

__all__ = ["BaseOdometry", "OdometrySetting", "TwistCommands", "send_twist"]


_QUALITIES: Final[dict[str | None, Any]] = {"reference": REFERENCE}
"""How twists are subscribed to, by the topic's last word; SYSTEM_DEFAULT where it is none of these."""


class TwistCommands(Endpoint):
    """The two topics of one base controller."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._controller = ros, controller
        topic, quality = f"{controller.name}/{controller.topic}", _QUALITIES.get(controller.topic, SYSTEM_DEFAULT)
        self._either = TwistSubscription(ros, topic, self._on_message, first="TwistStamped", quality=quality)
        self._plain = ros.subscribe(Twist, f"{topic}_unstamped", self._on_message, quality)

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
    """`~/odom` or `~/odometry`, and `~/cmd_vel_out` where the limited twist is published, for each new sample."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._name, self._samples = ros, controller.name, NewSamples(OdometrySample)
        self._publisher = ros.node.create_publisher(
            Odometry, f"{self._name}/{controller.odometry_topic}", SYSTEM_DEFAULT
        )
        self._limited: Any = None

    def on_state(self, state: StateSample) -> None:
        """Publish what is new."""
        sample = self._samples.of(state).get(self._name)
        if sample is None:
            return
        self._publisher.publish(odometry_message(self._ros, sample))
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
        message.header.frame_id = self._ros.frame(sample.child_frame_id)
        message.twist.linear.x, message.twist.angular.z = linear, angular
        self._limited.publish(message)


class OdometrySetting(Endpoint):
    """The service `~/set_odometry`."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._controller = ros, controller.name
        name = f"{controller.name}/set_odometry"
        self._service = ros.serve("control_msgs/srv/SetOdometry", name, self._answer)

    def close(self) -> None:
        """Leave the graph."""
        self._ros.unserve(self._service)

    def _answer(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        fill = success_of(response, reply)
        tilted = [axis for axis in ("z", "roll", "pitch") if getattr(request, axis) != 0.0]
        if tilted:
            fill(None, f"{self._controller} drives in the plane; {', '.join(tilted)} must be 0")
        else:
            wanted = SetOdometry(controller=self._controller, x=request.x, y=request.y, heading=request.yaw)
            self._ros.ask(wanted, fill)


def send_twist(ros: Ros, controller: ControllerReading, message: Twist | TwistStamped) -> None:
    """Hand a twist to a base controller, with its stamp where it has one; what is not finite is dropped."""
    twist, stamp = message, None
    if isinstance(message, TwistStamped):
        made = message.header.stamp
        twist, stamp = message.twist, ros.unix(seconds_of(made.sec, made.nanosec))
    name, lateral = controller.name, twist.linear.y if controller.drives_sideways else 0.0
    wanted = {"linear.x": twist.linear.x, "linear.y": lateral, "angular.z": twist.angular.z}
    key = f"{name}/{controller.topic}"
    if not controller.active:
        ros.warn(key, f"{name} is {controller.state}; activate it before commanding it")
    elif not all(map(math.isfinite, wanted.values())):
        text = ", ".join(f"{axis} {value:g}" for axis, value in wanted.items() if axis != "linear.y" or lateral)
        ros.warn(key, f"{name}: a twist is not finite: {text}; it was dropped")
    else:
        linear, angular = wanted["linear.x"], wanted["angular.z"]
        ros.command(
            TwistController(
                controller=name,
                linear=linear,
                lateral=lateral,
                angular=angular,
                stamp=stamp,
                source=COMMANDER,
                dead_man=True,
            )
        )


def odometry_message(ros: Ros, sample: OdometrySample) -> Odometry:
    """Return a sample of the state stream as a message."""
    message = Odometry()
    message.header.stamp = time_message(sample.time)
    message.header.frame_id, message.child_frame_id = ros.frame(sample.frame_id), ros.frame(sample.child_frame_id)
    pose, twist = message.pose, message.twist
    pose.pose.position.x, pose.pose.position.y = sample.x, sample.y
    pose.pose.orientation.w, _, _, pose.pose.orientation.z = from_yaw(sample.heading)
    pose.covariance = diagonal(sample.pose_covariance)
    twist.twist.linear.x, twist.twist.linear.y, twist.twist.angular.z = sample.linear, sample.lateral, sample.angular
    twist.covariance = diagonal(sample.twist_covariance)
    return message
