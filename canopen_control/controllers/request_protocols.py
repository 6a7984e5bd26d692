"""Protocols of requests that only some controllers accept, and the goal of a gripper action.

The manager refuses a request that a controller does not accept, with an explanation (`ControllerManager.command`,
`send_goal`, `base`, `loops`, `follower`).

Rules of a gripper's goal (gripper_controllers, Jazzy): it is reached within its tolerance of the position; a gripper
has stalled if its speed has stayed within a threshold for the timeout.
"""

from __future__ import annotations

import enum
import math
from typing import TYPE_CHECKING, Protocol, TypeGuard, runtime_checkable

from canopen_control.controllers.command_timeout import GoalState

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.controllers.trajectory.goal import TrajectoryGoal
    from canopen_control.controllers.trajectory.point import JointTrajectory
    from canopen_control.rpc.messages.trajectory import TrajectoryAt


@runtime_checkable
class TakesCommands(Protocol):
    """Controller that accepts a value for each of its command interfaces, or a twist."""

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        """Store a command; raise ControlError if the command is refused.

        `stamp` is the creation time, `now` the reception time, both in ns.
        """
        ...


_COMMANDED: dict[type[Controller], bool] = {}  # cache: checking a protocol takes 12 us, and commands come every cycle


def takes_commands(controller: Controller) -> TypeGuard[TakesCommands]:
    """Whether a controller accepts commands; the result is cached by type."""
    kind = type(controller)
    if kind not in _COMMANDED:
        _COMMANDED[kind] = issubclass(kind, TakesCommands)
    return _COMMANDED[kind]


@runtime_checkable
class TakesNamedValues(Protocol):
    """Controller that accepts values for some of its command interfaces, by name."""

    def set_named(self, values: Mapping[str, float], now: int) -> None:
        """Store values by interface name, all or none; other interfaces are unchanged."""
        ...


@runtime_checkable
class FollowsTrajectories(Protocol):
    """Controller that executes trajectories, from action goals or a topic."""

    def send_goal(self, goal: TrajectoryGoal | JointTrajectory, now: int) -> None:
        """Start a goal or a trajectory in the next cycle; raise ControlError if it is refused. `now` is in ns."""
        ...

    def cancel_goal(self, why: str | None = None, only: TrajectoryGoal | None = None) -> None:
        """Cancel the active trajectory; with `only`, cancel it only if it belongs to this goal. `why` is reported.

        Raise ControlError if there is nothing to cancel.
        """
        ...

    def trajectory_at(self, t: int) -> TrajectoryAt:
        """Return the state of the active trajectory at `t`, in ns; `known` is False if none is active then."""
        ...

    def set_speed_scaling(self, factor: float) -> None:
        """Set the speed scaling factor of trajectories; raise ControlError if scaling is not possible."""
        ...


@runtime_checkable
class Grips(Protocol):
    """Controller that executes gripper goals."""

    def grip(self, goal: GripperGoal, now: int) -> None:
        """Start a goal in the next cycle, which aborts the previous goal.

        Raise ControlError if the goal is refused; `now` is in ns.
        """
        ...

    def cancel_grip(self, why: str | None = None, only: GripperGoal | None = None) -> None:
        """Cancel the active goal; with `only`, cancel it only if it is this goal. `why` is reported."""
        ...


@runtime_checkable
class HasOdometry(Protocol):
    """Controller whose odometry can be set."""

    def set_odometry(self, x: float, y: float, heading: float) -> None:
        """Set the pose of the odometry, in m and rad."""
        ...


@runtime_checkable
class ClosesLoops(Protocol):
    """Controller with control loops between references and measured states."""

    def set_feed_forward(self, enabled: bool) -> None:
        """Enable or disable the feed-forward of the references."""
        ...

    def set_measured_states(self, values: Sequence[float], now: int) -> None:
        """Store measured states; raise ControlError if the controller reads state interfaces. `now` is in ns."""
        ...


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
