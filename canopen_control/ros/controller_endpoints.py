"""Which topics a controller has: by the kind of its commands and of its samples, by what it publishes, by its type.

A new kind of command or sample gets a line here and an `Endpoint` in a file of its own.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final

from canopen_control.ros.action_goals import HEARTBEAT_S, ActionGoals
from canopen_control.ros.base_topics import (
    BaseOdometry,
    MecanumState,
    OdometrySetting,
    SteeringState,
    TfOdometry,
    TwistCommands,
)
from canopen_control.ros.command_topics import (
    FeedForwardSwitch,
    ForwardCommands,
    GpioCommands,
    PidMeasuredStates,
    PidReferences,
    PidState,
)
from canopen_control.ros.controller_state import ControllerStateTopic
from canopen_control.ros.conversions import SENSOR_MESSAGES, SensorMessage, put_sample, unknown_as_nan
from canopen_control.ros.drive_topics import DeviceNode, ProxyNode
from canopen_control.ros.endpoint import COMMANDER, Endpoint, NewSamples
from canopen_control.ros.interfaces import MissingInterface, interface
from canopen_control.ros.joint_states import JointStates, time_message
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.ros.trajectory_topics import (
    SpeedScalingTopic,
    TrajectoryQuery,
    TrajectoryState,
    TrajectoryTopic,
    fill_point,
    goal_refusal,
    pieces_of,
    seconds,
    stamp_of,
    tolerances_of,
)
from canopen_control.rpc.messages.gripper import CancelGripper, GripperEnd, GripperResult, GripperVerdict, SendGripper
from canopen_control.rpc.messages.samples import (
    BatteriesSample,
    GpioSample,
    GripperSample,
    JointStatesSample,
    Sample,
    TrajectorySample,
    kind_of,
)
from canopen_control.rpc.messages.trajectory import (
    CancelTrajectory,
    SendTrajectory,
    TrajectoryEnd,
    TrajectoryResult,
    TrajectoryVerdict,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.ros.action_goals import TrajectorySender
    from canopen_control.ros.endpoint import Ros, RosMessage
    from canopen_control.rpc.messages.declare import Done, Request
    from canopen_control.rpc.messages.samples import BatteryReading, TrajectoryPoint, Values
    from canopen_control.rpc.messages.state import ControllerReading, StateSample

    Factory = Callable[[Ros, ControllerReading], Endpoint]


# Actions of ROS: FollowJointTrajectory, GripperCommand and ParallelGripperCommand.


# `~/follow_joint_trajectory`: the action by which MoveIt and others have a joint trajectory controller follow a path.
#
# Rules (joint_trajectory_controller, Jazzy): a newer goal takes the place of the one that runs, feedback
# is sent at the controller's `action_monitor_rate`; what a goal lives by, and how it ends, is in `action_goals`. Ours:
# it outlives the client that sent it only where the controller's `continue_without_client` is true; who asks for the
# result of a refused goal is told which rule it breaks.


_INVALID_GOAL: Final = -1


class FollowJointTrajectory(ActionGoals[TrajectoryVerdict, TrajectoryResult, TrajectorySample]):
    """The action server of one controller."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._action: Any = interface("control_msgs/action/FollowJointTrajectory")
        super().__init__(ros, controller, self._action, "follow_joint_trajectory", TrajectorySample)

    def send(
        self,
        sender: TrajectorySender,
        goal: RosMessage,
        answer: Callable[[TrajectoryVerdict | None, str | None], object],
    ) -> None:
        """Send a trajectory, in as many pieces as it needs."""
        refusal = goal_refusal(goal)
        if refusal is not None:
            raise ValueError(refusal)
        sender.send(pieces_of(goal.trajectory), partial(self._request, goal), answer)

    def _request(self, goal: RosMessage, points: list[TrajectoryPoint]) -> SendTrajectory:
        return SendTrajectory(
            controller=self._controller,
            joints=list(goal.trajectory.joint_names),
            points=points,
            stamp=self._ros.unix(stamp_of(goal.trajectory)),
            path_tolerance=tolerances_of(goal.path_tolerance),
            goal_tolerance=tolerances_of(goal.goal_tolerance),
            goal_time_tolerance=seconds(goal.goal_time_tolerance),
            source=COMMANDER,
            heartbeat=HEARTBEAT_S,
        )

    def refused(self, verdict: TrajectoryVerdict | None, text: str) -> RosMessage:
        """Return the result, with the code of what it breaks."""
        code = _INVALID_GOAL if verdict is None else verdict.error_code
        return self._action.Result(error_code=code, error_string=text)

    def asks_for_end(self) -> Request[TrajectoryResult]:
        """Return `trajectory_end`."""
        return TrajectoryEnd()

    def cancels(self, why: str | None) -> Request[Done]:
        """Return `cancel_trajectory`."""
        return CancelTrajectory(controller=self._controller, own=True, why=why)

    def failed(self, text: str) -> TrajectoryResult:
        """Return an end without the robot's word."""
        return TrajectoryResult(state="aborted", error_code=_INVALID_GOAL, text=text)

    def told(self, result: TrajectoryResult, *, by_others: bool) -> RosMessage:
        """Return the result for the client."""
        code = _INVALID_GOAL if by_others else result.error_code
        return self._action.Result(error_code=code, error_string=result.text)

    def feedback(self, sample: TrajectorySample) -> RosMessage:
        """Return where the joints are to be, and where they are."""
        feedback = self._action.Feedback(joint_names=list(sample.joints))
        feedback.header.stamp = time_message(sample.time)
        fill_point(feedback.desired, sample.reference)
        fill_point(feedback.actual, sample.feedback)
        fill_point(feedback.error, sample.error)
        return feedback


