"""The API's methods about grippers: a connection has one goal, which ends with it; its end is told to who asks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.controllers.gripper_goal import GripperGoal
from canopen_control.controllers.state_copy import finite
from canopen_control.errors import ControlError
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.gripper import (
    CancelGripper,
    GripperEnd,
    GripperResult,
    GripperVerdict,
    MoveGripper,
    SendGripper,
)
from canopen_control.runtime.api_trajectories import SentGoal

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.rpc.messages.robot import RobotHello, RobotPush
    from canopen_control.rpc.server import Call, Connection, Server
    from canopen_control.runtime.core import RobotCore

    Sent = SentGoal[GripperResult]

__all__ = ["GripperMethods"]


class GripperMethods:
    """Answers these methods on a server; `keep` refuses one more of those who hold a command.

    `promise` takes the heartbeat that a connection promises, None for none.
    """

    def __init__(
        self,
        robot: RobotCore,
        server: Server[RobotHello, RobotPush],
        keep: Callable[[Connection], None],
        promise: Callable[[Connection, str, float | None], None],
    ) -> None:
        self._robot, self._keep, self._promise = robot, keep, promise
        self._sent: dict[Connection, tuple[GripperGoal, Sent]] = {}
        server.answers(MoveGripper, lambda call: self._give(call)[1].tell(call))
        server.answers(SendGripper, self._send)
        server.answers(GripperEnd, self._end)
        server.answers(CancelGripper, self._cancel)

    def forget(self, connection: Connection) -> None:
        """Drop the goal that a connection has sent."""
        self._sent.pop(connection, None)

    def _send(self, call: Call[SendGripper]) -> None:
        """Answer whether a goal is accepted; drives that are off and a latched stop are reasons like any other."""
        try:
            goal, _ = self._give(call)
        except ControlError as error:
            call.reply(GripperVerdict(accepted=False, text=str(error)))
        else:
            call.reply(GripperVerdict(accepted=True, feedback_rate=goal.feedback_rate))

    def _give(self, call: Call[MoveGripper] | Call[SendGripper]) -> tuple[GripperGoal, Sent]:
        """Have a goal executed, the connection's only one from now on; ControlError if it is refused."""
        wanted, robot, connection = call.request, self._robot, call.connection
        goal = GripperGoal(
            wanted.position, wanted.max_effort, wanted.max_velocity, lambda: robot.reactor.call_soon(sent.settle)
        )
        sent = SentGoal(lambda: _result(goal))
        if wanted.dead_man:
            self._keep(connection)
        robot.send_goal(
            wanted.controller, goal, wanted.source or call.who, holder=connection if wanted.dead_man else None
        )
        self._promise(connection, wanted.controller, wanted.heartbeat if wanted.dead_man else None)
        self._sent[connection] = goal, sent
        return goal, sent

    def _end(self, call: Call[GripperEnd]) -> None:
        sent = self._sent.get(call.connection)
        if sent is None:
            raise ControlError("no goal came on this connection; send_gripper sends one")
        sent[1].tell(call)

    def _cancel(self, call: Call[CancelGripper]) -> None:
        wanted, sent = call.request, self._sent.get(call.connection)
        controller = self._robot.manager.get(wanted.controller)
        if not wanted.own:
            controller.cancel_grip(wanted.why)
        elif sent is not None:
            controller.cancel_grip(wanted.why, sent[0])
        call.reply(Done())


def _result(goal: GripperGoal) -> GripperResult | None:
    """Return the result of a goal, None while it has none."""
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
