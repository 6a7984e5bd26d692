"""Goal of a gripper action, and the detection of success and stall (control_msgs/GripperCommand).

Rules (gripper_controllers, Jazzy): a goal is reached within its tolerance of the position; a gripper has stalled if its
speed has stayed within a threshold for the timeout.
"""

from __future__ import annotations

import enum
import math
from typing import TYPE_CHECKING

from canopen_control.controllers.command_timeout import GoalState

if TYPE_CHECKING:
    from collections.abc import Callable


class GripperGoal:
    """Goal of a gripper: position in rad or m, maximum effort in Nm or N, and maximum velocity.

    A maximum that is None or 0 is taken from the parameters. When the goal has `ended`, the other attributes are its
    result: `at` is the final position, nan if unknown. `ended_now` is called at the end, within the cycle: an observer
    must defer longer work.
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

    def end(self, state: GoalState, text: str, at: float, effort: float, status: GripStatus) -> None:
        """Store the result and call `ended_now`, unless the goal has already ended."""
        if not self.ended:
            self.state, self.text, self.at, self.effort = state, text, at, effort
            self.reached, self.stalled = status is GripStatus.REACHED, status is GripStatus.STALLED
            self.ended = True
            self._ended_now()


class GripStatus(enum.Enum):
    """Progress of a gripper goal."""

    MOVING = "moving"
    REACHED = "reached"
    STALLED = "stalled"


class StallDetector:
    """Detector of success and stall of a gripper goal, updated once per cycle; `timeout` is in s."""

    def __init__(self, tolerance: float, slowest: float, timeout: float) -> None:
        self._tolerance, self._slowest, self._timeout_ns = tolerance, slowest, round(timeout * 1e9)
        self._moved = 0

    def begin(self, now: int) -> None:
        """Start the detection for a new goal; `now` is in ns."""
        self._moved = now

    def update(self, now: int, error: float, velocity: float) -> GripStatus:
        """Return the status for a position error and a velocity; `now` is in ns."""
        if abs(error) < self._tolerance:
            return GripStatus.REACHED
        if abs(velocity) > self._slowest:
            self._moved = now
        return GripStatus.STALLED if now - self._moved > self._timeout_ns else GripStatus.MOVING