# `~/gripper_cmd` of the gripper action controllers: a position with the most effort, and whether it was reached.
#
# Rules (gripper_controllers and parallel_gripper_controller, Jazzy): the action is a GripperCommand, or a
# ParallelGripperCommand whose `command` is a JointState with one position and, where they are given, one velocity and
# one effort. What a goal lives by, and how it ends, is in `action_goals`. Ours: feedback is sent at
# `action_monitor_rate` (upstream sends none), and an effort of 0 is that of the parameters.


class GripperAction(ActionGoals[GripperVerdict, GripperResult, GripperSample]):
    """The action server of one controller, with GripperCommand."""

    name: ClassVar[str] = "control_msgs/action/GripperCommand"

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._action: Any = interface(self.name)
        self._joint = next(iter(controller.joints), "")
        super().__init__(ros, controller, self._action, "gripper_cmd", GripperSample)

    def on_controller(self, controller: ControllerReading) -> None:
        """Know its joint."""
        self._joint = next(iter(controller.joints), "")

    def request(self, goal: RosMessage) -> SendGripper:
        """Return what a goal is to the robot; ValueError with why it is none."""
        command = goal.command
        return self._wanted(command.position, command.max_effort)

    def result(self, told: GripperResult | GripperSample, into: RosMessage) -> RosMessage:
        """Fill a result or a feedback with where the gripper is."""
        into.position, into.effort = unknown_as_nan(told.position), unknown_as_nan(told.effort)
        into.stalled, into.reached_goal = told.stalled, told.reached_goal
        return into

    def feedback(self, sample: GripperSample) -> RosMessage:
        """Return the feedback of a sample."""
        return self.result(sample, self._action.Feedback())

    def send(
        self,
        sender: TrajectorySender,
        goal: RosMessage,
        answer: Callable[[GripperVerdict | None, str | None], object],
    ) -> None:
        """Send a goal on its own connection."""
        sender.client.ask(self.request(goal), answer)

    def refused(self, verdict: GripperVerdict | None, text: str) -> RosMessage:
        """Return an empty result: there is no room for the reason, which is logged."""
        del verdict, text
        return self.result(self.failed(""), self._action.Result())

    def asks_for_end(self) -> Request[GripperResult]:
        """Return `gripper_end`."""
        return GripperEnd()

    def cancels(self, why: str | None) -> Request[Done]:
        """Return `cancel_gripper`."""
        return CancelGripper(controller=self._controller, own=True, why=why)

    def failed(self, text: str) -> GripperResult:
        """Return an end without the robot's word."""
        return GripperResult(state="aborted", text=text)

    def told(self, result: GripperResult, *, by_others: bool) -> RosMessage:
        """Return the result for the client, and log why, where it did not succeed: it has no room for words."""
        del by_others
        if result.state != "succeeded":
            self._ros.warn(self._topic, f"{self._topic}: {result.text}")
        return self.result(result, self._action.Result())

    def _wanted(self, position: float, effort: float, velocity: float = 0.0) -> SendGripper:
        for what, value in (("position", position), ("max_effort", effort), ("max_velocity", velocity)):
            if value - value != 0.0:  # nan, infinite
                raise ValueError(f"its {what} is {value}; give finite numbers")
        return SendGripper(
            controller=self._controller,
            position=position,
            max_effort=effort or None,
            max_velocity=velocity or None,
            source=COMMANDER,
            heartbeat=HEARTBEAT_S,
        )


