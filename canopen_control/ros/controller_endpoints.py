"""Topics, services and actions of a controller, selected by its command topic, samples and offers.

A new kind of command needs an entry here and an `Endpoint`; a new kind of sample needs a row in `sample_topics`.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final, get_args

from canopen_control.ros.action_goals import HEARTBEAT_S, ActionGoals
from canopen_control.ros.base_topics import (
    OdometryReset,
    OdometrySetting,
    TfOdometry,
    TwistCommands,
)
from canopen_control.ros.command_topics import (
    FeedForwardSwitch,
    ForwardCommands,
    GpioCommands,
    PidMeasuredStates,
    PidReferences,
    SpeedScalingTopic,
    TrajectoryQuery,
    TrajectoryTopic,
    goal_refusal,
    pieces_of,
    seconds,
    stamp_of,
    tolerances_of,
)
from canopen_control.ros.conversions import unknown_as_nan
from canopen_control.ros.drive_topics import DeviceNode, ProxyNode
from canopen_control.ros.endpoint import COMMANDER, Endpoint
from canopen_control.ros.interfaces import MissingInterface, interface
from canopen_control.ros.sample_publisher import RosMessages, SamplePublisher, time_message
from canopen_control.ros.sample_topics import SAMPLE_TOPICS, TRAJECTORY_FEEDBACK, fill
from canopen_control.rpc.messages.gripper import CancelGripper, GripperEnd, GripperResult, GripperVerdict, SendGripper
from canopen_control.rpc.messages.samples import (
    ControllerSample,
    GripperSample,
    JointStatesSample,
    Sample,
    TrajectorySample,
    kind_of,
)
from canopen_control.rpc.messages.state import (
    DRIVE_SERVICES,
    GRIPPER_GOALS,
    NODE_SERVICES,
    ODOMETRY_RESET,
    PARALLEL_GRIPPER_GOALS,
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
    from canopen_control.ros.endpoint import NodeContext, RosMessage
    from canopen_control.rpc.messages.declare import Done, Request
    from canopen_control.rpc.messages.samples import TrajectoryPoint
    from canopen_control.rpc.messages.state import ControllerReading

    Factory = Callable[[NodeContext, ControllerReading], Endpoint]


# ROS actions: FollowJointTrajectory, GripperCommand and ParallelGripperCommand.


# `~/follow_joint_trajectory`: the action by which MoveIt and others have a joint trajectory controller follow a path.
#
# Rules (joint_trajectory_controller, Jazzy): a newer goal replaces the running one, feedback is sent at the
# controller's `action_monitor_rate`; `action_goals` describes when and how a goal ends. Difference from upstream: a
# goal outlives the client that sent it only if the controller's `continue_without_client` is true; a request for the
# result of a refused goal is answered with the rule that the goal breaks.


_INVALID_GOAL: Final = -1


class FollowJointTrajectory(ActionGoals[TrajectoryVerdict, TrajectoryResult, TrajectorySample]):
    """FollowJointTrajectory action server of one trajectory controller."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        self._action: Any = interface("control_msgs/action/FollowJointTrajectory")
        super().__init__(ros, controller, self._action, "follow_joint_trajectory", TrajectorySample)

    def send(
        self,
        sender: TrajectorySender,
        goal: RosMessage,
        answer: Callable[[TrajectoryVerdict | None, str | None], object],
    ) -> None:
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
        """Return the result of a refused goal; the code is INVALID_GOAL if the robot has not replied."""
        code = _INVALID_GOAL if verdict is None else verdict.error_code
        return self._action.Result(error_code=code, error_string=text)

    def asks_for_end(self) -> Request[TrajectoryResult]:
        return TrajectoryEnd()

    def cancels(self, why: str | None) -> Request[Done]:
        return CancelTrajectory(controller=self._controller, own=True, why=why)

    def failed(self, text: str) -> TrajectoryResult:
        return TrajectoryResult(state="aborted", error_code=_INVALID_GOAL, text=text)

    def client_result(self, result: TrajectoryResult, *, by_others: bool) -> RosMessage:
        """Return the result for the client; the code is INVALID_GOAL if another client cancelled the goal."""
        code = _INVALID_GOAL if by_others else result.error_code
        return self._action.Result(error_code=code, error_string=result.text)

    def feedback(self, sample: TrajectorySample) -> RosMessage:
        feedback = self._action.Feedback()
        fill(RosMessages(self._ros), feedback, TRAJECTORY_FEEDBACK, sample)
        return feedback


