"""Clocks, timers and the kernel's timer.

Time is monotonic nanoseconds everywhere. Deadlines are absolute, so that a late wake-up never shifts the next one.
Timers with the same deadline fire in the order in which they were made. Cancelling is O(1): a cancelled timer stays in
the heap without its callback and is thrown away when it surfaces, or when more than half of the heap is dead.

The wait itself goes through timerfd(2) where Linux has it: an epoll timeout counts in whole milliseconds. A timer that
rings at equal steps, as that of a cycle, is set once: a read, which costs less, lets it ring on.
"""

from __future__ import annotations

import heapq
import os
import sys
import time
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable


_COMPACT_ABOVE: Final = 64  # dead timers that are not worth a sweep
_SECOND_NS: Final = 1_000_000_000
_TFD_TIMER_ABSTIME: Final = 1
_ONCE: Final = (1).to_bytes(8, sys.byteorder)  # how often a timer has rung, as it is read


class TimeSource(Protocol):
    """A source of monotonic nanoseconds."""

    @property
    def is_manual(self) -> bool:
        """Whether time moves only when somebody sets it."""
        ...

    def now(self) -> int:
        """Return the time in nanoseconds."""
        ...


class MonotonicClock:
    """The machine's monotonic clock, the one that timerfd uses too."""

    __slots__ = ()
    is_manual: Final = False
    now = staticmethod(time.monotonic_ns)


class ManualClock:
    """A clock for tests: `now_ns` is the time, and whoever holds the clock moves it."""

    __slots__ = ("now_ns",)
    is_manual: Final = True

    def __init__(self, start: int = 0) -> None:
        self.now_ns = start

    def now(self) -> int:
        """Return `now_ns`."""
        return self.now_ns


class Timer:
    """One callback at one moment; made by the reactor, of use once."""

    __slots__ = ("_callback", "deadline_ns", "queue")

    def __init__(self, queue: TimerQueue, deadline_ns: int, callback: Callable[[], object]) -> None:
        self._callback: Callable[[], object] | None = callback
        self.queue: TimerQueue | None = queue  # where it waits; None once it was taken out
        self.deadline_ns = deadline_ns

    @property
    def active(self) -> bool:
        """Whether it is still going to fire."""
        return self._callback is not None

    def cancel(self) -> None:
        """Never fire; a no-op on a timer that has fired or was cancelled."""
        if self.take() is not None and self.queue is not None:
            self.queue.forget_one()

    def take(self) -> Callable[[], object] | None:
        """Hand over the callback, once: the timer is spent afterwards."""
        callback, self._callback = self._callback, None
        return callback


class TimerQueue:
    """The timers that wait, earliest first."""

    __slots__ = ("_dead", "_heap", "_sequence")

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, Timer]] = []  # the number keeps the order of insertion among equals
        self._sequence = 0
        self._dead = 0

    def __len__(self) -> int:
        return len(self._heap) - self._dead

    def push(self, deadline_ns: int, callback: Callable[[], object]) -> Timer:
        """Make a timer and let it wait."""
        timer = Timer(self, deadline_ns, callback)
        self._sequence += 1
        heapq.heappush(self._heap, (deadline_ns, self._sequence, timer))
        return timer

    def next_deadline(self) -> int | None:
        """Return when the earliest active timer is due."""
        heap = self._heap
        while heap:
            deadline_ns, _, timer = heap[0]
            if timer._callback is not None:  # noqa: SLF001 - `active`, without the call
                return deadline_ns
            heapq.heappop(heap)
            self._dead -= 1
        return None

    def pop_due(self, now: int) -> list[Timer]:
        """Take out the active timers that are due at `now`, in order; a later cancel of one of them still counts."""
        heap = self._heap
        if not heap or heap[0][0] > now:
            return []
        due: list[Timer] = []
        while heap and heap[0][0] <= now:
            timer = heapq.heappop(heap)[2]
            timer.queue = None
            if timer.active:
                due.append(timer)
            else:
                self._dead -= 1
        return due

    def forget_one(self) -> None:
        """Note that one timer was cancelled; sweep when the dead outnumber the living."""
        self._dead += 1
        if self._dead > _COMPACT_ABOVE and self._dead * 2 > len(self._heap):
            self._heap = [item for item in self._heap if item[2].active]
            heapq.heapify(self._heap)
            self._dead = 0

    def clear(self) -> None:
        """Forget every timer; none of them is active afterwards."""
        heap, self._heap, self._dead = self._heap, [], 0
        for _, _, timer in heap:
            timer.take()


