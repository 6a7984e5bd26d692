"""The time of a robot's controllers: this computer's, or of a simulated robot one that can be paused and stepped.

The law of the file: a simulated robot without buses lives on the grid of its cycles, each a period after the last one.
While it is paused its time stands, nothing moves and no command runs out; `step` lets a number of cycles happen, with
the commands that are in force. Who goes on afterwards finds no command left: the first motion has one that is newer.
Real drives have a time of their own, so that a robot on buses cannot be paused. Times in ns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.host.reactor import Reactor

__all__ = ["RobotClock"]


class RobotClock:
    """The clock of one robot; `simulated`: it lives on the grid of its cycles.

    `edge` is the time of the newest cycle, `stood_ns` for how long it has stood so far.
    """

    def __init__(self, reactor: Reactor, period_ns: int, *, simulated: bool) -> None:
        self.simulated = simulated
        self.paused = False
        self.edge = self.stood_ns = 0
        self._reactor, self._period_ns = reactor, period_ns
        self._resumed = False  # since the last edge
        self._steps = 0
        self._done: Callable[[str | None], None] | None = None

    def now(self) -> int:
        """Return the time, as commands and controllers count it."""
        return self.edge if self.paused or self._resumed else self._reactor.now() - self.stood_ns

    def of(self, now: int) -> int:
        """Return a time of this computer's clock as the robot counts it."""
        return now - self.stood_ns

    @property
    def hint(self) -> str | None:
        """What keeps the robot from moving, and what to do next, in one sentence; None while time goes on."""
        return "the simulation is paused; let it go on with: canopen-control world play" if self.paused else None

    # -- who says how it goes

    def pause(self) -> None:
        """Let time stand after the cycle that was; a second call does nothing."""
        self.paused = True

    def resume(self) -> None:
        """Let time go on where it stood; steps that are left are left out."""
        if self.paused:
            self._end("the simulation goes on: the steps that were left are no longer wanted")
            self.paused, self._resumed, self._steps = False, True, 0

    def step(self, count: int, done: Callable[[str | None], None]) -> None:
        """Let a number of cycles happen while it is paused; `done(error)` once they have."""
        self._end("other steps were asked for")
        self._steps, self._done = count, done

    def end(self) -> None:
        """Answer who waits for steps: the robot has stopped."""
        self._end("the robot has stopped")

    def _end(self, error: str | None) -> None:
        done, self._done = self._done, None
        if done is not None:
            done(error)

    # -- the cycle

    def take(self, edge: int) -> bool:
        """Take the edge of a cycle of this computer's clock; return whether the robot has one, which is `edge` then."""
        if self.paused:
            return self.take_step(edge)
        if self._resumed:
            self._resumed = False
            self.stood_ns = edge - (self.edge + self._period_ns)
        self.edge = edge - self.stood_ns
        return True

    def take_step(self, edge: int) -> bool:
        """Return whether there is one more cycle to step, which is taken."""
        if not self._steps:
            return False
        self._steps -= 1
        self.edge += self._period_ns
        self.stood_ns = edge - self.edge
        return True

    def tell_steps(self) -> None:
        """Answer who waits, when the last step was done."""
        if not self._steps:
            self._end(None)
