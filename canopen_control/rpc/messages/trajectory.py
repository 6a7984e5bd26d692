"""Requests for the trajectories of a joint trajectory controller.

The end of a goal is reported to the connection that sent the goal; a new goal replaces the connection's previous goal.
The end of a trajectory that was set without a goal is not reported. SI units; times of points are in s from the
start of the trajectory, stamps are Unix time in s.
"""

from __future__ import annotations

from typing import Annotated, Final, Generic, TypeVar

import msgspec

from canopen_control.rpc.messages.declare import Done, Effect, Request
from canopen_control.rpc.messages.samples import TrajectoryPoint

A = TypeVar("A")
MAX_POINTS: Final = 20_000  # maximum of a trajectory


class TrajectoryTolerance(msgspec.Struct, frozen=True, kw_only=True):
    """Tolerances of a joint (control_msgs/JointTolerance); 0 selects the parameter's value, -1 disables the check."""

    joint: str
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


class TrajectoryVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """Acceptance or refusal of a goal, with a FollowJointTrajectory code and a reason.

    `feedback_rate` in Hz and `outlives_client` are from the controller's parameters: the rate of feedback to the
    client, and whether the goal continues after the client has disconnected.
    """

    accepted: bool
    error_code: int = 0
    text: str = ""
    feedback_rate: float = 20.0
    outlives_client: bool = False


class TrajectoryResult(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a goal: "succeeded", "canceled" or "aborted", a FollowJointTrajectory code and a reason."""

    state: str
    error_code: int
    text: str


class TrajectoryAt(msgspec.Struct, frozen=True, kw_only=True):
    """State of a trajectory at a given time; if not `known`, the current state, with a reason in `text`."""

    known: bool
    text: str = ""
    joints: list[str] = []
    point: TrajectoryPoint = TrajectoryPoint()


class _Trajectory(Request[A], Generic[A], frozen=True, kw_only=True):
    controller: str
    joints: list[str]
    points: list[TrajectoryPoint]
    stamp: float | None = None
    source: str | None = None
    dead_man: bool = True
    heartbeat: Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)] | None = None


class _Goal(_Trajectory[A], Generic[A], frozen=True, kw_only=True):
    path_tolerance: tuple[TrajectoryTolerance, ...] = ()
    goal_tolerance: tuple[TrajectoryTolerance, ...] = ()
    goal_time_tolerance: float = 0.0


class FollowTrajectory(_Goal[TrajectoryResult], frozen=True, kw_only=True):
    """Execute a trajectory as a goal of a joint trajectory controller; the answer is sent when the goal ends.

    Each list of a point has one value for each of `joints`, or no value; the points follow those of `trajectory_data`.
    `stamp` is the time of the start, null for an immediate start. With `dead_man` the joints brake as soon as this
    connection is lost; with `heartbeat` also if the connection has sent no `trajectory_heartbeat` for this time in s,
    so that a sender that hangs is detected.
    """


class SendTrajectory(_Goal[TrajectoryVerdict], frozen=True, kw_only=True):
    """Send a trajectory goal, and return at once whether it is accepted; `trajectory_end` waits for the end."""


class SetTrajectory(_Trajectory[Done], frozen=True, kw_only=True):
    """Set a trajectory without a goal, like the ROS topic; it replaces the trajectory of an active goal."""


class TrajectoryData(Request[Done], frozen=True, kw_only=True):
    """Send the first points of this connection's next trajectory if it is too long for one request."""

    points: list[TrajectoryPoint]


class TrajectoryEnd(Request[TrajectoryResult], frozen=True, kw_only=True):
    """Wait for the end of the last goal of this connection."""


class TrajectoryHeartbeat(Request[Done], frozen=True, kw_only=True):
    """Send a heartbeat for this connection's trajectory or gripper goal, if the goal requires heartbeats."""


class CancelTrajectory(Request[Done], frozen=True, kw_only=True):
    """Cancel the trajectory of a controller, even of another client; the joints brake and hold.

    Refused if the controller follows no trajectory. With `own` true only a goal of this connection is cancelled. `why`
    becomes part of the result.
    """

    controller: str
    own: bool = False
    why: str | None = None


class QueryTrajectory(Request[TrajectoryAt], frozen=True, kw_only=True):
    """Return the state of a controller's trajectory at a Unix time in s."""

    controller: str
    time: float


class ScaleTrajectory(Request[Done], frozen=True, kw_only=True):
    """Scale the speed of a controller's trajectories; 1 is the planned speed, 0 is standstill."""

    controller: str
    factor: Annotated[float, msgspec.Meta(ge=0)]


TRAJECTORY_METHODS: Final = (
    ("follow_trajectory", Effect.MOVES, FollowTrajectory),
    ("send_trajectory", Effect.MOVES, SendTrajectory),
    ("set_trajectory", Effect.MOVES, SetTrajectory),
    ("trajectory_data", Effect.CHANGES, TrajectoryData),
    ("trajectory_end", Effect.READS, TrajectoryEnd),
    ("trajectory_heartbeat", Effect.READS, TrajectoryHeartbeat),
    ("cancel_trajectory", Effect.STOPS, CancelTrajectory),
    ("query_trajectory", Effect.READS, QueryTrajectory),
    ("scale_trajectory", Effect.MOVES, ScaleTrajectory),
)