# `~/gripper_cmd` of the gripper action controllers: a position with a maximum effort, and whether it was reached.
#
# Rules (gripper_controllers and parallel_gripper_controller, Jazzy): the action is a GripperCommand, or a
# ParallelGripperCommand whose `command` is a JointState with one position and optionally one velocity and one effort.
# `action_goals` describes when and how a goal ends. Own rules: feedback is sent at `action_monitor_rate` (upstream has
# none); an effort of 0 means the effort in the parameters.


class GripperAction(ActionGoals[GripperVerdict, GripperResult, GripperSample]):
    """GripperCommand action server of one gripper controller."""

    name: ClassVar[str] = "control_msgs/action/GripperCommand"

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        self._action: Any = interface(self.name)
        self._joint = next(iter(controller.joints), "")
        super().__init__(ros, controller, self._action, "gripper_cmd", GripperSample)

    def on_controller(self, controller: ControllerReading) -> None:
        self._joint = next(iter(controller.joints), "")

    def request(self, goal: RosMessage) -> SendGripper:
        """Return the request for a goal; raise ValueError with the reason if it is invalid."""
        command = goal.command
        return self._request_for(command.position, command.max_effort)

    def result(self, sample: GripperResult | GripperSample, into: RosMessage) -> RosMessage:
        """Fill a result or feedback message with the gripper's state and return it; unknown values are nan."""
        into.position, into.effort = unknown_as_nan(sample.position), unknown_as_nan(sample.effort)
        into.stalled, into.reached_goal = sample.stalled, sample.reached_goal
        return into

    def feedback(self, sample: GripperSample) -> RosMessage:
        return self.result(sample, self._action.Feedback())

    def send(
        self,
        sender: TrajectorySender,
        goal: RosMessage,
        answer: Callable[[GripperVerdict | None, str | None], object],
    ) -> None:
        sender.client.ask(self.request(goal), answer)

    def refused(self, verdict: GripperVerdict | None, text: str) -> RosMessage:
        """Return a result with unknown values; it has no field for the reason, which is logged instead."""
        del verdict, text
        return self.result(self.failed(""), self._action.Result())

    def asks_for_end(self) -> Request[GripperResult]:
        return GripperEnd()

    def cancels(self, why: str | None) -> Request[Done]:
        return CancelGripper(controller=self._controller, own=True, why=why)

    def failed(self, text: str) -> GripperResult:
        return GripperResult(state="aborted", text=text)

    def client_result(self, result: GripperResult, *, by_others: bool) -> RosMessage:
        """Return the result for the client; it has no field for the reason of a failure, which is logged."""
        del by_others
        if result.state != "succeeded":
            self.report(self._topic, result.text)
        return self.result(result, self._action.Result())

    def _request_for(self, position: float, effort: float, velocity: float = 0.0) -> SendGripper:
        for field, value in (("position", position), ("max_effort", effort), ("max_velocity", velocity)):
            if value - value != 0.0:  # nan, infinite
                raise ValueError(f"{field} is {value}; give finite numbers")
        return SendGripper(
            controller=self._controller,
            position=position,
            max_effort=effort or None,
            max_velocity=velocity or None,
            source=COMMANDER,
            heartbeat=HEARTBEAT_S,
        )


