"""API methods for trajectories and grippers; a connection has at most one active goal of each kind.

A goal with `dead_man` ends with its connection. A client that has announced a heartbeat counts as disconnected when
the heartbeat stops, even if the connection remains: its process may be blocked or stopped by a signal.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar

from canopen_control.controllers.base import finite
from canopen_control.controllers.command_timeout import CommandSender
from canopen_control.controllers.request_protocols import GripperGoal, Grips
from canopen_control.controllers.trajectory.goal import ResultCode, TrajectoryGoal
from canopen_control.controllers.trajectory.params import GoalTolerances, JointTolerance
from canopen_control.controllers.trajectory.point import JointTrajectory
from canopen_control.controllers.trajectory.validation import PointBuffer
from canopen_control.errors import ControlError, TrajectoryRefused
from canopen_control.rpc.messages.declare import Done, Request
from canopen_control.rpc.messages.gripper import (
    CancelGripper,
    GripperEnd,
    GripperResult,
    GripperVerdict,
    MoveGripper,
    SendGripper,
)
from canopen_control.rpc.messages.trajectory import (
    MAX_POINTS,
    CancelTrajectory,
    FollowTrajectory,
    QueryTrajectory,
    ScaleTrajectory,
    SendTrajectory,
    SetTrajectory,
    TrajectoryData,
    TrajectoryEnd,
    TrajectoryHeartbeat,
    TrajectoryResult,
    TrajectoryVerdict,
)
from canopen_control.runtime.observer import RobotObserver

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.controllers.command_timeout import CommandTimeout
    from canopen_control.host.lineserver import Connection
    from canopen_control.rpc.messages.robot import RobotHello, RobotPush
    from canopen_control.rpc.messages.samples import TrajectoryPoint
    from canopen_control.rpc.messages.trajectory import TrajectoryTolerance
    from canopen_control.rpc.server import Call, Server
    from canopen_control.runtime.core import RobotCore

    TrajectoryCall: TypeAlias = Call[FollowTrajectory] | Call[SendTrajectory] | Call[SetTrajectory]
    SentTrajectory: TypeAlias = "_SentGoal[TrajectoryGoal, TrajectoryResult]"
    SentGrip: TypeAlias = "_SentGoal[GripperGoal, GripperResult]"


G = TypeVar("G")
R = TypeVar("R")


class GoalMethods(RobotObserver):
    """API methods for trajectories and grippers; `keep` raises ControlError if too many connections are permanent."""

    def __init__(
        self, robot: RobotCore, server: Server[RobotHello, RobotPush], keep: Callable[[Connection], None]
    ) -> None:
        self._robot, self._keep = robot, keep
        self._points: dict[Connection, PointBuffer] = {}
        self._sent: dict[Connection, SentTrajectory] = {}
        self._grips: dict[Connection, SentGrip] = {}
        self._heartbeats: dict[Connection, _RequiredHeartbeat] = {}
        server.register(TrajectoryData, self._data)
        server.register(FollowTrajectory, self._follow)
        server.register(SendTrajectory, self._send)
        server.register(SetTrajectory, self._set)
        server.register(TrajectoryEnd, self._end)
        server.register(CancelTrajectory, self._cancel)
        server.register(QueryTrajectory, self._query)
        server.register(ScaleTrajectory, self._scale)
        server.register(TrajectoryHeartbeat, self._heartbeat)
        server.register(MoveGripper, lambda call: self._start_grip(call).answer_at_end(call))
        server.register(SendGripper, self._send_grip)
        server.register(GripperEnd, self._end_grip)
        server.register(CancelGripper, self._cancel_grip)
        robot.observers.append(self)

    def forget(self, connection: Connection) -> None:
        self._points.pop(connection, None)
        self._sent.pop(connection, None)
        self._grips.pop(connection, None)
        self._heartbeats.pop(connection, None)

    def _send_to_controller(
        self,
        call: Call[FollowTrajectory]
        | Call[SendTrajectory]
        | Call[SetTrajectory]
        | Call[MoveGripper]
        | Call[SendGripper],
        goal: TrajectoryGoal | JointTrajectory | GripperGoal,
    ) -> None:
        request, connection = call.request, call.connection
        if request.dead_man:
            self._keep(connection)
        holder = connection if request.dead_man else None
        sender = CommandSender(connection, call.sender(request.source))
        self._robot.send_goal(request.controller, goal, request.source or call.client, holder=holder, sender=sender)
        self._require_heartbeat(connection, request.controller, request.heartbeat if request.dead_man else None)

    # ---------------------------------------------------------------------------------------------- trajectories

    def _data(self, call: Call[TrajectoryData]) -> None:
        self._collect(call.connection, call.request.points)
        call.reply(Done())

    def _collect(self, connection: Connection, points: Sequence[TrajectoryPoint]) -> PointBuffer:
        """Buffer the points of a message; return all points of the connection.

        Raise ControlError for too many points.
        """
        buffer = self._points.setdefault(connection, PointBuffer())
        if len(buffer) + len(points) > MAX_POINTS:
            del self._points[connection]
            raise ControlError(f"a trajectory has {MAX_POINTS} points at most; nothing was kept, send fewer")
        buffer.add(points)
        return buffer

    def _trajectory(self, call: TrajectoryCall) -> JointTrajectory:
        """Return the trajectory of a request, including the points that the connection has sent before."""
        request = call.request
        points = self._collect(call.connection, request.points)
        del self._points[call.connection]
        stamp = 0 if request.stamp is None else self._robot.time_of(request.stamp)
        return JointTrajectory(request.joints, points, stamp)

    # ------------------------------------------------------------------------------------------------- heartbeats

    def _require_heartbeat(self, connection: Connection, controller: str, heartbeat: float | None) -> None:
        """Require a heartbeat every `heartbeat` s from a connection while its command of `controller` is active.

        None ends an earlier requirement.
        """
        self._heartbeats.pop(connection, None)
        if heartbeat is not None:
            timeout = self._robot.manager.get(controller).command_timeout
            self._heartbeats[connection] = _RequiredHeartbeat(
                timeout, round(heartbeat * 1e9), self._robot.reactor.now()
            )

    def _heartbeat(self, call: Call[TrajectoryHeartbeat]) -> None:
        required = self._heartbeats.get(call.connection)
        if required is not None:
            required.last_heartbeat = self._robot.reactor.now()
        call.reply(Done())

    def after_cycle(self, now: int) -> None:
        if not self._heartbeats:
            return
        for connection in [client for client, required in self._heartbeats.items() if required.is_overdue(now)]:
            required = self._heartbeats.pop(connection)
            if required.command_timeout.holder is connection:
                self._robot.client_disconnected(
                    connection, f"has sent no heartbeat for {required.within_ns / 1e9:g} s and is gone"
                )

    # ------------------------------------------------------------------------------------------------------ goals

    def _follow(self, call: Call[FollowTrajectory]) -> None:
        self._start_goal(call).answer_at_end(call)

    def _send(self, call: Call[SendTrajectory]) -> None:
        """Reply whether the goal is accepted; a refusal, too, is a normal reply and not an error."""
        try:
            goal = self._start_goal(call).goal
        except ControlError as error:
            code = error.code if isinstance(error, TrajectoryRefused) else int(ResultCode.INVALID_GOAL)
            call.reply(TrajectoryVerdict(accepted=False, error_code=code, text=str(error)))
        else:
            call.reply(
                TrajectoryVerdict(accepted=True, feedback_rate=goal.feedback_rate, outlives_client=goal.outlives_client)
            )

    def _start_goal(self, call: Call[FollowTrajectory] | Call[SendTrajectory]) -> SentTrajectory:
        """Start the requested goal, which replaces the connection's earlier goal; raise ControlError if refused."""
        request, robot = call.request, self._robot
        trajectory = self._trajectory(call)
        tolerances = GoalTolerances(
            _tolerances(request.path_tolerance), _tolerances(request.goal_tolerance), request.goal_time_tolerance
        )
        goal = TrajectoryGoal(trajectory, tolerances, lambda: robot.reactor.call_soon(sent.settle))
        sent = _SentGoal(goal, _trajectory_result)
        self._send_to_controller(call, goal)
        self._sent[call.connection] = sent
        return sent

    def _set(self, call: Call[SetTrajectory]) -> None:
        self._send_to_controller(call, self._trajectory(call))
        call.reply(Done())

    def _end(self, call: Call[TrajectoryEnd]) -> None:
        sent = self._sent.get(call.connection)
        if sent is None:
            raise ControlError("this connection has sent no goal; send one with send_trajectory")
        sent.answer_at_end(call)

    def _cancel(self, call: Call[CancelTrajectory]) -> None:
        request, sent = call.request, self._sent.get(call.connection)
        manager = self._robot.manager
        if not request.own:
            manager.follower(request.controller).cancel_goal(request.why)
        elif sent is not None:
            manager.follower(request.controller).cancel_goal(request.why, sent.goal)
        else:
            manager.get(request.controller)
        call.reply(Done())

    # ------------------------------------------------------------------------------------------------ queries

    def _query(self, call: Call[QueryTrajectory]) -> None:
        controller = self._robot.manager.follower(call.request.controller)
        call.reply(controller.trajectory_at(self._robot.time_of(call.request.time)))

    def _scale(self, call: Call[ScaleTrajectory]) -> None:
        controller = call.request.controller
        self._robot.latch.refuse("another speed for", controller)
        self._robot.manager.follower(controller).set_speed_scaling(call.request.factor)
        call.reply(Done())

    # ----------------------------------------------------------------------------------------------------- grippers

    def _send_grip(self, call: Call[SendGripper]) -> None:
        """Reply whether the goal is accepted; a refusal, too, is a normal reply and not an error."""
        try:
            goal = self._start_grip(call).goal
        except ControlError as error:
            call.reply(GripperVerdict(accepted=False, text=str(error)))
        else:
            call.reply(GripperVerdict(accepted=True, feedback_rate=goal.feedback_rate))

    def _start_grip(self, call: Call[MoveGripper] | Call[SendGripper]) -> SentGrip:
        """Start the requested goal, which replaces the connection's earlier goal; raise ControlError if refused."""
        request, reactor = call.request, self._robot.reactor
        goal = GripperGoal(
            request.position, request.max_effort, request.max_velocity, lambda: reactor.call_soon(sent.settle)
        )
        sent = _SentGoal(goal, _gripper_result)
        self._send_to_controller(call, goal)
        self._grips[call.connection] = sent
        return sent

    def _end_grip(self, call: Call[GripperEnd]) -> None:
        sent = self._grips.get(call.connection)
        if sent is None:
            raise ControlError("this connection has sent no goal; send one with send_gripper")
        sent.answer_at_end(call)

    def _cancel_grip(self, call: Call[CancelGripper]) -> None:
        request, sent = call.request, self._grips.get(call.connection)
        controller = self._robot.manager.get(request.controller)
        if isinstance(controller, Grips) and (not request.own or sent is not None):
            controller.cancel_grip(request.why, sent.goal if request.own and sent is not None else None)
        call.reply(Done())


