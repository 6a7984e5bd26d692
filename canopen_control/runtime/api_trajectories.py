"""The API's methods about trajectories: a goal is answered when it has ended, and ends with its connection."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.controllers.trajectory.goal import Goal
from canopen_control.controllers.trajectory.packed import PackedPoints
from canopen_control.controllers.trajectory.point import JointTrajectory
from canopen_control.controllers.trajectory.tolerances import GoalTolerances, JointTolerance
from canopen_control.errors import ControlError
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.robot import (
    MAX_POINTS,
    CancelTrajectory,
    FollowTrajectory,
    TrajectoryData,
    TrajectoryResult,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.rpc.messages.robot import RobotHello, RobotPush, TrajectoryTolerance
    from canopen_control.rpc.messages.samples import TrajectoryPoint
    from canopen_control.rpc.server import Call, Connection, Server
    from canopen_control.runtime.core import RobotCore

__all__ = ["TrajectoryMethods"]


class TrajectoryMethods:
    """Answers these methods on a server; `keep` refuses one more of those who hold a command."""

    def __init__(
        self, robot: RobotCore, server: Server[RobotHello, RobotPush], keep: Callable[[Connection], None]
    ) -> None:
        self._robot, self._keep = robot, keep
        self._coming: dict[Connection, PackedPoints] = {}
        server.answers(TrajectoryData, self._data)
        server.answers(FollowTrajectory, self._follow)
        server.answers(CancelTrajectory, self._cancel)

    def forget(self, connection: Connection) -> None:
        """Drop what a connection has sent of a trajectory."""
        self._coming.pop(connection, None)

    def _data(self, call: Call[TrajectoryData]) -> None:
        self._collect(call.connection, call.request.points)
        call.reply(Done())

    def _collect(self, connection: Connection, points: Sequence[TrajectoryPoint]) -> PackedPoints:
        """Return all points that a connection has sent; ControlError, and they are dropped, if those are too many."""
        kept = self._coming.setdefault(connection, PackedPoints())
        if len(kept) + len(points) > MAX_POINTS:
            self.forget(connection)
            raise ControlError(f"a trajectory has {MAX_POINTS} points at most; nothing was kept, send fewer")
        kept.add(points)
        return kept

    def _follow(self, call: Call[FollowTrajectory]) -> None:
        wanted, robot = call.request, self._robot
        points = self._collect(call.connection, wanted.points)
        self.forget(call.connection)
        if wanted.dead_man:
            self._keep(call.connection)
        stamp = 0 if wanted.stamp is None else round(wanted.stamp * 1e9) - robot.wall_offset_ns
        path, end = _tolerances(wanted.path_tolerance), _tolerances(wanted.goal_tolerance)

        def answer() -> None:
            if goal.code is not None:
                call.reply(TrajectoryResult(state=goal.state.value, error_code=int(goal.code), text=goal.text))

        goal = Goal(
            JointTrajectory(wanted.joints, points, stamp),
            GoalTolerances(path, end, wanted.goal_time_tolerance),
            lambda: robot.reactor.call_soon(answer),
        )
        holder = call.connection if wanted.dead_man else None
        robot.send_goal(wanted.controller, goal, wanted.source or call.who, holder=holder)

    def _cancel(self, call: Call[CancelTrajectory]) -> None:
        self._robot.manager.get(call.request.controller).cancel_goal()
        call.reply(Done())


def _tolerances(given: Sequence[TrajectoryTolerance]) -> tuple[JointTolerance, ...]:
    return tuple(JointTolerance(each.position, each.velocity, each.acceleration, each.joint) for each in given)
