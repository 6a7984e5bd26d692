"""Driving by a held button: who drives, and what is sent when he lets go. No browser, no socket.

The law of this file: nothing moves but while a button is held, and a held button says so again and again. Silence for
`LET_GO_NS`, a closed page or another controller end the motion with the rest command, once and at once. One page
drives at a time; who comes second waits until the first has let go.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.rpc.messages.robot import (
    CancelTrajectory,
    CommandController,
    SendTrajectory,
    TrajectoryHeartbeat,
    TwistController,
)
from canopen_control.rpc.messages.samples import TrajectoryPoint

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["HOLD_HZ", "LET_GO_NS", "SOURCE", "Command", "DeadMan", "Motion", "joint_motion", "trajectory_motion",
           "twist_motion"]  # fmt: skip

HOLD_HZ: Final = 20.0
LET_GO_NS: Final = 200_000_000
SOURCE: Final = "view"
Command = CommandController | TwistController | SendTrajectory | CancelTrajectory | TrajectoryHeartbeat
_HEARTBEAT_S: Final = 0.5  # this process says so 20 times a second; the robot brakes where it hangs


@dataclass(frozen=True, slots=True)
class Motion:
    """What moves and what rests; the robot forgets both when this process dies.

    `again` is sent instead of `moving` while the same motion goes on, None: `moving` itself.
    """

    controller: str
    moving: Command
    resting: Command
    again: Command | None = None


def twist_motion(controller: str, linear: float, angular: float, lateral: float = 0.0) -> Motion:
    """Return the motion of a base: m/s forward and to the left, and rad/s."""
    moving, resting = (
        TwistController(
            controller=controller, linear=ahead, lateral=aside, angular=around, source=SOURCE, dead_man=True
        )
        for ahead, aside, around in ((linear, lateral, angular), (0.0, 0.0, 0.0))
    )
    return Motion(controller, moving, resting)


def trajectory_motion(controller: str, joints: Sequence[str], positions: Sequence[float], seconds: float) -> Motion:
    """Return the motion of an arm to `positions`, at rest there after `seconds`; let go of, it brakes and is held."""
    point = TrajectoryPoint(positions=list(positions), velocities=[0.0] * len(positions), time_from_start=seconds)
    goal = SendTrajectory(
        controller=controller, joints=list(joints), points=[point], source=SOURCE, heartbeat=_HEARTBEAT_S
    )
    rest = CancelTrajectory(controller=controller, own=True, why="the page let go")
    return Motion(controller, goal, rest, TrajectoryHeartbeat())


def joint_motion(
    controller: str, values: Sequence[float], resting: Sequence[float], interface: str | None = None
) -> Motion:
    """Return the motion of joints to `values`; they rest at zero, or where they are if these are positions.

    `interface` is what the values are, where the controller may take something else by the time they come.
    """
    moved, rested = (
        CommandController(controller=controller, values=list(each), source=SOURCE, dead_man=True, interface=interface)
        for each in (values, resting)
    )
    return Motion(controller, moved, rested)


class DeadMan:
    """Ends a motion whose held button falls silent; `send(request)` is called with every command."""

    def __init__(self, send: Callable[[Command], object]) -> None:
        self._send = send
        self._driver: str | None = None
        self._motion: Motion | None = None
        self._heard = 0

    @property
    def driver(self) -> str | None:
        """The page that drives, None if nobody does."""
        return self._driver

    @property
    def deadline(self) -> int | None:
        """When `tick` is due, in ns."""
        return None if self._driver is None else self._heard + LET_GO_NS

    def hold(self, page: str, motion: Motion, now: int) -> bool:
        """Take note that a page holds a button; False if another one drives."""
        self.tick(now)
        if self._driver not in (None, page):
            return False
        before = self._motion
        if before is not None and before.controller != motion.controller:
            self._send(before.resting)
        goes_on = before is not None and motion.again is not None and before == motion
        self._driver, self._motion, self._heard = page, motion, now
        self._send(motion.again if goes_on and motion.again is not None else motion.moving)
        return True

    def tick(self, now: int) -> None:
        """Let go when nobody has held for too long."""
        if self._driver is not None and now - self._heard >= LET_GO_NS:
            self.let_go()

    def leave(self, page: str) -> None:
        """Let go, because the page has been closed; other pages' driving goes on."""
        if page == self._driver:
            self.let_go()

    def let_go(self) -> None:
        """End the motion now."""
        motion, self._driver, self._motion = self._motion, None, None
        if motion is not None:
            self._send(motion.resting)

    def forget(self) -> None:
        """End the motion without a word: STOP has ended it."""
        self._driver, self._motion = None, None