class ParallelGripperAction(GripperAction):
    """The action server of one controller, with ParallelGripperCommand."""

    name: ClassVar[str] = "control_msgs/action/ParallelGripperCommand"

    def request(self, goal: RosMessage) -> SendGripper:
        """Return what a goal is to the robot; ValueError with why it is none."""
        command = goal.command
        if len(command.position) != 1:
            raise ValueError(f"it has {len(command.position)} positions; give one")
        effort, velocity = (next(iter(each), 0.0) for each in (command.effort, command.velocity))
        return self._wanted(float(command.position[0]), float(effort), float(velocity))

    def result(self, told: GripperResult | GripperSample, into: RosMessage) -> RosMessage:
        """Fill a result with where the gripper is."""
        self._put(told, into.state)
        into.stalled, into.reached_goal = told.stalled, told.reached_goal
        return into

    def feedback(self, sample: GripperSample) -> RosMessage:
        """Return the feedback of a sample: its state alone."""
        into = self._action.Feedback()
        self._put(sample, into.state)
        into.state.header.stamp = time_message(sample.time)
        into.state.velocity = [unknown_as_nan(sample.velocity)]
        return into

    def _put(self, told: GripperResult | GripperSample, state: RosMessage) -> None:
        state.name = [self._joint]
        state.position, state.effort = [unknown_as_nan(told.position)], [unknown_as_nan(told.effort)]


# Topics of the broadcasters: sensors, batteries, GPIO and interface values.


# `~/imu`, `~/range`, `~/wrench` and `~/pose` of the broadcasters of sensors.
#
# Rules (ros2_controllers, Jazzy): names, types and quality are upstream's; a message for each update of
# the broadcaster that the state stream carries; what is not known is nan.


class SensorTopic(ControllerStateTopic[Sample]):
    """The publisher of the messages of a `row`; the transform of a pose is on `/tf`, see `frames`."""

    def __init__(self, ros: Ros, controller: ControllerReading, row: SensorMessage) -> None:
        self._row = row
        super().__init__(ros, controller, row.kind, row.message, row.topic)

    def fill(self, message: RosMessage, sample: Sample) -> None:
        """Put the measurement into the message."""
        message.header.frame_id = self._ros.frame(getattr(sample, "frame_id", ""))
        put_sample(message, self._row, sample)


# `~/battery_state` and `~/raw_battery_states` of the battery state broadcaster.
#
# Rules (battery_state_broadcaster): the first is all batteries as one, a BatteryState, the second each by
# itself, a BatteryStateArray whose headers name the battery as their frame. What is not known is nan. A message is made
# only where somebody listens.


