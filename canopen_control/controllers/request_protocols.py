"""Protocols of a controller's requests in addition to its lifecycle.

The manager refuses what a controller does not take, each request with one sentence (`ControllerManager.command`,
`send_goal`, `base`, `loops`, `follower`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, TypeGuard, runtime_checkable

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.controllers.gripper_goal import GripperGoal
    from canopen_control.controllers.trajectory.goal import TrajectoryGoal
    from canopen_control.controllers.trajectory.point import JointTrajectory
    from canopen_control.rpc.messages.trajectory import TrajectoryAt


@runtime_checkable
class TakesCommands(Protocol):
    """Controller of a value for each of its command interfaces, or of a twist."""

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        """Store a command; `stamp` is its creation, `now` its reception, both in ns. ControlError if refused."""
        ...


_COMMANDED: dict[type[Controller], bool] = {}  # a check of a protocol costs 12 us, a command comes in every cycle


def takes_commands(controller: Controller) -> TypeGuard[TakesCommands]:
    """Whether a controller takes commands."""
    kind = type(controller)
    if kind not in _COMMANDED:
        _COMMANDED[kind] = issubclass(kind, TakesCommands)
    return _COMMANDED[kind]


@runtime_checkable
class TakesNamedValues(Protocol):
    """Controller of values for some of its command interfaces, by name."""

    def set_named(self, values: Mapping[str, float], now: int) -> None:
        """Store values, see `set_command`; interfaces without a value are unchanged."""
        ...


@runtime_checkable
class FollowsTrajectories(Protocol):
    """Controller of trajectories, from goals or a topic."""

    def send_goal(self, goal: TrajectoryGoal | JointTrajectory, now: int) -> None:
        """Execute a trajectory, `now` in ns; ControlError if it is refused."""
        ...

    def cancel_goal(self, why: str | None = None, only: TrajectoryGoal | None = None) -> None:
        """Cancel the active trajectory, or `only` the goal; `why` is in the event.

        ControlError if there is none.
        """
        ...

    def trajectory_at(self, t: int) -> TrajectoryAt:
        """Return the state of the active trajectory at `t`, in ns; ControlError without one."""
        ...

    def set_speed_scaling(self, factor: float) -> None:
        """Set the speed scaling of trajectories; ControlError if it cannot be scaled."""
        ...


@runtime_checkable
class Grips(Protocol):
    """Controller of a gripper."""

    def grip(self, goal: GripperGoal, now: int) -> None:
        """Move to a position, `now` in ns; ControlError if it is refused."""
        ...

    def cancel_grip(self, why: str | None = None, only: GripperGoal | None = None) -> None:
        """Cancel the goal, or `only` this one; `why` is in the event."""
        ...


@runtime_checkable
class HasOdometry(Protocol):
    """Controller with odometry."""

    def set_odometry(self, x: float, y: float, heading: float) -> None:
        """Set the pose of the odometry, in m and rad."""
        ...


@runtime_checkable
class ClosesLoops(Protocol):
    """Controller with loops between references and measured states."""

    def set_feed_forward(self, enabled: bool) -> None:
        """Add the references to the outputs, or stop adding them."""
        ...

    def set_measured_states(self, values: Sequence[float], now: int) -> None:
        """Store measured states, `now` in ns; ControlError if the controller reads state interfaces instead."""
        ...
