"""Topics and services of base controllers for twist commands and odometry, and `/tf` with `/tf_static`.

Rules (ros2_controllers, Jazzy): twists are TwistStamped on `~/cmd_vel` (diff drive, omni) or `~/reference` (steering,
mecanum); if only Twist is published there, as for the controller of ROS 1, Twist is subscribed instead, and
`~/cmd_vel_unstamped` accepts Twist too. Only the velocity components in which the base can move are used; the frame of
a command is ignored; a stamp of zero means now. The controller's timeout limits the age of a stamp, so the stamp is
passed to the runtime with the command. A twist that is not finite is dropped, and does not refresh the timeout.
Odometry is planar: z is 0, and the covariances are diagonal. `~/set_odometry` sets the pose in the plane from the next
update on, while the controller is active. Upstream has `~/tf_odometry` to be remapped to `/tf`; here both are
published.

The transforms include the URDF's joints like robot_state_publisher. Both topics have absolute names; static transforms
are transient local for later subscribers, and moving ones are reliable and sent once for each joint state, odometry and
pose that a controller publishes, with the stamp of that sample. Frames get the prefix of the namespace, here and in all
other messages, so that one graph can contain two robots. A frame has one parent: a joint is omitted if odometry or a
pose sample already determines the frame of its child.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from geometry_msgs.msg import TransformStamped, Twist, TwistStamped

from canopen_control.ros.conversions import located_frames, odometry_pose, positions_of, seconds_of, transform_of
from canopen_control.ros.endpoint import COMMANDER, Endpoint, NewSamples, success_of
from canopen_control.ros.interfaces import interface
from canopen_control.ros.rcl import REFERENCE, SYSTEM_DEFAULT, TF, TF_STATIC
from canopen_control.ros.sample_publisher import time_message
from canopen_control.rpc.messages.robot import SetOdometry, TwistController
from canopen_control.rpc.messages.samples import JointStatesSample, OdometrySample, PoseSample
from canopen_control.urdf.robot_model import read_model

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.ros.endpoint import NodeContext, Reply, RosMessage
    from canopen_control.rpc.messages.state import ControllerReading, StateSample
    from canopen_control.urdf.joint_element import Joint, Transform


# Topic on which velocities arrive as Twist or as TwistStamped, whichever is published.
#
# A context of rclpy cannot have two types under one topic name, so there is one subscription at a time. Its type is the
# requested type, or with `auto` the type of the first publisher that is discovered; the type changes only when all
# publishers of the old type are gone, and between two checks.


AUTO: Final = "auto"
_CHECK_S: Final = 0.25
_PACKAGE: Final = "geometry_msgs/msg/"
_TYPES: Final[dict[str, type]] = {f"{_PACKAGE}Twist": Twist, f"{_PACKAGE}TwistStamped": TwistStamped}


class TwistSubscription:
    """Subscription of a twist topic as Twist or TwistStamped; with "auto" the type follows the publishers.

    `kind` is "Twist", "TwistStamped" or "auto". With "auto", `first` is the type until a publisher exists; "" means no
    subscription until then. `on_message` receives a Twist or a TwistStamped.
    """

    def __init__(
        self,
        ros: NodeContext,
        topic: str,
        on_message: Callable[[Twist | TwistStamped], object],
        kind: str = AUTO,
        first: str = "",
        quality: object = SYSTEM_DEFAULT,
    ) -> None:
        self._ros, self._topic, self._deliver, self._auto = ros, topic, on_message, kind == AUTO
        self._subscription: object = None
        self._quality = quality
        self._type, self._next = "", 0.0
        topic_kind = first if self._auto else kind
        if topic_kind:
            self._subscribe(f"{_PACKAGE}{topic_kind}")

    def check_types(self, state: StateSample) -> None:
        """With "auto", change the subscription to the type of the publishers; call with every state sample."""
        time = state.time
        # checks continue after the clock was set back
        if not self._auto or time < self._next <= time + _CHECK_S:
            return
        self._next = time + _CHECK_S
        published = {publisher.topic_type for publisher in self._ros.node.get_publishers_info_by_topic(self._topic)}
        kinds = [name for name in _TYPES if name in published]
        if len(kinds) > 1:
            text = f"{self._topic} is published as {' and as '.join(kinds)}; only {self._type} is received"
            self._ros.warn(self._topic, text)
        if kinds and self._type not in kinds:
            self._change(kinds[0])

    def close(self) -> None:
        if self._subscription is not None:
            self._ros.unsubscribe(self._subscription)

    def _change(self, name: str) -> None:
        """Subscribe to the type `name`; an old subscription is ended first, and then the next check subscribes."""
        if self._subscription is None:
            self._subscribe(name)
        else:
            self.close()
            self._subscription, self._type = None, ""

    def _subscribe(self, name: str) -> None:
        self._subscription = self._ros.subscribe(_TYPES[name], self._topic, self._deliver, self._quality)
        self._type = name


_QUALITIES: Final[dict[str | None, Any]] = {"reference": REFERENCE}
"""Quality of service by the controller's `topic`; SYSTEM_DEFAULT for all others."""


