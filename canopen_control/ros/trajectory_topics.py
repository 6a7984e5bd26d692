"""Topics and query service of a joint trajectory controller, in addition to its action.

Rules (joint_trajectory_controller, Jazzy): `~/joint_trajectory` replaces the running trajectory, and an invalid message
is dropped with a warning; `~/query_state` returns the state of the trajectory at a time; `~/speed_scaling_input` exists
only with position commands. Difference from upstream: a trajectory from the topic ends with this bridge.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, Final

from trajectory_msgs.msg import JointTrajectory

from canopen_control.ros.action_goals import HEARTBEAT_S, TrajectorySender
from canopen_control.ros.conversions import seconds_of
from canopen_control.ros.endpoint import COMMANDER, Endpoint, without_numbers
from canopen_control.ros.interfaces import interface
from canopen_control.ros.rcl import KEPT_DEFAULT, SYSTEM_DEFAULT
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


class TrajectoryTopic(Endpoint):
    """Subscription of `~/joint_trajectory`; messages that arrive during a transfer replace each other."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller, self._topic = controller.name, f"{controller.name}/joint_trajectory"
        self._sending: JointTrajectory | None = None
        self._waiting: JointTrajectory | None = None
        self._followed = TrajectorySender(ros.connect)
        self.subscribe(
            JointTrajectory, self._topic, lambda message: ros.hand_over(lambda: self._take(message)), SYSTEM_DEFAULT
        )

    def close(self) -> None:
        """Destroy the subscription and end the trajectory received on the topic."""
        super().close()
        self._waiting = None
        self._followed.close()

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
