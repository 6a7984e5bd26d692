"""Command topics and services of forward command, GPIO, PID and trajectory controllers."""

from __future__ import annotations

import math
import threading
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, Final

from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from canopen_control.ros.action_goals import HEARTBEAT_S, TrajectorySender
from canopen_control.ros.conversions import command_refusal, seconds_of
from canopen_control.ros.endpoint import COMMANDER, Endpoint, success_of, without_numbers
from canopen_control.ros.interfaces import interface
from canopen_control.ros.rcl import KEPT_DEFAULT, REFERENCE, SYSTEM_DEFAULT
from canopen_control.rpc.messages.robot import CommandByName, CommandController, SetFeedForward, SetMeasuredStates
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.rpc.messages.trajectory import (
    MAX_POINTS,
    QueryTrajectory,
    ScaleTrajectory,
    SetTrajectory,
    TrajectoryTolerance,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.ros.endpoint import NodeContext, Reply, RosMessage
    from canopen_control.rpc.messages.state import ControllerReading
    from canopen_control.rpc.messages.trajectory import TrajectoryAt


# `/<controller>/commands` of the forward controllers: Float64MultiArray, one number per joint.
#
# Rules (forward_command_controller, Jazzy): only `data` is used, in the order of the joints. A message with a value
# that is not finite, or with a wrong number of values, is dropped, as the runtime would refuse such a command.


class ForwardCommands(Endpoint):
    """Subscription of `~/commands` of one forward command controller."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller = controller
        self.subscribe(Float64MultiArray, f"{controller.name}/commands", self._on_message, SYSTEM_DEFAULT)

    def on_controller(self, controller: ControllerReading) -> None:
        self._controller = controller

    def _on_message(self, message: Float64MultiArray) -> None:
        values, topic = list(message.data), f"{self._controller.name}/commands"
        refusal = command_refusal(values, self._controller)
        if refusal is not None:
            self._ros.warn(topic, refusal)
            return
        self._ros.watch_publishers(topic, topic, values)
        self._ros.command(
            CommandController(controller=self._controller.name, values=values, source=COMMANDER, dead_man=True)
        )


# `~/commands` of a GPIO command controller: outputs of <gpio> parts by their names (DynamicInterfaceGroupValues).
#
# Rules (gpio_controllers, Jazzy): a message sets the outputs that it names; the others keep their values. Own rules: an
# invalid message (an unknown or repeated name, different numbers of names and values, a value that is not finite) is
# dropped as a whole with a warning, and the controller continues. Messages that arrive before the robot has answered
# are merged, with the newest value of each output, so that no queue grows and no output is lost. The commands of the
# outputs end with this bridge.


class GpioCommands(Endpoint):
    """Subscription of `~/commands` of one GPIO command controller."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller, self._topic = controller, f"{controller.name}/commands"
        self._lock = threading.Lock()
        self._pending: dict[str, float] = {}
        self._is_waiting = False
        message: Any = interface("control_msgs/msg/DynamicInterfaceGroupValues")
        self.subscribe(message, self._topic, self._on_message, SYSTEM_DEFAULT)

    def on_controller(self, controller: ControllerReading) -> None:
        self._controller = controller
        if not controller.active:
            with self._lock:
                self._pending.clear()

    def _on_message(self, message: RosMessage) -> None:
        try:
            values = outputs_of(message, self._controller)
        except ValueError as error:
            self.report(self._topic, f"{error}; the message was dropped")
            return
        with self._lock:
            wake = not self._pending and bool(values)
            self._pending.update(values)
        if wake:
            self._ros.hand_over(self._send)

    def _send(self) -> None:
        """Send the merged values to the robot, unless the previous request has not been answered yet."""
        if self._is_waiting:
            return
        with self._lock:
            values, self._pending = self._pending, {}
        if values:
            self._is_waiting = True
            request = CommandByName(controller=self._controller.name, values=values, source=COMMANDER, dead_man=True)
            self._ros.ask(request, self._on_answer)

    def _on_answer(self, _done: object, error: str | None) -> None:
        self._is_waiting = False
        self.report(self._topic, error)
        self._send()


def outputs_of(message: RosMessage, controller: ControllerReading) -> dict[str, float]:
    """Return the values in a message by "gpio/interface".

    Raise ValueError with the reason if the message is invalid or the controller is not active.
    """
    if not controller.active:
        raise ValueError(f"{controller.name} is {controller.state}; activate it before commanding it")
    groups, inner = list(message.interface_groups), list(message.interface_values)
    if len(groups) != len(inner):
        raise ValueError(f"{len(groups)} interface_groups with {len(inner)} interface_values; give equal numbers")
    output_names, outputs = controller.required_command_interfaces, dict[str, float]()
    for group, group_values in zip(groups, inner, strict=True):
        names, values = list(group_values.interface_names), list(group_values.values)
        if len(names) != len(values):
            raise ValueError(f"{group}: {len(names)} interface_names with {len(values)} values; give equal numbers")
        for name, value in zip((f"{group}/{name}" for name in names), values, strict=True):
            if name not in output_names:
                raise ValueError(f"{name!r} is not an output; the outputs are: {', '.join(output_names) or 'none'}")
            if name in outputs:
                raise ValueError(f"{name} is named twice")
            if not math.isfinite(value):
                raise ValueError(f"{name} is {value}; give finite numbers")
            outputs[name] = float(value)
    return outputs


# Topics of a PID controller (`~/reference`, `~/measured_state`) and its service `~/set_feedforward_control`.
#
# Rules (pid_controller, Jazzy): a MultiDOFCommand has a reference for each degree of freedom, and its derivative if the
# controller has a second reference interface; the values are in the order of `dof_names`, or of the parameters if there
# are no names. `~/measured_state` exists with `use_external_measured_states`. While another controller commands the
# references, the robot refuses messages. Own rules: an incomplete message, or one with a value that is not finite, is
# dropped, and does not refresh the reference; a reference ends with this bridge.


class PidReferences(Endpoint):
    """Subscription of `~/reference` of a PID controller."""

    topic = "reference"

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._topic = f"{controller.name}/{self.topic}"
        self._subscription: object = None
        self.on_controller(controller)

    def on_controller(self, controller: ControllerReading) -> None:
        self._controller = controller
        if self._subscription is None and self.is_needed(controller):
            message: Any = interface("control_msgs/msg/MultiDOFCommand")
            self._subscription = self.subscribe(message, self._topic, self._on_message, REFERENCE)

    @staticmethod
    def is_needed(controller: ControllerReading) -> bool:
        """Whether the topic exists for a controller; `~/reference` always exists."""
        del controller
        return True

    def _on_message(self, message: RosMessage) -> None:
        try:
            values = self._values_of(message)
        except ValueError as error:
            self.report(self._topic, f"{error}; the message was dropped")
            return
        self._ros.watch_publishers(self._topic, self._topic, values)
        self._hand_over(values)

    def _hand_over(self, values: list[float]) -> None:
        self._ros.command(
            CommandController(controller=self._controller.name, values=values, source=COMMANDER, dead_man=True)
        )

    def _values_of(self, message: RosMessage) -> list[float]:
        """Return the values and derivatives in a message, in the controller's order.

        Raise ValueError with the reason if the message is invalid or the controller is not active.
        """
        controller = self._controller
        if not controller.active:
            raise ValueError(f"{controller.name} is {controller.state}; activate it before commanding it")
        dofs = _dofs_of(controller)
        order = _order(list(message.dof_names) or dofs, dofs)
        values = _sorted("values", message.values, order, dofs)
        # nan in every element means no command, like an empty list
        if all(map(math.isnan, message.values_dot)):
            return values
        if len(controller.reference_interfaces) < 2 * len(dofs):
            text = "values_dot is ignored: reference_and_state_interfaces has one interface; add its derivative"
            self._ros.warn(f"{self._topic} values_dot", f"{self._topic}: {text}")
            return values
        return values + _sorted("values_dot", message.values_dot, order, dofs)


class PidMeasuredStates(PidReferences):
    """Subscription of `~/measured_state` of a PID controller without state interfaces."""

    topic = "measured_state"

    def _hand_over(self, values: list[float]) -> None:
        request = SetMeasuredStates(controller=self._controller.name, values=values)
        self._ros.ask(request, lambda _done, error: self.report(self._topic, error))

    @staticmethod
    def is_needed(controller: ControllerReading) -> bool:
        """Whether the controller is configured to receive measured states as messages."""
        return bool(controller.required_command_interfaces) and not controller.required_state_interfaces


class FeedForwardSwitch(Endpoint):
    """Service `~/set_feedforward_control` of a PID controller."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller = controller.name
        self.serve("std_srvs/srv/SetBool", f"{controller.name}/set_feedforward_control", self._answer)

    def _answer(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        command = SetFeedForward(controller=self._controller, enabled=request.data)
        self._ros.ask(command, success_of(response, reply))


def _dofs_of(controller: ControllerReading) -> list[str]:
    """Return the names of the degrees of freedom in the order of the parameters."""
    firsts = controller.reference_interfaces[: controller.width]
    return [first.removeprefix(f"{controller.name}/").rpartition("/")[0] for first in firsts]


def _order(names: Sequence[str], dofs: Sequence[str]) -> list[int]:
    """Return the index of each degree of freedom in `names`; raise ValueError unless each is named exactly once."""
    if sorted(names) == sorted(dofs):
        return [names.index(dof) for dof in dofs]
    unknown = next((name for name in names if name not in dofs), None)
    if unknown is not None:
        raise ValueError(f"{unknown!r} is not one of {', '.join(dofs)}")
    raise ValueError(f"dof_names is {', '.join(names)}; give each of {', '.join(dofs)} once")


def _sorted(field: str, values: Sequence[float], order: Sequence[int], dofs: Sequence[str]) -> list[float]:
    """Return `values` in the controller's order; `order` has the index of each degree of freedom in `values`.

    Raise ValueError unless every degree of freedom has one finite value.
    """
    if len(values) != len(order):
        raise ValueError(f"{field} has {len(values)} numbers for {', '.join(dofs)}; give {len(order)}")
    ordered = [float(values[index]) for index in order]
    for dof, value in zip(dofs, ordered, strict=True):
        if not math.isfinite(value):
            raise ValueError(f"{field} of {dof} is {value}; give finite numbers")
    return ordered


# Conversion of trajectories from ROS messages to messages of the API.
#
# Rules (trajectory_msgs, control_msgs): an empty list leaves its quantity unspecified; a stamp of zero starts at once;
# a tolerance of 0 means the controller's tolerance. Numbers that are not finite are refused here, because JSON does not
# have them, with the same message as the robot's.


_PIECE: Final = 1000
"""Maximum number of values in one request: about 24 kB, which the robot reads in a fraction of a millisecond."""
_QUANTITIES: Final = {
    "positions": "position",
    "velocities": "velocity",
    "accelerations": "acceleration",
    "effort": "effort",
}


def seconds(duration: RosMessage) -> float:
    """Return a builtin_interfaces/msg/Duration in s."""
    return float(duration.sec + duration.nanosec / 1e9)


def stamp_of(trajectory: RosMessage) -> float | None:
    """Return the start time of a JointTrajectory in s, or None if it starts at once."""
    return seconds_of(trajectory.header.stamp.sec, trajectory.header.stamp.nanosec)


def point_of(point: RosMessage) -> TrajectoryPoint:
    """Convert a JointTrajectoryPoint message to a TrajectoryPoint."""
    return TrajectoryPoint(
        positions=list(point.positions),
        velocities=list(point.velocities),
        accelerations=list(point.accelerations),
        effort=list(point.effort),
        time_from_start=seconds(point.time_from_start),
    )


def tolerances_of(messages: Sequence[RosMessage]) -> tuple[TrajectoryTolerance, ...]:
    """Convert JointTolerance messages; values that are not finite become 0 (the controller's tolerance)."""
    return tuple(
        TrajectoryTolerance(
            joint=message.name,
            position=_finite(message.position),
            velocity=_finite(message.velocity),
            acceleration=_finite(message.acceleration),
        )
        for message in messages
    )


def _finite(tolerance: float) -> float:
    return tolerance if math.isfinite(tolerance) else 0.0  # 0: the parameter's value, as upstream for nan


def pieces_of(trajectory: RosMessage) -> Iterator[list[TrajectoryPoint]]:
    """Yield the points of a JointTrajectory in lists, one for each request; without points, yield one empty list.

    Raise ValueError with the reason if there are too many points, or if a point has a number that is not finite.
    """
    points = trajectory.points
    if len(points) > MAX_POINTS:
        raise ValueError(f"the trajectory has {len(points)} points, and the limit is {MAX_POINTS}; send fewer")
    rest, at, count = iter(points), 0, _points_in_a_piece(trajectory)
    while chunk := list(islice(rest, count)):
        piece = [point_of(element) for element in chunk]
        for index, point in enumerate(piece):
            _demand_numbers(point, at + index, trajectory.joint_names)
        at += len(chunk)
        yield piece
    if not at:
        yield []


def is_one_piece(trajectory: RosMessage) -> bool:
    """Whether a JointTrajectory fits into one request."""
    return len(trajectory.points) <= _points_in_a_piece(trajectory)


def _points_in_a_piece(trajectory: RosMessage) -> int:
    widest = max((sum(len(getattr(point, name)) for name in _QUANTITIES) + 1 for point in trajectory.points), default=1)
    return max(1, _PIECE // widest)


def _demand_numbers(point: TrajectoryPoint, at: int, joints: Sequence[str]) -> None:
    for name, word in _QUANTITIES.items():
        values = getattr(point, name)
        if not all(map(math.isfinite, values)):
            index = [math.isfinite(value) for value in values].index(False)
            joint = joints[index] if index < len(joints) else f"value {index}"
            raise ValueError(f"point {at}: the {word} of {joint} is {values[index]}; give finite numbers")


def goal_refusal(goal: RosMessage) -> str | None:
    """Return why a FollowJointTrajectory goal is not supported, or None if it is supported."""
    lengths = {
        "multi_dof_trajectory": len(goal.multi_dof_trajectory.points),
        "component_path_tolerance": len(goal.component_path_tolerance),
        "component_goal_tolerance": len(goal.component_goal_tolerance),
    }
    unknown = next((name for name, length in lengths.items() if length), None)
    return (
        None if unknown is None else f"{unknown} is not supported (joints have one degree of freedom); leave it empty"
    )


# Topics and query service of a joint trajectory controller, in addition to its action.
#
# Rules (joint_trajectory_controller, Jazzy): `~/joint_trajectory` replaces the running trajectory, and an invalid
# message is dropped with a warning; `~/query_state` returns the state of the trajectory at a time;
# `~/speed_scaling_input` exists only with position commands. Difference from upstream: a trajectory from the topic ends
# with this bridge.


def _end_of(trajectory: RosMessage) -> list[float]:
    """Return the positions at the end of a JointTrajectory, else its velocities, in the order of the joint names."""
    if not trajectory.points:
        return []
    last = trajectory.points[-1]
    values = list(last.positions) or list(last.velocities)
    return [value for _, value in sorted(zip(trajectory.joint_names, values, strict=False))]


class TrajectoryTopic(Endpoint):
    """Subscription of `~/joint_trajectory`; messages that arrive during a transfer replace each other."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller, self._topic = controller.name, f"{controller.name}/joint_trajectory"
        self._sending: JointTrajectory | None = None
        self._waiting: JointTrajectory | None = None
        self._followed = TrajectorySender(ros.connect)
        self.subscribe(JointTrajectory, self._topic, self._on_message, SYSTEM_DEFAULT)

    def close(self) -> None:
        """Destroy the subscription and end the trajectory received on the topic."""
        super().close()
        self._waiting = None
        self._followed.close()

    def _on_message(self, message: JointTrajectory) -> None:
        self._ros.watch_publishers(self._topic, self._topic, _end_of(message))
        self._ros.hand_over(lambda: self._take(message))

    def _take(self, message: JointTrajectory) -> None:
        self._waiting = message
        if self._sending is None:
            self._send_next()

    def _send_next(self) -> None:
        message, self._waiting, self._sending = self._waiting, None, self._waiting
        if message is None:
            return
        # a long trajectory that fails after some pieces must not end the running one, so it gets its own connection
        sender = self._followed if is_one_piece(message) else TrajectorySender(self._ros.connect)
        sender.send(pieces_of(message), partial(self._request, message), partial(self._on_answer, sender))

    def _request(self, message: JointTrajectory, points: list[TrajectoryPoint]) -> SetTrajectory:
        return SetTrajectory(
            controller=self._controller,
            joints=list(message.joint_names),
            points=points,
            stamp=self._ros.unix(stamp_of(message)),
            source=COMMANDER,
            heartbeat=HEARTBEAT_S,
        )

    def _on_answer(self, sender: TrajectorySender, _done: object, error: str | None) -> None:
        done_with = sender
        if error is None:
            done_with, self._followed = self._followed, sender
        else:
            self._ros.warn(f"{self._topic}: {without_numbers(error)}", f"{self._topic}: {error}")
        if done_with is not self._followed:
            done_with.close()
        self._sending = None
        self._send_next()


class TrajectoryQuery(Endpoint):
    """Service `~/query_state` of a joint trajectory controller."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller = controller.name
        self.serve("control_msgs/srv/QueryTrajectoryState", f"{controller.name}/query_state", self._answer)

    def _answer(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        def fill(answer: TrajectoryAt | None, error: str | None) -> None:
            response.message = str(error)
            if answer is not None:
                response.success, response.message = answer.known, answer.text
                response.name, response.position = list(answer.joints), answer.point.positions
                response.velocity, response.acceleration = answer.point.velocities, answer.point.accelerations
            reply(response)

        time = seconds(request.time)
        self._ros.ask(QueryTrajectory(controller=self._controller, time=self._ros.unix(time) or time), fill)


class SpeedScalingTopic(Endpoint):
    """Subscription of `~/speed_scaling_input`, created only if the controller commands positions."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller, self._topic = controller.name, f"{controller.name}/speed_scaling_input"
        self._message: Any = interface("control_msgs/msg/SpeedScalingFactor")
        self._subscription: object = None
        self.on_controller(controller)

    def on_controller(self, controller: ControllerReading) -> None:
        if self._subscription is None and controller.interface == "position":
            self._subscription = self.subscribe(self._message, self._topic, self._on_message, KEPT_DEFAULT)

    def _on_message(self, message: RosMessage) -> None:
        factor = message.factor
        if not 0.0 <= factor < math.inf:
            self.report(self._topic, f"a speed scaling of {factor:g} is invalid; give a finite number, 0 or more")
            return
        request = ScaleTrajectory(controller=self._controller, factor=factor)
        self._ros.hand_over(lambda: self._ros.ask(request, lambda _done, error: self.report(self._topic, error)))
