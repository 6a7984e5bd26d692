"""Requests to a gripper action controller of a running robot.

The end of a goal is reported; a connection has one goal at a time, the last one sent. SI units: rad or m, Nm or N.
"""

from __future__ import annotations

from typing import Annotated, Final, Generic, TypeVar

import msgspec

from canopen_control.rpc.messages.declare import Done, Effect, Request

A = TypeVar("A")


class GripperVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """Acceptance of a goal, or the reason of its refusal; `feedback_rate` in Hz is the rate of feedback.

    `outlives_client` is false: a gripper stops when the client of its goal disconnects.
    """

    accepted: bool
    text: str = ""
    feedback_rate: float = 20.0
    outlives_client: bool = False


class GripperResult(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a goal: "succeeded", "canceled" or "aborted", with position and reason."""

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
    """Execute a gripper goal (a position); answered at its end.

    `max_effort` and `max_velocity` null or 0 are the controller's. With `dead_man` the joint is held where it is as
    soon as this connection is gone, unless the goal has succeeded; with `heartbeat` besides when it has sent no
    `trajectory_heartbeat` for so many seconds.
    """


class SendGripper(_Goal[GripperVerdict], frozen=True, kw_only=True):
    """Send a gripper goal; answered at once, also with a refusal; `gripper_end` waits for its end."""


class GripperEnd(Request[GripperResult], frozen=True, kw_only=True):
    """Wait for the end of this connection's last goal."""


class CancelGripper(Request[Done], frozen=True, kw_only=True):
    """Cancel a gripper controller's goal, of any client; the joint is held.

    `own` true: only if it is this connection's. `why` is put into its result.
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
