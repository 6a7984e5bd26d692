"""Virtual time: one clock for many reactors, each of which wakes late as a process does and has an oscillator.

Nothing waits: time jumps to what happens next. Whatever is due at the same nanosecond happens in the order in which it
was put on the clock, so that the same seed does the same every time. Times in ns.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING, Final

from canopen_control.host.polling import MarkedSelector
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock

if TYPE_CHECKING:
    from collections.abc import Callable


START_NS: Final = 1_000_000_000  # a monotonic clock that has run for a while, as any
_BILLION: Final = 1_000_000_000
_NEVER: Final = 1 << 62


@dataclass(frozen=True, slots=True)
class Timing:
    """How late a process wakes: at least `latency_ns`, up to `jitter_ns` later, and seldom up to `spike_ns`.

    `ppm` is by how much its oscillator is fast.
    """

    latency_ns: int = 0
    jitter_ns: int = 0
    spike_ns: int = 0
    ppm: float = 0.0


_SPIKES: Final = 0.0005  # of all wake-ups


class VirtualTime:
    """The clock that jumps; `now_ns` is the time."""

    __slots__ = ("_heap", "_sequence", "now_ns")

    def __init__(self) -> None:
        self.now_ns = START_NS
        self._heap: list[tuple[int, int, Callable[[], object]]] = []
        self._sequence = 0

    def at(self, when_ns: int, callback: Callable[[], object]) -> None:
        """Call `callback` once, at `when_ns`, or now where that is over."""
        self._sequence += 1
        now = self.now_ns
        heapq.heappush(self._heap, (when_ns if when_ns > now else now, self._sequence, callback))

    def later(self, delay_ns: int, callback: Callable[[], object]) -> None:
        """Call `callback` once, `delay_ns` from now."""
        self.at(self.now_ns + delay_ns, callback)

    def next_ns(self) -> int | None:
        """Return when something happens next, None: nothing will."""
        return self._heap[0][0] if self._heap else None

    def run_until(self, limit_ns: int) -> None:
        """Let happen what is due up to `limit_ns`, which is the time then."""
        heap, pop = self._heap, heapq.heappop
        while heap and heap[0][0] <= limit_ns:
            self.now_ns, _, callback = pop(heap)
            callback()
        self.now_ns = max(self.now_ns, limit_ns)


class Actor:
    """A process in virtual time: its reactor, its clock, how late it wakes; it may be stalled, and end for good.

    `stalled_until` is until when it does nothing.
    """

    def __init__(self, time: VirtualTime, name: str, timing: Timing, seed: str) -> None:
        self.name, self.timing = name, timing
        self._time = time
        self._random = Random(f"{seed}/{name}").random
        self._rate = round(timing.ppm * 1000)  # parts of 10^9
        self.clock = ManualClock(self.local(time.now_ns))
        self.selector = MarkedSelector()
        self.reactor = Reactor(self.clock, self.selector)
        self._wake_at = self._alarm_at = _NEVER
        self._deadline: int | None = None  # for which the alarm is set, by its own clock
        self.stalled_until = 0
        self._ended = False

    def local(self, now_ns: int) -> int:
        """Return what its own clock shows."""
        return now_ns + now_ns * self._rate // _BILLION

    def arrived(self) -> None:
        """Wake it for something that is there now; one that is about to wake anyway finds it then."""
        if self._wake_at == _NEVER:
            self._wake_at = self._woken_by(self._time.now_ns)
            self._time.at(self._wake_at, self._woken)

    def call(self, work: Callable[[], object]) -> None:
        """Have something done on its reactor when it wakes, as a client's request."""
        self.reactor.call_soon(work)
        self.arrived()

    def stall(self, duration_ns: int) -> None:
        """Let it do nothing for a while, as a process that is stopped or gets no processor."""
        self.stalled_until = max(self.stalled_until, self._time.now_ns + duration_ns)

    def end(self) -> None:
        """End it as SIGKILL does: nothing of it runs any more."""
        if not self._ended:
            self._ended = True
            self.reactor.close()

    def _woken_by(self, due_ns: int) -> int:
        """Return when it wakes for what is due, late as processes are."""
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
        if self._alarm_at == self._time.now_ns:  # else it was set anew since
            self._deadline, self._alarm_at = None, _NEVER
            self._serve()

    def _serve(self) -> None:
        """Do all that is there and due, and set the alarm for what comes next."""
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
                shared = -(-deadline * _BILLION // (_BILLION + rate))  # when its own clock has just passed it
                self._alarm_at = self._woken_by(shared)
                self._time.at(self._alarm_at, self._rung)
