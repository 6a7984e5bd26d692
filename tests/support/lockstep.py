"""A whole program in virtual time: its threads take turns, and time jumps to what is due next when all of them wait.

What runs inside `lockstep()` is the program itself, with its sockets, its threads and its reactors; only what it waits
with is another: reading the clock, sleeping, `poll`, `select`, the reactor's wait, events and the join of threads. One
thread has the turn and keeps it until it waits. Then the next one goes on that has something to do, in the order in
which they were started; if none has, the clock goes to the earliest deadline. So nothing depends on how busy the
machine is, a process that stalls is late for nothing, and the same happens every time.

A thread that waits for what no thread in here does, another process say, waits in truth only
while nobody else is waiting for time.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from canopen_control.host import reactor, timer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


_SECOND = 1_000_000_000
_NEVER = 1 << 62
_REAL_SLEEP, _REAL_POLL, _REAL_SELECT = time.sleep, select.poll, select.select
_REAL_EVENT_WAIT, _REAL_CONDITION_WAIT = threading.Event.wait, threading.Condition.wait
_REAL_START, _REAL_JOIN = threading.Thread.start, threading.Thread.join
_LOOK_S = 0.001  # polling interval for events from outside


@dataclass
class _Wait:
    """What a thread waits for: whether it has come, and until when it waits."""

    ready: Callable[[], object]
    deadline: int = _NEVER


class Lockstep:
    """Who has the turn, who waits for what, and what time it is."""

    current: Lockstep | None = None

    def __init__(self) -> None:
        self.now_ns = time.monotonic_ns()
        self._wall = time.time_ns() - self.now_ns
        self._changed = threading.Condition()
        self._turn: threading.Thread | None = threading.current_thread()
        self._threads = {threading.current_thread(): None}
        self._waits: dict[threading.Thread, _Wait] = {}
        self._over = False
        self.interrupted = False  # by Ctrl-C, which the main thread raises in its next turn

    # -- clocks

    def now(self) -> int:
        return self.now_ns

    def seconds(self) -> float:
        return self.now_ns / _SECOND

    def wall_ns(self) -> int:
        return self.now_ns + self._wall

    def wall(self) -> float:
        return self.wall_ns() / _SECOND

    # -- turns

    def takes_part(self) -> bool:
        """Whether the thread that asks is one of those that take turns."""
        return threading.current_thread() in self._threads

    def wait(self, ready: Callable[[], Any], seconds: float | None) -> Any:
        """Let others have the turn until `ready` or the time is over; return what `ready` says then."""
        result = ready()
        if result or (seconds is not None and seconds <= 0):
            return result
        # rounded up: a wait for the last fraction of a nanosecond must advance the time
        deadline = _NEVER if seconds is None else self.now_ns + math.ceil(seconds * _SECOND)
        self._wait_for_turn(_Wait(ready, deadline), pass_on=True)
        return ready()

    def begin(self, thread: threading.Thread) -> None:
        """Take part in the turns from now on, as the last one."""
        with self._changed:
            self._threads[thread] = None
            self._waits[thread] = _Wait(lambda: True)

    def enter(self) -> None:
        """Wait for the first turn of the own thread."""
        self._wait_for_turn(_Wait(lambda: True), pass_on=False)

    def leave(self) -> None:
        """Take part no longer."""
        with self._changed:
            self._threads.pop(threading.current_thread(), None)
            self._pass_on()

    def end(self) -> None:
        """Let everybody wait in truth again."""
        with self._changed:
            self._over = True
            self._changed.notify_all()

    def _wait_for_turn(self, wait: _Wait, *, pass_on: bool) -> None:
        """Wait for the turn of this thread; Ctrl-C ends the wait, and is raised when the thread has its turn."""
        me = threading.current_thread()
        with self._changed:
            self._waits[me] = wait
            try:
                if pass_on:
                    self._pass_on()
                while self._turn is not me and not self._over:
                    _REAL_CONDITION_WAIT(self._changed)
            finally:
                del self._waits[me]
        if self.interrupted and me is threading.main_thread():
            self.interrupted = False
            raise KeyboardInterrupt
        if self._over:
            _REAL_SLEEP(_LOOK_S)

    def wake(self) -> None:
        """Let the threads that wait for their turn look again."""
        with self._changed:
            self._changed.notify_all()

    def interrupt(self, *_: object) -> None:
        """Handle SIGINT, in the main thread: at once if it has the turn, else as soon as it has."""
        if self._turn is threading.main_thread() or self._over:
            raise KeyboardInterrupt
        self.interrupted = True

    def _pass_on(self) -> None:
        """Give the turn to who has something to do; without any let time go on, or look for what comes from outside."""
        self._turn = None
        while not self._over:
            self._turn = next((thread for thread in self._threads if self._goes_on(thread)), None)
            if self._turn is not None:
                # the thread that had the turn is the last to get it again
                self._threads[self._turn] = self._threads.pop(self._turn)
                break
            due = min((wait.deadline for wait in self._waits.values()), default=_NEVER)
            if due != _NEVER:
                self.now_ns = max(self.now_ns, due)
            elif self._waits:
                _REAL_CONDITION_WAIT(self._changed, _LOOK_S)
            else:
                break
        self._changed.notify_all()

    def _goes_on(self, thread: threading.Thread) -> bool:
        wait = self._waits.get(thread)
        if wait is None:
            return False
        interrupted = self.interrupted and thread is threading.main_thread()
        return bool(interrupted or wait.deadline <= self.now_ns or wait.ready())


class _Poller:
    """What a reactor in lockstep waits with."""

    def __init__(self, steps: Lockstep, real: Any) -> None:
        self._steps, self._real = steps, real

    def poll(self, timeout: float | None, most: int) -> Any:
        return self._steps.wait(lambda: self._real.poll(0, most), timeout)

    def close(self) -> None:
        self._real.close()


class _Poll:
    """`select.poll` in lockstep."""

    def __init__(self) -> None:
        self._real = _REAL_POLL()
        self.register, self.modify, self.unregister = self._real.register, self._real.modify, self._real.unregister

    def poll(self, milliseconds: float | None = None) -> Any:
        steps = Lockstep.current
        if steps is None or not steps.takes_part():
            return self._real.poll(milliseconds)
        return steps.wait(lambda: self._real.poll(0), None if milliseconds is None else milliseconds / 1e3)


def _select(readers: Any, writers: Any, errors: Any, seconds: float | None = None) -> Any:
    steps = Lockstep.current
    if steps is None or not steps.takes_part():
        return _REAL_SELECT(readers, writers, errors, seconds)

    def ready() -> Any:
        result = _REAL_SELECT(readers, writers, errors, 0)
        return result if any(result) else None

    return steps.wait(ready, seconds) or ([], [], [])


def _sleep(seconds: float) -> None:
    steps = Lockstep.current
    if steps is None or not steps.takes_part():
        _REAL_SLEEP(seconds)
    else:
        steps.wait(lambda: False, seconds)


def _event_wait(event: threading.Event, timeout: float | None = None) -> bool:
    steps = Lockstep.current
    if steps is None or not steps.takes_part():
        return _REAL_EVENT_WAIT(event, timeout)
    return bool(steps.wait(event.is_set, timeout))


def _start(thread: threading.Thread) -> None:
    steps = Lockstep.current
    if steps is not None and steps.takes_part():
        steps.begin(thread)
        work = thread.run

        def run() -> None:
            steps.enter()
            try:
                work()
            finally:
                steps.leave()

        thread.run = run  # type: ignore[method-assign]
    _REAL_START(thread)


def _join(thread: threading.Thread, timeout: float | None = None) -> None:
    steps = Lockstep.current
    if steps is not None and steps.takes_part():
        if not steps.wait(lambda: thread not in steps._threads, timeout):
            return
        timeout = 10.0
    _REAL_JOIN(thread, timeout)


@contextlib.contextmanager
def lockstep() -> Iterator[Lockstep]:
    """Let this thread, and all that it starts in the block, live in virtual time; a block in a block is the same."""
    import pytest

    if Lockstep.current is not None:
        yield Lockstep.current
        return
    steps = Lockstep()
    poller = reactor.open_poller
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (
            ("monotonic", steps.seconds), ("monotonic_ns", steps.now), ("time", steps.wall),
            ("time_ns", steps.wall_ns), ("sleep", _sleep),
        ):  # fmt: skip
            patch.setattr(time, name, value)
        patch.setattr(timer.MonotonicClock, "now", staticmethod(steps.now))
        patch.setattr(reactor, "open_alarm", lambda: None)
        patch.setattr(reactor, "open_poller", lambda selector: _Poller(steps, poller(selector)))
        patch.setattr(select, "poll", _Poll)
        patch.setattr(select, "select", _select)
        patch.setattr(threading.Event, "wait", _event_wait)
        patch.setattr(threading.Thread, "start", _start)
        patch.setattr(threading.Thread, "join", _join)
        patch.setattr(Lockstep, "current", steps)
        handled = threading.current_thread() is threading.main_thread()
        before = signal.signal(signal.SIGINT, steps.interrupt) if handled else None
        try:
            yield steps
        finally:
            steps.end()
            if handled:
                signal.signal(signal.SIGINT, before)


def press_ctrl_c() -> None:
    """Send SIGINT to this process; in virtual time, wait in truth until the main thread has handled it.

    Otherwise time could go on before a busy machine lets the main thread do so. A signal that arrives just before the
    main thread begins to wait for its turn does not end that wait, so the thread is woken.
    """
    os.kill(os.getpid(), signal.SIGINT)
    if (steps := Lockstep.current) is not None:
        while not steps.interrupted:
            steps.wake()
            _REAL_SLEEP(_LOOK_S)


def typed_into(descriptor: int) -> None:
    """Wait, in truth, until what was typed has come through the kernel's terminal, which hands it on when it likes."""
    if Lockstep.current is not None:
        _REAL_SELECT([descriptor], [], [], 0.2)
