"""`~/follow_joint_trajectory`: the action by which MoveIt and others have a joint trajectory controller follow a path.

The law of the file (joint_trajectory_controller, Jazzy): a newer goal takes the place of the one that runs, feedback is
sent at the controller's `action_monitor_rate`; what a goal lives by, and how it ends, is in `action_goals`. Ours: it
outlives the client that sent it only where the controller's `continue_without_client` is true; who asks for the result
of a refused goal is told which rule it breaks.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Final

from canopen_control.ros.action_goals import ActionGoals
from canopen_control.ros.endpoint import COMMANDER
from canopen_control.ros.interfaces import interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.trajectory_messages import (
    fill_point,
    goal_refusal,
    pieces_of,
    seconds,
    stamp_of,
    tolerances_of,
)
from canopen_control.ros.trajectory_sender import HEARTBEAT_S
from canopen_control.rpc.messages.samples import TrajectorySample
from canopen_control.rpc.messages.trajectory import (
    CancelTrajectory,
    SendTrajectory,
    TrajectoryEnd,
    TrajectoryResult,
    TrajectoryVerdict,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.ros.endpoint import Ros, RosMessage
    from canopen_control.ros.trajectory_sender import TrajectorySender
    from canopen_control.rpc.messages.declare import Done, Request
    from canopen_control.rpc.messages.samples import TrajectoryPoint
    from canopen_control.rpc.messages.state import ControllerReading

__all__ = ["FollowJointTrajectory"]

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
