"""Virtual time: one clock for many reactors, each with its own wake-up delay and oscillator.

Nothing waits in real time: the clock advances at once to the next event. Events at the same nanosecond occur in the
order of their scheduling, so that the same seed gives the same result. Times are in ns.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING, Final

from canopen_control.host.reactor import MarkedSelector, Reactor
from canopen_control.host.timer import ManualClock

if TYPE_CHECKING:
    from collections.abc import Callable


START_NS: Final = 1_000_000_000  # a monotonic clock never starts at 0
_BILLION: Final = 1_000_000_000
_NEVER: Final = 1 << 62


@dataclass(frozen=True, slots=True)
class Timing:
    """Wake-up delay of a process: `latency_ns`, plus up to `jitter_ns`, rarely up to `spike_ns`.

    `ppm` is the frequency error of its oscillator, positive if it is fast.
    """

    latency_ns: int = 0
    jitter_ns: int = 0
    spike_ns: int = 0
    ppm: float = 0.0


_SPIKES: Final = 0.0005  # fraction of all wake-ups


class VirtualTime:
    """Simulated clock that jumps from event to event."""

    __slots__ = ("_heap", "_limit_ns", "_sequence", "now_ns")

    def __init__(self) -> None:
        self.now_ns = START_NS
        self._heap: list[tuple[int, int, Callable[[], object]]] = []
        self._sequence = 0
        self._limit_ns = START_NS

    def at(self, when_ns: int, callback: Callable[[], object]) -> None:
        """Schedule a callback for `when_ns`, or for the current time if `when_ns` has passed."""
        self._sequence += 1
        now = self.now_ns
        heapq.heappush(self._heap, (when_ns if when_ns > now else now, self._sequence, callback))

    def later(self, delay_ns: int, callback: Callable[[], object]) -> None:
        """Schedule a callback `delay_ns` from now."""
        self.at(self.now_ns + delay_ns, callback)

    def next_ns(self) -> int | None:
        """Return the time of the next event, or None if there is none."""
        return self._heap[0][0] if self._heap else None

    def jump(self, when_ns: int) -> bool:
        """Advance to `when_ns` within a callback; return False, without effect, if an event or the limit is earlier."""
        heap = self._heap
        if when_ns > self._limit_ns or (heap and heap[0][0] <= when_ns):
            return False
        self.now_ns = when_ns
        return True

    def run_until(self, limit_ns: int) -> None:
        """Run all events up to `limit_ns`, then set the clock to `limit_ns`."""
        heap, pop = self._heap, heapq.heappop
        self._limit_ns = limit_ns
        while heap and heap[0][0] <= limit_ns:
            self.now_ns, _, callback = pop(heap)
            callback()
        self.now_ns = max(self.now_ns, limit_ns)


class Actor:
    """Process in virtual time with a reactor, a clock and wake-up delays.

    `stalled_until` is the end of a stall.
    """

    def __init__(self, time: VirtualTime, name: str, timing: Timing, seed: str) -> None:
        self.name, self.timing = name, timing
        self._time = time
        self._random = Random(f"{seed}/{name}").random
        self._rate = round(timing.ppm * 1000)  # in parts of 10^9
        self.clock = ManualClock(self.local(time.now_ns))
        self.selector = MarkedSelector()
        self.reactor = Reactor(self.clock, self.selector)
        self._wake_at = self._alarm_at = _NEVER
        self._deadline: int | None = None  # time of the alarm, by its own clock
        self.stalled_until = 0
        self._ended = False

    def local(self, now_ns: int) -> int:
        """Return the reading of the process's own clock at the virtual time `now_ns`."""
        return now_ns + now_ns * self._rate // _BILLION

    def arrived(self) -> None:
        """Schedule a wake-up for new data, unless one is already scheduled."""
        if self._wake_at == _NEVER:
            self._wake_at = self._woken_by(self._time.now_ns)
            self._time.at(self._wake_at, self._woken)

    def call(self, work: Callable[[], object]) -> None:
        """Call a function in the process's reactor, as a client request would."""
        self.reactor.call_soon(work)
        self.arrived()

    def stall(self, duration_ns: int) -> None:
        """Stall the process for `duration_ns`, as if it got no CPU time."""
        self.stalled_until = max(self.stalled_until, self._time.now_ns + duration_ns)

    def end(self) -> None:
        """End the process, as SIGKILL would: no further callback runs."""
        if not self._ended:
            self._ended = True
            self.reactor.close()

    def _woken_by(self, due_ns: int) -> int:
        """Return the wake-up time for an event due at `due_ns`, with a random delay."""
        timing = self.timing
        earliest = (due_ns if due_ns > self.stalled_until else self.stalled_until) + timing.latency_ns
        if not timing.jitter_ns:
            return earliest
        drawn = self._random()
        return earliest + int(timing.spike_ns * drawn / _SPIKES if drawn < _SPIKES else timing.jitter_ns * drawn)

    def _woken(self) -> None:
        self._wake_at = _NEVER
        self._serve()

    def _rung(self) -> None:
        if self._alarm_at == self._time.now_ns:  # otherwise it was set again
            self._deadline, self._alarm_at = None, _NEVER
            self._serve()

    def _serve(self) -> None:
        """Run the reactor for all ready and due work, and set the alarm for the next deadline."""
        now = self._time.now_ns
        if self._ended:
            return
        if now < self.stalled_until:
            self.arrived()
            return
        rate = self._rate
        self.clock.now_ns = now + now * rate // _BILLION
        deadline = self.reactor.serve()
        if deadline != self._deadline and not self._ended:
            self._deadline, self._alarm_at = deadline, _NEVER
            if deadline is not None:
                # virtual time at which the process's own clock has just passed the deadline
                shared = -(-deadline * _BILLION // (_BILLION + rate))
                self._alarm_at = self._woken_by(shared)
                self._time.at(self._alarm_at, self._rung)
