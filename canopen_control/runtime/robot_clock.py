"""Clock of a robot's controllers: this computer's, or for a simulated robot one that can be paused and stepped.

A simulated robot without buses lives on the grid of its cycles, each a period after the last one.
While it is paused its time stands, nothing moves and no command runs out; `step` lets a number of cycles happen, with
the commands that are in force. To continue afterwards clears all commands: the first motion needs a newer one.
Real drives have a time of their own, so that a robot on buses cannot be paused. Times in ns.

Stamps of commands and samples are Unix time, which may be set while the robot runs (NTP, a GPS that finds its
satellites, a person). `WallClock` follows it; everything else counts monotonic time, which cannot be set.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.host.reactor import Reactor


_STEP_NS: Final = 50_000_000  # more than NTP slews away unseen, and less than any command lives
_NOISE_NS: Final = 100_000  # smaller differences are of the measurement
_LOOK_NS: Final = 100_000_000


class WallClock:
    """Unix time of the reactor's monotonic clock; `offset_ns` is the difference.

    A clock of virtual time has none to follow: the offset stays as it was at the start, or as `fix` sets it.
    """

    def __init__(self, now: Callable[[], int], *, follows: bool, unix: Callable[[], int] | None = None) -> None:
        self._now, self._follows = now, follows
        self._unix = time.time_ns if unix is None else unix
        self.offset_ns = self._unix() - now()
        self.look_at = 0
        """When `look` is due again."""
        self._before: tuple[int, int] | None = (
            None  # the offset before the clock was set back, and until when it counts
        )

    def fix(self, offset_ns: int) -> None:
        """Fix the offset."""
        self.offset_ns, self._follows = offset_ns, False

    def look(self, now: int) -> int:
        """Follow the system clock, ten times a second; return its forward step in ns since the last call."""
        if now < self.look_at:
            return 0
        self.look_at = now + _LOOK_NS
        return self.follow()

    def follow(self) -> int:
        """Follow the clock now; return its step in ns, negative for a step back, 0 for none."""
        if not self._follows:
            return 0
        before = self._now()
        unix = self._unix()
        after = self._now()
        moved = unix - (before + after) // 2 - self.offset_ns
        uncertain = after - before + _NOISE_NS
        if -uncertain <= moved <= uncertain:
            return 0
        if moved <= -_STEP_NS:
            self._before = self.offset_ns, after - moved
        self.offset_ns += moved
        return moved if abs(moved) >= _STEP_NS else 0

    def made_at(self, unix_ns: int) -> int:
        """Return the creation time of a stamp; a future stamp may date from before the clock was set back."""
        now = self._now()
        created_ns = unix_ns - self.offset_ns
        if created_ns > now and self._before is not None:
            offset, until = self._before
            if now < until:
                return min(now, unix_ns - offset)
            self._before = None
        return created_ns


def step_words(moved_ns: int) -> str:
    """Return a sentence about a change of this computer's clock and its effect on stamps."""
    way = "forward" if moved_ns > 0 else "back"
    return (
        f"this computer's clock was set {way} by {abs(moved_ns) / 1e9:.3f} s; stamps are judged by the new time, and "
        "those of samples leap with it"
    )


class StepRequest(Protocol):
    """Receiver of the result of simulation steps."""

    def settle(self, error: str | None) -> None:
        """Report that the steps are complete, or why they were not."""
        ...


class RobotClock:
    """Clock of one robot; a `simulated` clock advances with the robot's cycles.

    `edge` is the time of the newest cycle, `stood_ns` for how long it has stood so far.
    """

    def __init__(self, reactor: Reactor, period_ns: int, *, simulated: bool) -> None:
        self.simulated = simulated
        self.paused = False
        self.edge = self.stood_ns = 0
        self._reactor, self._period_ns = reactor, period_ns
        self._resumed = False  # since the last edge
        self._steps = 0
        self._request: StepRequest | None = None

    def now(self) -> int:
        """Return the time for commands and controllers."""
        return self.edge if self.paused or self._resumed else self._reactor.now() - self.stood_ns

    def of(self, now: int) -> int:
        """Convert a time of this computer's clock to the robot's clock."""
        return now - self.stood_ns

    @property
    def hint(self) -> str | None:
        """Reason why the robot does not move, with the next step, in one sentence; None while time runs."""
        return "the simulation is paused; let it go on with: canopen-control world play" if self.paused else None

    # -- requests of users

    def pause(self) -> None:
        """Pause the clock after the present cycle; a second call does nothing."""
        self.paused = True

    def resume(self) -> None:
        """Resume the clock; remaining steps are dropped."""
        if self.paused:
            self._end("the simulation goes on: the steps that were left are no longer wanted")
            self.paused, self._resumed, self._steps = False, True, 0

    def step(self, count: int, request: StepRequest) -> None:
        """Run a number of cycles while paused; the `request` is answered after them."""
        self._end("other steps were asked for")
        self._steps, self._request = count, request

    def end(self) -> None:
        """Answer pending step requests, because the robot has stopped."""
        self._end("the robot has stopped")

    def _end(self, error: str | None) -> None:
        request, self._request = self._request, None
        if request is not None:
            request.settle(error)

    # -- the cycle

    def take(self, edge: int) -> bool:
        """Process an edge of this computer's clock; return whether the robot has a cycle now."""
        if self.paused:
            return self.take_step(edge)
        if self._resumed:
            self._resumed = False
            self.stood_ns = edge - (self.edge + self._period_ns)
        self.edge = edge - self.stood_ns
        return True

    def take_step(self, edge: int) -> bool:
        """Return whether a step is pending, and count it."""
        if not self._steps:
            return False
        self._steps -= 1
        self.edge += self._period_ns
        self.stood_ns = edge - self.edge
        return True

    def report_steps(self) -> None:
        """Answer the step request after its last cycle."""
        if not self._steps:
            self._end(None)