class _RequiredHeartbeat:
    """Heartbeat that a connection must send at least every `within_ns`; `last_heartbeat` is in ns.

    It applies while `command_timeout`, the command timeout of the controller, belongs to the connection.
    """

    __slots__ = ("command_timeout", "last_heartbeat", "within_ns")

    def __init__(self, timeout: CommandTimeout, within_ns: int, last_heartbeat: int) -> None:
        self.command_timeout, self.within_ns, self.last_heartbeat = timeout, within_ns, last_heartbeat

    def is_overdue(self, now: int) -> bool:
        return now - self.last_heartbeat > self.within_ns


class _SentGoal(Generic[G, R]):
    """Goal of a connection, with the requests to answer when it ends; `result` returns None until then."""

    def __init__(self, goal: G, result: Callable[[G], R | None]) -> None:
        self.goal, self._result = goal, result
        self._waiting: list[Call[Request[R]]] = []

    def answer_at_end(self, call: Call[Request[R]]) -> None:
        self._waiting.append(call)
        self.settle()

    def settle(self) -> None:
        """Answer the waiting requests once the goal has ended."""
        result = self._result(self.goal)
        if result is None:
            return
        waiting, self._waiting = self._waiting, []
        for call in waiting:
            call.reply(result)


def _trajectory_result(goal: TrajectoryGoal) -> TrajectoryResult | None:
    if goal.code is None:
        return None
    return TrajectoryResult(state=goal.state.value, error_code=int(goal.code), text=goal.text)


def _tolerances(messages: Sequence[TrajectoryTolerance]) -> tuple[JointTolerance, ...]:
    return tuple(
        JointTolerance(tolerance.position, tolerance.velocity, tolerance.acceleration, tolerance.joint)
        for tolerance in messages
    )


def _gripper_result(goal: GripperGoal) -> GripperResult | None:
    if not goal.ended:
        return None
    return GripperResult(
        state=goal.state.value,
        text=goal.text,
        position=finite(goal.at),
        effort=finite(goal.effort),
        stalled=goal.stalled,
        reached_goal=goal.reached,
    )