class ParallelGripperAction(GripperAction):
    """ParallelGripperCommand action server of one gripper controller."""

    name: ClassVar[str] = "control_msgs/action/ParallelGripperCommand"

    def request(self, goal: RosMessage) -> SendGripper:
        command = goal.command
        if len(command.position) != 1:
            raise ValueError(f"the goal has {len(command.position)} positions; give one")
        effort, velocity = (next(iter(numbers), 0.0) for numbers in (command.effort, command.velocity))
        return self._request_for(float(command.position[0]), float(effort), float(velocity))

    def result(self, sample: GripperResult | GripperSample, into: RosMessage) -> RosMessage:
        self._put(sample, into.state)
        into.stalled, into.reached_goal = sample.stalled, sample.reached_goal
        return into

    def feedback(self, sample: GripperSample) -> RosMessage:
        into = self._action.Feedback()
        self._put(sample, into.state)
        into.state.header.stamp = time_message(sample.time)
        into.state.velocity = [unknown_as_nan(sample.velocity)]
        return into

    def _put(self, sample: GripperResult | GripperSample, state: RosMessage) -> None:
        state.name = [self._joint]
        state.position, state.effort = [unknown_as_nan(sample.position)], [unknown_as_nan(sample.effort)]


#: endpoints by the command topic of the controller (`topic` of the API)
BY_TOPIC: Final[dict[str | None, tuple[Factory, ...]]] = {
    "commands": (ForwardCommands,),
    "reference": (PidReferences,),
    "gpio_commands": (GpioCommands,),
}
#: endpoints of every base controller; the name of its twist topic is a parameter
OF_BASES: Final[tuple[Factory, ...]] = (TwistCommands, OdometrySetting)
#: endpoints by the kind of the controller's samples (`tells` of the API), in addition to the topics of the samples
BY_SAMPLE: Final[dict[str | None, tuple[Factory, ...]]] = {
    "steering": (TfOdometry,),
    "mecanum": (TfOdometry,),
    "trajectory": (FollowJointTrajectory, TrajectoryTopic, TrajectoryQuery, SpeedScalingTopic),
    "pid": (PidMeasuredStates, FeedForwardSwitch),
}
#: endpoints by the services and actions that the controller offers in addition to commands (`offers` of the API)
BY_OFFER: Final[dict[str, Factory]] = {
    GRIPPER_GOALS: GripperAction,
    PARALLEL_GRIPPER_GOALS: ParallelGripperAction,
    ODOMETRY_RESET: OdometryReset,
    NODE_SERVICES: ProxyNode,
    DRIVE_SERVICES: DeviceNode,
}


_KINDS: Final = {kind_of(kind): kind for kind in get_args(ControllerSample)}


def endpoints_for(ros: NodeContext, controller: ControllerReading) -> list[Endpoint]:
    """Create the topics, services and actions of one controller."""
    kind = _KINDS.get(controller.tells or "", Sample)
    kinds = (*kind.__mro__, JointStatesSample)  # its topics are named by the controller
    rows = [row for row in SAMPLE_TOPICS if row.bridge and row.kind in kinds and row.name(controller)]
    commands = OF_BASES if controller.is_base else BY_TOPIC.get(controller.topic, ())
    declared = (*commands, *BY_SAMPLE.get(controller.tells, ()))
    offers = [BY_OFFER[offer] for offer in controller.offers if offer in BY_OFFER]
    factories: list[Factory] = [*declared, *offers, *(partial(SamplePublisher, row=row) for row in rows)]
    return [endpoint for make in factories for endpoint in _create(make, ros, controller)]


def _create(make: Factory, ros: NodeContext, controller: ControllerReading) -> Iterator[Endpoint]:
    """Create and yield an endpoint; if this ROS installation lacks the interface, report it and yield nothing."""
    try:
        yield make(ros, controller)
    except MissingInterface as error:
        ros.leave_out(error.name)