class Rhythm:
    """Which deadlines the kernel's timer meets by itself: those of a rhythm that two equal steps have shown."""

    __slots__ = ("_last_ns", "_step_ns", "interval_ns")

    def __init__(self) -> None:
        self.interval_ns = self._last_ns = self._step_ns = 0  # 0: it rings once

    def goes_on(self, deadline_ns: int) -> bool:
        """Whether the next deadline, 0 for none, is the rhythm's; else the timer is to be set, to `interval_ns` too."""
        step, before = deadline_ns - self._last_ns, self._step_ns
        self._last_ns, self._step_ns = deadline_ns, step
        if step == self.interval_ns and step > 0:
            return True
        self.interval_ns = step if step == before and step > 0 else 0
        return False


def _rings_on(fd: int) -> bool:
    """Silence a timer that has rung and let it ring in its rhythm; False: it has to be set, it rang not once by now."""
    try:
        return os.read(fd, 8) == _ONCE
    except BlockingIOError:
        return False


class Alarm(Protocol):
    """A file descriptor that becomes readable at one absolute moment, for a selector to wait on."""

    def fileno(self) -> int:
        """Return the descriptor."""
        ...

    def set(self, deadline_ns: int | None) -> None:
        """Ring at `deadline_ns`, or never; forgets an earlier ringing, so that nothing has to be read."""
        ...

    def close(self) -> None:
        """Give the descriptor back."""
        ...


class _OsAlarm:
    """timerfd(2) as Python 3.13 offers it."""

    def __init__(self) -> None:
        # looked up by name: older Pythons lack these, and their type stubs too
        self._fd: int = vars(os)["timerfd_create"](time.CLOCK_MONOTONIC, flags=os.O_NONBLOCK | os.O_CLOEXEC)
        self._settime: Callable[..., object] = vars(os)["timerfd_settime_ns"]
        self._rhythm = Rhythm()

    def fileno(self) -> int:
        return self._fd

    def set(self, deadline_ns: int | None) -> None:
        # zero would disarm: a moment in the past is one nanosecond after the start of time
        initial = 0 if deadline_ns is None else max(deadline_ns, 1)
        if not (self._rhythm.goes_on(initial) and _rings_on(self._fd)):
            self._settime(self._fd, flags=_TFD_TIMER_ABSTIME, initial=initial, interval=self._rhythm.interval_ns)

    def close(self) -> None:
        os.close(self._fd)


class _CtypesAlarm:
    """timerfd(2) through the C library."""

    def __init__(self) -> None:
        import ctypes

        # PyDLL keeps the interpreter lock: the call never blocks, and giving the lock away costs more than the call
        libc = ctypes.PyDLL(None, use_errno=True)
        self._settime = libc.timerfd_settime
        self._fd = int(libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC))
        if self._fd < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")
        self._rhythm = Rhythm()
        # struct itimerspec: interval seconds and nanoseconds, value seconds and nanoseconds
        self._spec = (ctypes.c_long * 4)()
        self._settime.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
        self._spec_address = ctypes.addressof(self._spec)

    def fileno(self) -> int:
        return self._fd

    def set(self, deadline_ns: int | None) -> None:
        initial = 0 if deadline_ns is None else max(deadline_ns, 1)
        if self._rhythm.goes_on(initial) and _rings_on(self._fd):
            return
        spec = self._spec
        spec[0], spec[1] = divmod(self._rhythm.interval_ns, _SECOND_NS)
        spec[2], spec[3] = divmod(initial, _SECOND_NS)
        self._settime(self._fd, _TFD_TIMER_ABSTIME, self._spec_address, None)

    def close(self) -> None:
        os.close(self._fd)


def open_alarm() -> Alarm | None:
    """Return the kernel's timer, or None where there is none: the selector's own timeout has to do then."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        return _OsAlarm() if hasattr(os, "timerfd_create") else _CtypesAlarm()
    except (OSError, AttributeError, ImportError):  # a sandbox without timerfd, a C library without it, no ctypes
        return None
