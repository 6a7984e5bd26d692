"""Requests about the trajectories of a joint trajectory controller.

The end of a goal is reported; a connection has one goal at a time, the one that it sent last. A trajectory that was set
has no end. SI units; times of points are seconds from the trajectory's start, stamps Unix seconds.
"""

from __future__ import annotations

from typing import Annotated, Final, Generic, TypeVar

import msgspec

from canopen_control.rpc.messages.declare import Done, Effect, Request
from canopen_control.rpc.messages.samples import TrajectoryPoint

A = TypeVar("A")
MAX_POINTS: Final = 20_000  # of a trajectory


class TrajectoryTolerance(msgspec.Struct, frozen=True, kw_only=True):
    """Tolerances of a joint (control_msgs/JointTolerance): 0 uses the parameters, -1 disables it."""

    joint: str
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


class TrajectoryVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """Acceptance of a goal; for a refusal the code of FollowJointTrajectory and the reason.

    `feedback_rate` in Hz and `outlives_client` come from the controller's parameters: how often the client gets the
    positions of the joints, and whether the goal continues when the client has disconnected.
    """

    accepted: bool
    error_code: int = 0
    text: str = ""
    feedback_rate: float = 20.0
    outlives_client: bool = False


class TrajectoryResult(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a goal: "succeeded", "canceled" or "aborted", the code of FollowJointTrajectory, the reason."""

    state: str
    error_code: int
    text: str


class TrajectoryAt(msgspec.Struct, frozen=True, kw_only=True):
    """State of a trajectory at a time; the present state and a reason if it has none."""

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
    """Execute a trajectory as a goal of a joint trajectory controller; answered at its end.

    One value for each of `joints`, or none at all, in each list of a point; they come after those of `trajectory_data`.
    `stamp` is when it begins, null at once.
    With `dead_man` the joints brake as soon as this connection is gone, with `heartbeat` besides when it has sent no
    `trajectory_heartbeat` for so many seconds: a sender that hangs, or was stopped, is gone as well.
    """


class SendTrajectory(_Goal[TrajectoryVerdict], frozen=True, kw_only=True):
    """Send a trajectory; answered at once, also with a refusal; `trajectory_end` waits for its end."""


class SetTrajectory(_Trajectory[Done], frozen=True, kw_only=True):
    """Set a trajectory without a goal, as from ROS's topic; an active goal is then evaluated by it."""


class TrajectoryData(Request[Done], frozen=True, kw_only=True):
    """First points of this connection's next trajectory, if it exceeds one request."""

    points: list[TrajectoryPoint]


class TrajectoryEnd(Request[TrajectoryResult], frozen=True, kw_only=True):
    """Wait for the end of this connection's last goal."""


class TrajectoryHeartbeat(Request[Done], frozen=True, kw_only=True):
    """Heartbeat for a trajectory of this connection that was sent with `heartbeat`."""


class CancelTrajectory(Request[Done], frozen=True, kw_only=True):
    """Cancel a controller's trajectory, of any client; the joints brake and hold.

    Refused where it follows none. `own` true: only a goal of this connection's. `why` is put into its result.
    """

    controller: str
    own: bool = False
    why: str | None = None


class QueryTrajectory(Request[TrajectoryAt], frozen=True, kw_only=True):
    """State of a controller's trajectory at a time in Unix seconds."""

    controller: str
    time: float


class ScaleTrajectory(Request[Done], frozen=True, kw_only=True):
    """Scale the speed of a controller's trajectories: 1 as planned, 0 standstill."""

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