class TwistCommands(Endpoint):
    """Subscriptions of a base controller's twist topic, and of the same topic with the suffix `_unstamped`."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller = controller
        topic, quality = f"{controller.name}/{controller.topic}", _QUALITIES.get(controller.topic, SYSTEM_DEFAULT)
        receive, unstamped = partial(self._send, topic), f"{topic}_unstamped"
        self._main = TwistSubscription(ros, topic, receive, first="TwistStamped", quality=quality)
        self.subscribe(Twist, unstamped, partial(self._send, unstamped), quality)

    def on_controller(self, controller: ControllerReading) -> None:
        self._controller = controller

    def on_state(self, state: StateSample) -> None:
        self._main.check_types(state)

    def close(self) -> None:
        self._main.close()
        super().close()

    def _send(self, topic: str, message: Twist | TwistStamped) -> None:
        send_twist(self._ros, self._controller, topic, message)


class OdometrySetting(Endpoint):
    """Service `~/set_odometry` of a base controller."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller = controller.name
        self.serve("control_msgs/srv/SetOdometry", f"{controller.name}/set_odometry", self._answer)

    def _answer(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        fill = success_of(response, reply)
        tilted = [axis for axis in ("z", "roll", "pitch") if getattr(request, axis) != 0.0]
        if tilted:
            fill(None, f"{self._controller} moves only in the plane; {', '.join(tilted)} must be 0")
        else:
            command = SetOdometry(controller=self._controller, x=request.x, y=request.y, heading=request.yaw)
            self._ros.ask(command, fill)


class OdometryReset(Endpoint):
    """Service `~/reset_odometry` of the tricycle controller; it sets the pose to 0."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller, self._name = controller.name, f"{controller.name}/reset_odometry"
        self.serve("std_srvs/srv/Empty", self._name, self._answer)

    def _answer(self, _request: RosMessage, response: RosMessage, reply: Reply) -> None:
        def fill(_done: object, error: str | None) -> None:
            self.report(self._name, error)  # the response of std_srvs/Empty has no field for the reason
            reply(response)

        self._ros.ask(SetOdometry(controller=self._controller, x=0.0, y=0.0, heading=0.0), fill)


def send_twist(ros: NodeContext, controller: ControllerReading, topic: str, message: Twist | TwistStamped) -> None:
    """Send a twist received on `topic` to a base controller.

    Drop the twist with a warning if it is not finite or the controller is not active. A base is commanded on several
    topics, so their publishers are watched together.
    """
    twist, stamp = message, None
    if isinstance(message, TwistStamped):
        sent_at = message.header.stamp
        twist, stamp = message.twist, ros.unix(seconds_of(sent_at.sec, sent_at.nanosec))
    name, lateral = controller.name, twist.linear.y if controller.drives_sideways else 0.0
    fields = {"linear.x": twist.linear.x, "linear.y": lateral, "angular.z": twist.angular.z}
    key = f"{name}/{controller.topic}"
    if not controller.active:
        ros.warn(key, f"{name} is {controller.state}; activate it before commanding it")
    elif not all(map(math.isfinite, fields.values())):
        text = ", ".join(f"{axis} {value:g}" for axis, value in fields.items() if axis != "linear.y" or lateral)
        ros.warn(key, f"{name}: a twist is not finite: {text}; it was dropped")
    else:
        ros.watch_publishers(name, topic, tuple(fields.values()))
        linear, angular = fields["linear.x"], fields["angular.z"]
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


# Shared `cmd_vel` topic to which teleop and Nav2 publish, as Twist or TwistStamped.
#
# Its messages are sent to the only active base controller. If several are active, the intended one is unknown, and the
# command is refused.


class SharedTwist(Endpoint):
    """Subscription of the shared `cmd_vel` topic of one robot; `kind` is "Twist", "TwistStamped" or "auto"."""

    def __init__(self, ros: NodeContext, topic: str, kind: str) -> None:
        super().__init__(ros)
        self._topic = topic
        self._subscription = TwistSubscription(ros, topic, self._on_message, kind)

    def on_state(self, state: StateSample) -> None:
        self._subscription.check_types(state)

    def close(self) -> None:
        self._subscription.close()

    def _on_message(self, message: Twist | TwistStamped) -> None:
        bases = [controller for controller in self._ros.controllers.values() if controller.is_base]
        active = [base for base in bases if base.active] or bases
        if len(active) == 1:
            send_twist(self._ros, active[0], self._topic, message)
            return
        names = ", ".join(base.name for base in active)
        several = f"several base controllers ({names}); publish to the twist topic of one of them"
        self.report(self._topic, several if names else "no base controller is loaded")


# Topics of steering and mecanum controllers in addition to odometry: `~/tf_odometry` and `~/controller_state`.
#
# Rules (ros2_controllers, Jazzy): wheels are in the order that the message defines; measured positions or
# velocities of the traction wheels are published. Unknown values are nan.


class TfOdometry(Endpoint):
    """Publisher of the odometry transform on `~/tf_odometry` while the controller's `enable_odom_tf` is true."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._name, self._samples = controller.name, NewSamples(OdometrySample)
        self._kind: Any = interface("tf2_msgs/msg/TFMessage")
        self._publisher = self.publisher(self._kind, f"{self._name}/tf_odometry", SYSTEM_DEFAULT)

    def on_state(self, state: StateSample) -> None:
        sample = self._samples.of(state).get(self._name)
        if sample is not None and sample.enable_odom_tf:
            self._publisher.publish(self._kind(transforms=[odometry_transform(self._ros, sample)]))


class Frames(Endpoint):
    """Publisher of the transforms of one robot; `urdf` is the URDF text."""

    def __init__(self, ros: NodeContext, urdf: str) -> None:
        super().__init__(ros)
        self._tf_message = interface("tf2_msgs/msg/TFMessage")
        joints = read_model(urdf).joints.values()
        self._moving = [joint for joint in joints if not joint.fixed]
        self._fixed = [joint for joint in joints if joint.fixed]
        self._based: frozenset[str] = frozenset()  # frames whose transform comes from odometry or a pose sample
        self._joint_states = NewSamples(JointStatesSample)
        self._odometry, self._poses = NewSamples(OdometrySample), NewSamples(PoseSample)
        self._publisher = self.publisher(self._tf_message, "/tf", TF)
        self._static = self.publisher(self._tf_message, "/tf_static", TF_STATIC)
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
