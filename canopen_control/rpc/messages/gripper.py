"""Requests to a gripper action controller of a running robot.

The end of a goal is reported to the connection that sent the goal; a new goal replaces the connection's previous goal.
SI units: rad or m, Nm or N.
"""

from __future__ import annotations

from typing import Annotated, Final, Generic, TypeVar

import msgspec

from canopen_control.rpc.messages.declare import Done, Effect, Request

A = TypeVar("A")


class GripperVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """Acceptance or refusal of a gripper goal; `text` is the reason, `feedback_rate` is in Hz.

    `outlives_client` is always false: a gripper stops when the client of its goal disconnects.
    """

    accepted: bool
    text: str = ""
    feedback_rate: float = 20.0
    outlives_client: bool = False


class GripperResult(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a gripper goal: `state` is "succeeded", "canceled" or "aborted", `text` the reason."""

    state: str
    text: str
    position: float | None = None
    effort: float | None = None
    stalled: bool = False
    reached_goal: bool = False


class _Goal(Request[A], Generic[A], frozen=True, kw_only=True):
    controller: str
    position: float
    max_effort: float | None = None
    max_velocity: float | None = None
    source: str | None = None
    dead_man: bool = True
    heartbeat: Annotated[float, msgspec.Meta(gt=0.0, le=3600.0)] | None = None


class MoveGripper(_Goal[GripperResult], frozen=True, kw_only=True):
    """Execute a gripper goal (a position); the answer is sent when the goal ends.

    Without `max_effort` and `max_velocity` (null or 0) the controller's values apply. With `dead_man` the joint is held
    as soon as this connection is lost, unless the goal has succeeded; with `heartbeat` also if the connection has sent
    no `trajectory_heartbeat` for this time in s.
    """


class SendGripper(_Goal[GripperVerdict], frozen=True, kw_only=True):
    """Send a gripper goal, and return at once whether it is accepted; `gripper_end` waits for the end."""


class GripperEnd(Request[GripperResult], frozen=True, kw_only=True):
    """Wait for the end of the last gripper goal of this connection."""


class CancelGripper(Request[Done], frozen=True, kw_only=True):
    """Cancel the goal of a gripper controller, even of another client; the joint is held.

    With `own` true only a goal of this connection is cancelled. `why` becomes part of the result.
    """

    controller: str
    own: bool = False
    why: str | None = None


GRIPPER_METHODS: Final = (
    ("move_gripper", Effect.MOVES, MoveGripper),
    ("send_gripper", Effect.MOVES, SendGripper),
    ("gripper_end", Effect.READS, GripperEnd),
    ("cancel_gripper", Effect.STOPS, CancelGripper),
)
