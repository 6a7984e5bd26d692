"""Clocks, a queue of timers, and the kernel's timer.

Time is in monotonic ns. Deadlines are absolute, so that a late wake-up does not shift the next one. Timers with the
same deadline fire in the order of their creation. Cancelling is O(1): a cancelled timer stays in the heap without its
callback and is removed when it reaches the top, or when more than half of the heap is cancelled.

On Linux the reactor waits with timerfd(2), because an epoll timeout counts in whole milliseconds. A timer with equal
steps, such as the timer of a cycle, is set once as periodic, because reading it costs less than setting it again.
"""

from __future__ import annotations

import heapq
import os
import sys
import time
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable


_COMPACT_ABOVE: Final = 64  # with fewer cancelled timers a sweep is not worthwhile
_SECOND_NS: Final = 1_000_000_000
_TFD_TIMER_ABSTIME: Final = 1
_ONCE: Final = (1).to_bytes(8, sys.byteorder)  # expiration count, as read from the timer


class TimeSource(Protocol):
    """Source of monotonic time in ns."""

    @property
    def is_manual(self) -> bool:
        """Whether time advances only by explicit calls."""
        ...

    def now(self) -> int: ...


class MonotonicClock:
    """Monotonic clock of the machine, which timerfd also uses."""

    __slots__ = ()
    is_manual: Final = False
    now = staticmethod(time.monotonic_ns)


class ManualClock:
    """Clock for tests and simulations; the owner advances the time `now_ns`."""

    __slots__ = ("now_ns",)
    is_manual: Final = True

    def __init__(self, start: int = 0) -> None:
        self.now_ns = start

    def now(self) -> int:
        return self.now_ns


class Timer:
    """Timer that calls a callback once at a deadline; created by the reactor."""

    __slots__ = ("_callback", "deadline_ns", "queue")

    def __init__(self, queue: TimerQueue, deadline_ns: int, callback: Callable[[], object]) -> None:
        self._callback: Callable[[], object] | None = callback
        self.queue: TimerQueue | None = queue  # queue with this timer; None once it was removed
        self.deadline_ns = deadline_ns

    @property
    def active(self) -> bool:
        """Whether the timer has neither fired nor been cancelled."""
        return self._callback is not None

    def cancel(self) -> None:
        """Cancel the timer; no effect if it has fired or has been cancelled."""
        if self.take() is not None and self.queue is not None:
            self.queue.forget_one()

    def take(self) -> Callable[[], object] | None:
        """Return the callback and deactivate the timer; None if it is not active."""
        callback, self._callback = self._callback, None
        return callback


class TimerQueue:
    """Queue of waiting timers, earliest first."""

    __slots__ = ("_dead", "_heap", "_sequence")

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, Timer]] = []  # the number keeps the order of insertion among equal deadlines
        self._sequence = 0
        self._dead = 0

    def __len__(self) -> int:
        return len(self._heap) - self._dead

    def push(self, deadline_ns: int, callback: Callable[[], object]) -> Timer:
        """Create a timer and add it to the queue."""
        timer = Timer(self, deadline_ns, callback)
        self._sequence += 1
        heapq.heappush(self._heap, (deadline_ns, self._sequence, timer))
        return timer

    def next_deadline(self) -> int | None:
        """Return the deadline of the earliest active timer, or None."""
        heap = self._heap
        while heap:
            deadline_ns, _, timer = heap[0]
            if timer._callback is not None:  # noqa: SLF001 - `active`, without the call
                return deadline_ns
            heapq.heappop(heap)
            self._dead -= 1
        return None

    def pop_due(self, now: int) -> list[Timer]:
        """Remove and return the active timers that are due at `now`, in order; they can still be cancelled."""
        heap = self._heap
        if not heap or heap[0][0] > now:
            return []
        expired: list[Timer] = []
        while heap and heap[0][0] <= now:
            timer = heapq.heappop(heap)[2]
            timer.queue = None
            if timer.active:
                expired.append(timer)
            else:
                self._dead -= 1
        return expired

    def forget_one(self) -> None:
        """Count a cancelled timer; remove cancelled timers from the heap if they are more than half of it."""
        self._dead += 1
        if self._dead > _COMPACT_ABOVE and self._dead * 2 > len(self._heap):
            self._heap = [item for item in self._heap if item[2].active]
            heapq.heapify(self._heap)
            self._dead = 0

    def clear(self) -> None:
        """Remove all timers, which are then inactive."""
        heap, self._heap, self._dead = self._heap, [], 0
        for _, _, timer in heap:
            timer.take()


