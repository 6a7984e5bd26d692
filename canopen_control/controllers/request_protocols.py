"""Protocols of requests that only some controllers accept.

The manager refuses a request that a controller does not accept, with an explanation (`ControllerManager.command`,
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
    """Controller that accepts a value for each of its command interfaces, or a twist."""

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        """Store a command; raise ControlError if the command is refused.

        `stamp` is the creation time, `now` the reception time, both in ns.
        """
        ...


_COMMANDED: dict[type[Controller], bool] = {}  # cache: checking a protocol takes 12 us, and commands come every cycle


def takes_commands(controller: Controller) -> TypeGuard[TakesCommands]:
    """Return whether a controller accepts commands; the result is cached by type."""
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

        Raises ControlError if there is nothing to cancel.
        """
        ...

    def trajectory_at(self, t: int) -> TrajectoryAt:
        """Return the state of the active trajectory at `t`, in ns; `known` is False if no trajectory is active."""
        ...

    def set_speed_scaling(self, factor: float) -> None:
        """Set the speed scaling factor of trajectories; raise ControlError if scaling is not possible."""
        ...


@runtime_checkable
class Grips(Protocol):
    """Controller that executes gripper goals."""

    def grip(self, goal: GripperGoal, now: int) -> None:
        """Start a goal in the next cycle, which aborts the previous goal.

        Raises ControlError if the goal is refused; `now` is in ns.
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
        """Store measured states; ControlError if the controller reads state interfaces. `now` is in ns."""
        ...