_MEASURED = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity", "percentage")
_TOLD = ("power_supply_status", "power_supply_health", "power_supply_technology", "present", "location",
         "serial_number")  # fmt: skip


class BatteryTopics(Endpoint):
    """The publishers of one broadcaster."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._name, self._samples = ros, controller.name, NewSamples(BatteriesSample)
        self._one: Any = interface("sensor_msgs/msg/BatteryState")
        make = ros.node.create_publisher
        self._together = make(self._one, f"{self._name}/battery_state", SYSTEM_DEFAULT)
        self._each: Any = None
        try:
            self._array: Any = interface("control_msgs/msg/BatteryStateArray")
        except MissingInterface as error:
            ros.leave_out(error.name)
        else:
            self._each = make(self._array, f"{self._name}/raw_battery_states", SYSTEM_DEFAULT)

    def on_state(self, state: StateSample) -> None:
        """Publish what is new."""
        sample = self._samples.of(state).get(self._name)
        if sample is None:
            return
        if self._together.get_subscription_count():
            self._together.publish(self._message(sample.together, sample.time))
        if self._each is not None and self._each.get_subscription_count():
            self._each.publish(
                self._array(battery_states=[self._message(each, sample.time) for each in sample.batteries])
            )

    def close(self) -> None:
        """Leave the topics."""
        for publisher in filter(None, (self._together, self._each)):
            self._ros.node.destroy_publisher(publisher)

    def _message(self, battery: BatteryReading, time: float) -> RosMessage:
        message = self._one()
        message.header.stamp, message.header.frame_id = time_message(time), battery.name
        for field in _MEASURED:
            setattr(message, field, unknown_as_nan(getattr(battery, field)))
        for field in _TOLD:
            setattr(message, field, getattr(battery, field))
        return message


# `~/gpio_states` of GPIO controllers and broadcasters: inputs and outputs of drives and <gpio> parts, by their names.
#
# Rules (gpio_controllers, Jazzy): a control_msgs/DynamicInterfaceGroupValues, published once per update;
# what is not known is nan. Bits are numbers, as 0x60FD and 0x60FE hold them.


class GpioStates(Endpoint):
    """The publisher of one controller."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._name, self._samples = ros, controller.name, NewSamples(GpioSample)
        self._message = interface("control_msgs/msg/DynamicInterfaceGroupValues")
        self._values = interface("control_msgs/msg/InterfaceValue")
        self._publisher = ros.node.create_publisher(self._message, f"{self._name}/gpio_states", SYSTEM_DEFAULT)

    def on_state(self, state: StateSample) -> None:
        """Publish what is new."""
        sample = self._samples.of(state).get(self._name)
        if sample is None:
            return
        parts = sample.parts
        values = [self._of(each) for each in parts.values()]
        message = self._message(interface_groups=list(parts), interface_values=values)
        message.header.stamp = time_message(sample.time)
        self._publisher.publish(message)

    def close(self) -> None:
        """Leave the topic."""
        self._ros.node.destroy_publisher(self._publisher)

    def _of(self, values: dict[str, float | None]) -> Any:  # noqa: ANN401 - a class made by somebody's generator
        known = [math.nan if value is None else value for value in values.values()]
        return self._values(interface_names=list(values), values=known)


# `/dynamic_joint_states` of the joint state broadcaster: every state interface that it reads, by joint and name.
#
# Rules (joint_state_broadcaster, Jazzy): published with `/joint_states`, on the topic that the
# broadcaster tells, with the same stamp and frame; what is not known is nan. Where it is told not to, there is no
# topic.