class Rhythm:
    """Detector of periodic deadlines: after two equal steps the kernel's timer is set as periodic."""

    __slots__ = ("_last_ns", "_step_ns", "interval_ns")

    def __init__(self) -> None:
        self.interval_ns = self._last_ns = self._step_ns = 0  # 0: single shot

    def continues(self, deadline_ns: int) -> bool:
        """Whether the next deadline (0: none) continues the period of the kernel's timer.

        If not, the timer must be set, with the period `interval_ns`.
        """
        step, before = deadline_ns - self._last_ns, self._step_ns
        self._last_ns, self._step_ns = deadline_ns, step
        if step == self.interval_ns and step > 0:
            return True
        self.interval_ns = step if step == before and step > 0 else 0
        return False


def _fired_once(fd: int) -> bool:
    """Read a periodic timer; return False unless it has fired exactly once; it must then be set again."""
    try:
        return os.read(fd, 8) == _ONCE
    except BlockingIOError:
        return False


class Alarm(Protocol):
    """Descriptor that becomes readable at one absolute time, for use in a selector."""

    def fileno(self) -> int: ...

    def set(self, deadline_ns: int | None) -> None:
        """Fire at `deadline_ns`, or never if None; an earlier firing is cleared, so that it need not be read."""
        ...

    def close(self) -> None: ...


class _OsAlarm:
    """Alarm with timerfd(2) of the module os, which exists in Python 3.13 and later."""

    def __init__(self) -> None:
        # looked up by name: older Pythons and their type stubs lack these
        self._fd: int = vars(os)["timerfd_create"](time.CLOCK_MONOTONIC, flags=os.O_NONBLOCK | os.O_CLOEXEC)
        self._settime = vars(os)["timerfd_settime_ns"]
        self._rhythm = Rhythm()

    def fileno(self) -> int:
        return self._fd

    def set(self, deadline_ns: int | None) -> None:
        # zero would disarm the timer: a time in the past becomes 1 ns
        initial = 0 if deadline_ns is None else max(deadline_ns, 1)
        if not (self._rhythm.continues(initial) and _fired_once(self._fd)):
            self._settime(self._fd, flags=_TFD_TIMER_ABSTIME, initial=initial, interval=self._rhythm.interval_ns)

    def close(self) -> None:
        os.close(self._fd)


class _CtypesAlarm:
    """Alarm with timerfd(2), called through the C library."""

    def __init__(self) -> None:
        import ctypes

        # PyDLL keeps the interpreter lock: the call never blocks, and releasing the lock costs more than the call
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
        if self._rhythm.continues(initial) and _fired_once(self._fd):
            return
        spec = self._spec
        spec[0], spec[1] = divmod(self._rhythm.interval_ns, _SECOND_NS)
        spec[2], spec[3] = divmod(initial, _SECOND_NS)
        self._settime(self._fd, _TFD_TIMER_ABSTIME, self._spec_address, None)

    def close(self) -> None:
        os.close(self._fd)


def open_alarm() -> Alarm | None:
    """Return the kernel's timer; None if it is not available, in which case the selector's timeout is used."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        return _OsAlarm() if hasattr(os, "timerfd_create") else _CtypesAlarm()
    except (OSError, AttributeError, ImportError):  # a sandbox or C library without timerfd, or no ctypes
        return None
