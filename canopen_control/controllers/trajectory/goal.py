"""Goal of the action control_msgs/FollowJointTrajectory: request, progress and result."""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING

from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.trajectory.params import GoalTolerances

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.controllers.trajectory.point import JointTrajectory


class ResultCode(enum.IntEnum):
    """Error codes in the result of control_msgs/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class TrajectoryGoal:
    """Action goal: a trajectory with its own tolerances; `code` and `text` are the result after the end.

    `ended_now` is called at the end, within the cycle: an observer must defer longer work. `feedback_rate` in Hz and
    `outlives_client` are parameters of the controller that has accepted the goal.
    """

    def __init__(
        self,
        trajectory: JointTrajectory,
        tolerances: GoalTolerances | None = None,
        ended_now: Callable[[], object] = lambda: None,
    ) -> None:
        self.trajectory = trajectory
        self.tolerances = GoalTolerances() if tolerances is None else tolerances
        self.state = GoalState.EXECUTING
        self.code: ResultCode | None = None
        self.text = ""
        self.feedback_rate = 20.0
        self.outlives_client = False
        self._ended_now = ended_now

    @property
    def ended(self) -> bool:
        """Whether the goal has a result."""
        return self.code is not None

    def end(self, state: GoalState, code: ResultCode, text: str) -> None:
        """Store the result and call `ended_now`, unless the goal has already ended."""
        if self.code is None:
            self.state, self.code, self.text = state, code, text
            self._ended_now()
