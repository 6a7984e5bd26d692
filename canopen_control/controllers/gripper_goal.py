"""Goal of a gripper, its success and its stall (control_msgs/GripperCommand).

Rules (gripper_controllers, Jazzy): a goal is reached within its tolerance of the position; a gripper has
stalled that was no faster than a threshold for a time since the goal came or since it moved last.
"""

from __future__ import annotations

import enum
import math
from typing import TYPE_CHECKING

from canopen_control.controllers.command_timeout import GoalState

if TYPE_CHECKING:
    from collections.abc import Callable


class GripperGoal:
    """Position in rad or m, with maximum effort in Nm or N and maximum velocity; None uses the parameters.

    Once it has `ended`, the rest is its result: `at` is where the gripper was then, nan where that is not known.
    `ended_now` is called then, in the cycle: an observer must defer longer work.
    """

    def __init__(
        self,
        position: float,
        max_effort: float | None = None,
        max_velocity: float | None = None,
        ended_now: Callable[[], object] = lambda: None,
    ) -> None:
        self.position, self.max_effort, self.max_velocity = position, max_effort, max_velocity
        self.state, self.ended, self.text = GoalState.EXECUTING, False, ""
        self.at = self.effort = math.nan
        self.stalled = self.reached = False
        self.feedback_rate = 20.0
        self._ended_now = ended_now

    def end(self, state: GoalState, text: str, at: float, effort: float, way: GripStatus) -> None:
        """Store the result; only the first one counts."""
        if not self.ended:
            self.state, self.text, self.at, self.effort = state, text, at, effort
            self.reached, self.stalled = way is GripStatus.REACHED, way is GripStatus.STALLED
            self.ended = True
            self._ended_now()


class GripStatus(enum.Enum):
    """Progress of a goal."""

    MOVING = "moving"
    REACHED = "reached"
    STALLED = "stalled"


class StallDetector:
    """Detector of success and stall of a gripper, once per cycle; `timeout` in s."""

    def __init__(self, tolerance: float, slowest: float, timeout: float) -> None:
        self._tolerance, self._slowest, self._timeout_ns = tolerance, slowest, round(timeout * 1e9)
        self._moved = 0

    def begin(self, now: int) -> None:
        """Start a goal, `now` in ns."""
        self._moved = now

    def update(self, now: int, error: float, velocity: float) -> GripStatus:
        """Check position error and velocity."""
        if abs(error) < self._tolerance:
            return GripStatus.REACHED
        if abs(velocity) > self._slowest:
            self._moved = now
        return GripStatus.STALLED if now - self._moved > self._timeout_ns else GripStatus.MOVING
