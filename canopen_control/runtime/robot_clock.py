"""Clocks of a robot: the controllers' time, which a simulation can pause, and Unix time for stamps.

The time of a simulated robot without buses advances by one period per cycle. While the simulation is paused, the time
does not advance, nothing moves and no command times out; `step` executes a number of cycles with the present commands.
Resuming clears all commands: only newer commands move the robot. Real drives have their own time, so that a robot on
buses cannot be paused. All times are in ns.

Stamps of commands and samples are Unix time, which may be set while the robot runs (by NTP, a GPS receiver or a user).
`WallClock` follows the Unix time; everything else uses monotonic time, which cannot be set.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.host.reactor import Reactor


_STEP_NS: Final = 50_000_000  # more than NTP slews between checks, less than any command timeout
_NOISE_NS: Final = 100_000  # smaller differences are measurement noise
_FOLLOW_NS: Final = 100_000_000


class WallClock:
    """Conversion between the reactor's monotonic time and Unix time; `offset_ns` is the difference.

    If the reactor runs in virtual time, `follows` is False: the offset stays as at the start, or as set by `fix`.
    """

    def __init__(self, now: Callable[[], int], *, follows: bool, unix: Callable[[], int] | None = None) -> None:
        self._now, self._follows = now, follows
        self._unix = time.time_ns if unix is None else unix
        self.offset_ns = self._unix() - now()
        self.next_follow = 0
        """Monotonic time at which `follow_if_due` is next due."""
        # the offset before the clock was set back, and the time until which this offset is used
        self._before: tuple[int, int] | None = None

    def fix(self, offset_ns: int) -> None:
        """Set a constant offset, and stop following the system clock."""
        self.offset_ns, self._follows = offset_ns, False

    def follow_if_due(self, now: int) -> int:
        """Call `follow` if due, ten times a second; return a clock step in ns, or 0."""
        if now < self.next_follow:
            return 0
        self.next_follow = now + _FOLLOW_NS
        return self.follow()

    def follow(self) -> int:
        """Adjust the offset to the system clock; return a step of that clock in ns (negative: set back), or 0."""
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
        """Convert a Unix stamp to monotonic time, including stamps from before the system clock was set back."""
        now = self._now()
        created_ns = unix_ns - self.offset_ns
        if created_ns > now and self._before is not None:
            offset, until = self._before
            if now < until:
                return min(now, unix_ns - offset)
            self._before = None
        return created_ns


def step_words(moved_ns: int) -> str:
    """Return a sentence about a step of this computer's clock and the effect on stamps."""
    way = "forward" if moved_ns > 0 else "back"
    return (
        f"this computer's clock was set {way} by {abs(moved_ns) / 1e9:.3f} s; stamps of commands are compared with "
        "the new time, and stamps of samples change by this step"
    )


class StepRequest(Protocol):
    """Request for simulation steps; notified when the steps are complete or cancelled."""

    def settle(self, error: str | None) -> None:
        """Handle the completion of the steps, or their failure for the reason `error`."""
        ...


class RobotClock:
    """Clock of a robot's controllers; a `simulated` clock advances with the cycles and can be paused.

    `edge` is the time of the newest cycle, `stood_ns` is how far pauses have delayed the clock.
    """

    def __init__(self, reactor: Reactor, period_ns: int, *, simulated: bool) -> None:
        self.simulated = simulated
        self.paused = False
        self.edge = self.stood_ns = 0
        self._reactor, self._period_ns = reactor, period_ns
        self._resumed = False  # True if resumed since the last edge
        self._steps = 0
        self._request: StepRequest | None = None

    def now(self) -> int:
        """Return the current time for controllers and commands."""
        return self.edge if self.paused or self._resumed else self._reactor.now() - self.stood_ns

    def of(self, now: int) -> int:
        """Convert a time of the reactor to the robot's clock."""
        return now - self.stood_ns

    @property
    def hint(self) -> str | None:
        """Sentence with the resume command while the simulation is paused, else None."""
        return "the simulation is paused; resume it: canopen-control world play" if self.paused else None

    # -- requests of users

    def pause(self) -> None:
        """Pause the clock from the next cycle on; a second call does nothing."""
        self.paused = True

    def resume(self) -> None:
        """Resume the paused clock; a pending step request fails."""
        if self.paused:
            self._end("the simulation was resumed, and the remaining steps were cancelled")
            self.paused, self._resumed, self._steps = False, True, 0

    def step(self, count: int, request: StepRequest) -> None:
        """Execute `count` cycles while paused; `request` is notified after the last cycle, or when cancelled."""
        self._end("the steps were replaced by another request")
        self._steps, self._request = count, request

    def end(self) -> None:
        """Fail a pending step request, because the robot has stopped."""
        self._end("the robot has stopped")

    def _end(self, error: str | None) -> None:
        request, self._request = self._request, None
        if request is not None:
            request.settle(error)

    # -- the cycle

    def take(self, edge: int) -> bool:
        """Advance the clock at an edge of the pacer; return whether to execute a cycle."""
        if self.paused:
            return self.take_step(edge)
        if self._resumed:
            self._resumed = False
            self.stood_ns = edge - (self.edge + self._period_ns)
        self.edge = edge - self.stood_ns
        return True

    def take_step(self, edge: int) -> bool:
        """Advance the clock by one period if a requested step is pending; return whether it was."""
        if not self._steps:
            return False
        self._steps -= 1
        self.edge += self._period_ns
        self.stood_ns = edge - self.edge
        return True

    def report_steps(self) -> None:
        """Notify the pending step request after the last step."""
        if not self._steps:
            self._end(None)