class DynamicJointStates(Endpoint):
    """The publisher of one broadcaster."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._controller, self._samples = ros, controller, NewSamples(JointStatesSample)
        self._message = interface("control_msgs/msg/DynamicJointState")
        self._values = interface("control_msgs/msg/InterfaceValue")
        topic = controller.published("dynamic_joint_states")
        self._publisher = ros.node.create_publisher(self._message, topic, SYSTEM_DEFAULT)

    def on_controller(self, controller: ControllerReading) -> None:
        """Follow its frame."""
        self._controller = controller

    def on_state(self, state: StateSample) -> None:
        """Publish what is new; nothing is made where nobody listens."""
        sample = self._samples.of(state).get(self._controller.name)
        if sample is None or not self._publisher.get_subscription_count():
            return
        joints = sample.joints
        message = self._message(joint_names=list(joints), interface_values=[self._of(each) for each in joints.values()])
        message.header.stamp = time_message(sample.time)
        message.header.frame_id = self._ros.frame(self._controller.frame_id)
        self._publisher.publish(message)

    def close(self) -> None:
        """Leave the topic."""
        self._ros.node.destroy_publisher(self._publisher)

    def _of(self, joint: Values) -> Any:  # noqa: ANN401 - a class made by somebody's generator
        values = [math.nan if value is None else value for value in joint.values()]
        return self._values(interface_names=list(joint), values=values)


#: by where its commands come (`topic` of the API)
BY_TOPIC: Final[dict[str | None, tuple[Factory, ...]]] = {
    "commands": (ForwardCommands,),
    "reference": (PidReferences,),
    "gpio_commands": (GpioCommands,),
}
#: of a base, wherever its twists come
OF_BASES: Final[tuple[Factory, ...]] = (TwistCommands, OdometrySetting)
#: by the last word of each topic that it tells (`publishes` of the API)
BY_PUBLISHED: Final[dict[str, Factory]] = {
    "joint_states": JointStates,
    "dynamic_joint_states": DynamicJointStates,
}
#: by the kind of its samples (`tells` of the API)
BY_SAMPLE: Final[dict[str | None, tuple[Factory, ...]]] = {
    "odometry": (BaseOdometry,),
    "steering": (BaseOdometry, TfOdometry, SteeringState),
    "mecanum": (BaseOdometry, TfOdometry, MecanumState),
    "gpio": (GpioStates,),
    "trajectory": (FollowJointTrajectory, TrajectoryTopic, TrajectoryState, TrajectoryQuery, SpeedScalingTopic),
    "pid": (PidState, PidMeasuredStates, FeedForwardSwitch),
    **{kind_of(row.kind): (partial(SensorTopic, row=row),) for row in SENSOR_MESSAGES},
    "batteries": (BatteryTopics,),
}
#: by its type: which action, or whose node
BY_TYPE: Final[dict[str, tuple[Factory, ...]]] = {
    "position_controllers/GripperActionController": (GripperAction,),
    "effort_controllers/GripperActionController": (GripperAction,),
    "parallel_gripper_action_controller/GripperActionController": (ParallelGripperAction,),
    "canopen_ros2_controllers/CanopenProxyController": (ProxyNode,),
    "canopen_ros2_controllers/Cia402DeviceController": (DeviceNode,),
}


def endpoints_for(ros: Ros, controller: ControllerReading) -> list[Endpoint]:
    """Make the topics of one controller."""
    published = [make for kind, make in BY_PUBLISHED.items() if controller.published(kind) is not None]
    commands = OF_BASES if controller.is_base else BY_TOPIC.get(controller.topic, ())
    own = (*commands, *BY_SAMPLE.get(controller.tells, ()))
    factories = (*own, *published, *BY_TYPE.get(controller.type, ()))
    return [endpoint for make in factories for endpoint in _made(make, ros, controller)]


def _made(make: Factory, ros: Ros, controller: ControllerReading) -> Iterator[Endpoint]:
    """Yield an endpoint, none where this ROS does not have its interface: the controller's others are there."""
    try:
        yield make(ros, controller)
    except MissingInterface as error:
        ros.leave_out(error.name)
