"""Event loop of a thread for descriptors, queued calls, and timers with absolute deadlines.

A turn processes the ready descriptors, then the calls queued by `call_soon` and `call_threadsafe`, then the timers that
are due, each in a fixed order. What callbacks add waits for the next turn, so that neither a busy descriptor nor a
timer that re-arms itself starves the other. Callbacks must not block. An exception is counted in `errors` and passed to
`on_error`, and the loop continues; only KeyboardInterrupt and SystemExit end it.

With a `ManualClock` the loop never waits for time: when nothing is ready the clock advances to the next deadline. A
program then behaves identically in every run.

A poller reports the descriptors that are ready: epoll, or an in-process poller for simulations, whose readiness costs
no system call.
"""

from __future__ import annotations

import contextlib
import os
import select
import selectors
import signal
import socket
import sys
import traceback
from collections import deque
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias, cast

from canopen_control.errors import LocalProtocolError
from canopen_control.host.timer import ManualClock, MonotonicClock, Timer, TimerQueue, TimeSource, open_alarm

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from types import TracebackType


_FIRST: Final = 1 << 30  # larger than any descriptor
_READY: Final = getattr(select, "EPOLLIN", 1)


class Poller(Protocol):
    """Source of ready descriptors."""

    def poll(self, timeout: float | None, maxevents: int, /) -> Sequence[tuple[int, int]]:
        """Return ready descriptors with their event masks, as epoll does."""

    def close(self) -> None: ...


def open_poller(selector: selectors.BaseSelector) -> Poller | None:
    """Return a poller that is faster than `selector`, or None.

    The epoll poller has its own descriptor, so that the poller and the selector can be closed separately.
    """
    if isinstance(selector, MarkedSelector):
        return selector
    if sys.platform == "linux" and isinstance(selector, selectors.EpollSelector):
        return select.epoll.fromfd(os.dup(selector.fileno()))
    return None


class MarkedSelector(selectors.BaseSelector):
    """In-process selector that returns the numbers that were set ready, in that order, and never waits.

    `allocate` returns the numbers, which take the place of descriptors. Real descriptors may be registered too, and are
    never ready. `marked` contains the ready numbers, whether they are registered or not.
    """

    def __init__(self) -> None:
        self._keys: dict[int, selectors.SelectorKey] = {}
        self.marked: dict[int, None] = {}
        self._next = _FIRST

    def allocate(self) -> int:
        """Return an unused number to be used in place of a descriptor."""
        self._next += 1
        return self._next

    def set_ready(self, number: int) -> bool:
        """Make a number readable until `clear_ready`; return whether it is registered with a reactor."""
        self.marked[number] = None
        return number in self._keys

    def clear_ready(self, number: int) -> None:
        """Make a number unreadable; no effect if it is not ready."""
        self.marked.pop(number, None)

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:  # noqa: ANN401 - selectors' own types
        key = self._keys[fileobj] = selectors.SelectorKey(fileobj, fileobj, events, data)
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:  # noqa: ANN401 - as above
        return self._keys.pop(fileobj)

    def select(self, _timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Return the ready numbers that are registered for reading; numbers are never ready for writing."""
        keys = self._keys
        return [
            (key, selectors.EVENT_READ)
            for number in self.marked
            if (key := keys.get(number)) is not None and key.events & selectors.EVENT_READ
        ]

    def poll(self, _timeout: float | None, _most: int) -> Sequence[tuple[int, int]]:
        """Return the numbers that are registered and ready, each with the mask for readable, as epoll does."""
        marked, keys = self.marked, self._keys
        if not marked:
            return ()
        if len(marked) == 1:
            [number] = marked
            return ((number, _READY),) if number in keys else ()
        return [(number, _READY) for number in marked if number in keys]

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        return self._keys

    def close(self) -> None:
        self._keys.clear()
        self.marked.clear()


_READ: Final = selectors.EVENT_READ
_WRITE: Final = selectors.EVENT_WRITE
# epoll reports an error or a hang-up as readable and writable, so that either callback sees it
_READABLE: Final = ~getattr(select, "EPOLLOUT", 4)
_WRITABLE: Final = ~getattr(select, "EPOLLIN", 1)
_FLAGS: Final = {_READ: ~_WRITABLE, _WRITE: ~_READABLE, _READ | _WRITE: ~_WRITABLE | ~_READABLE}
_WAKE: Final = b"\0"  # signal number 0 does not exist
_PRINTED_ERRORS: Final = 20  # limits the log if a callback fails in every cycle


class HasFileno(Protocol):
    """Object with a descriptor, such as a socket or a port."""

    def fileno(self) -> int: ...


FileLike: TypeAlias = int | HasFileno


class _Watch:
    """Callbacks of one descriptor, and the turn in which it was registered."""

    __slots__ = ("on_readable", "on_writable", "since")

    def __init__(self, since: int) -> None:
        self.since = since
        self.on_readable: Callable[[], object] | None = None
        self.on_writable: Callable[[], object] | None = None

    @property
    def events(self) -> int:
        return (_READ if self.on_readable else 0) | (_WRITE if self.on_writable else 0)

    def set(self, event: int, callback: Callable[[], object] | None) -> None:
        if event == _READ:
            self.on_readable = callback
        else:
            self.on_writable = callback


def _fd_of(fileobj: FileLike) -> int:
    return fileobj if isinstance(fileobj, int) else fileobj.fileno()


def _nop(*_args: object) -> None:
    """Do nothing; the signal number arrives through the wake-up descriptor."""


class Reactor:
    """Event loop of a process, or of one of its threads.

    `errors` counts exceptions of callbacks; `on_error` is called with each exception (default: print the first twenty
    to stderr). All methods except `call_threadsafe` must be called on the loop's own thread.
    """

    def __init__(self, clock: TimeSource | None = None, selector: selectors.BaseSelector | None = None) -> None:
        self.clock: TimeSource = MonotonicClock() if clock is None else clock
        self.now: Callable[[], int] = self.clock.now
        """Function that returns the clock's time in ns."""
        self.errors = 0
        self.on_error: Callable[[BaseException], None] = self._print_first_errors
        self._selector: selectors.BaseSelector = selector or selectors.DefaultSelector()
        self._watches: dict[int, _Watch] = {}
        self._timers = TimerQueue()
        self._soon: deque[Callable[[], object]] = deque()
        self._from_threads: deque[Callable[[], object]] = deque()
        self._epoll = open_poller(self._selector)
        self._poll = self._select if self._epoll is None else self._epoll.poll
        self._marked = selector.marked if isinstance(selector, MarkedSelector) else None
        self._turns = 0
        self._alarm = None if self.clock.is_manual else open_alarm()
        self._alarm_at: int | None = None
        self._woken = False
        self._signals: dict[int, Callable[[], object]] = {}
        self._restored = contextlib.ExitStack()  # restores the signal handlers
        self._running = self._stopping = self._closed = False
        self._wake_in, self._wake_out = socket.socketpair()
        self._open()

    def _open(self) -> None:
        self._wake_in.setblocking(False)
        self._wake_out.setblocking(False)
        self.add_reader(self._wake_in, self._on_wake)
        if self._alarm is not None:
            # The alarm is set before every wait, which clears an earlier firing: it need not be read.
            self._selector.register(self._alarm.fileno(), _READ, None)

    def __enter__(self) -> Reactor:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    # -- descriptors

    def add_reader(self, fileobj: FileLike, callback: Callable[[], object]) -> None:
        """Call `callback` in every iteration in which the descriptor is readable; an earlier reader is replaced."""
        self._change(_fd_of(fileobj), _READ, callback)

    def remove_reader(self, fileobj: FileLike) -> None:
        """Remove the reader at once; no effect without a reader. Call this before closing the descriptor."""
        self._change(_fd_of(fileobj), _READ, None)

    def add_writer(self, fileobj: FileLike, callback: Callable[[], object]) -> None:
        """Call `callback` in every iteration in which the descriptor is writable; an earlier writer is replaced."""
        self._change(_fd_of(fileobj), _WRITE, callback)

    def remove_writer(self, fileobj: FileLike) -> None:
        """Remove the writer at once; no effect without a writer. Call this before closing the descriptor."""
        self._change(_fd_of(fileobj), _WRITE, None)

    def _change(self, fd: int, event: int, callback: Callable[[], object] | None) -> None:
        watch = self._watches.get(fd)
        if watch is None:
            if callback is not None:
                self._register(fd, event, callback)
        elif callback is not None or watch.events & event:
            watch.set(event, callback)
            self._update(fd, event, watch)

    def _register(self, fd: int, event: int, callback: Callable[[], object]) -> None:
        watch = _Watch(self._turns)
        watch.set(event, callback)
        self._selector.register(fd, event, watch)
        self._watches[fd] = watch

    def _update(self, fd: int, event: int, watch: _Watch) -> None:
        """Update a descriptor's events in the selector, even if the descriptor was closed without being removed."""
        if not watch.events:
            del self._watches[fd]
            self._selector.unregister(fd)
        elif watch.events == self._selector.get_key(fd).events:
            self._selector.unregister(fd)  # `modify` would not detect that the kernel has removed it
            self._selector.register(fd, watch.events, watch)
        else:
            self._modify(fd, event, watch)

    def _modify(self, fd: int, event: int, watch: _Watch) -> None:
        try:
            self._selector.modify(fd, watch.events, watch)
        except OSError:
            # Another file has this number now; the selector has already dropped the old one.
            del self._watches[fd]
            callback = watch.on_readable if event == _READ else watch.on_writable
            if callback is not None:
                self._register(fd, event, callback)

    # -- time

    def call_at(self, deadline_ns: int, callback: Callable[[], object]) -> Timer:
        """Call `callback` once when the clock has reached `deadline_ns`."""
        return self._timers.push(deadline_ns, callback)

    def call_later(self, delay_ns: int, callback: Callable[[], object]) -> Timer:
        """Call `callback` once, `delay_ns` from now."""
        return self._timers.push(self.now() + delay_ns, callback)

    def call_soon(self, callback: Callable[[], object]) -> None:
        """Call `callback` once, in this iteration or the next, in the order of the `call_soon` calls."""
        self._soon.append(callback)

    def call_threadsafe(self, callback: Callable[[], object]) -> None:
        """Call `callback` once, soon, on the loop's thread; callable from any thread. No effect after `close`."""
        self._from_threads.append(callback)
        if not self._woken:
            # Two threads may both get here: one byte too many is harmless. The loop clears the flag before it empties
            # the queue, so that a call that finds the flag set is served.
            self._woken = True
            with contextlib.suppress(OSError):
                self._wake_out.send(_WAKE)

    @property
    def next_deadline(self) -> int | None:
        """Deadline of the earliest timer, or None; the current time if a call is queued."""
        return self.now() if self._soon else self._timers.next_deadline()

    # -- signals

    def handle_signals(self, handlers: Mapping[int, Callable[[], object]]) -> None:
        """Register signal handlers to be called on the loop; main thread only. `close` restores the old handlers."""
        if not self._signals:
            previous_fd = signal.set_wakeup_fd(self._wake_out.fileno(), warn_on_full_buffer=False)
            self._restored.callback(signal.set_wakeup_fd, previous_fd)
        for number, handler in handlers.items():
            if number not in self._signals:
                previous = signal.signal(number, _nop)
                # None: the handler was not set by Python, and Python cannot restore it
                self._restored.callback(signal.signal, number, previous or signal.SIG_DFL)
            self._signals[number] = handler

    def _on_wake(self) -> None:
        numbers = self._wake_in.recv(4096)
        self._woken = False
        self._soon.extend(self._signals[number] for number in numbers if number in self._signals)
        while self._from_threads:
            self._soon.append(self._from_threads.popleft())

    # -- running

    def run(self) -> None:
        """Process events until `stop` is called."""
        with self._claimed():
            if not self.clock.is_manual:
                while not self._stopping:
                    self._turn(self._longest_wait())
            while not self._stopping:
                if not self._step(None):
                    self._turn(None)  # a manual clock without timers: only a descriptor can continue

    def run_until(self, condition_or_deadline: Callable[[], bool] | int, timeout_ns: int | None = None) -> bool:
        """Process events until a condition is true or a deadline is reached; return the condition's value.

        The condition is checked before every turn. The result is False if `timeout_ns` has elapsed, if `stop` was
        called, or, with a manual clock, if no event is left. For a deadline the result is True unless `stop` was
        called.
        """
        with self._claimed():
            if isinstance(condition_or_deadline, int):
                return self._serve_till(condition_or_deadline, lambda: False)
            limit = None if timeout_ns is None else self.now() + timeout_ns
            self._serve_till(limit, condition_or_deadline)
            return condition_or_deadline()

    def run_for(self, duration_ns: int) -> bool:
        """Process events for `duration_ns`; return False if the loop was stopped.

        With a manual clock this takes no real time and advances the clock by exactly `duration_ns`, after all events up
        to then have been processed.
        """
        return self.run_until(self.now() + duration_ns)

    def serve(self) -> int | None:
        """Process everything ready or due now, without advancing a manual clock; return the next deadline or None."""
        marked = self._marked
        while True:
            self._turn(0)
            deadline = self._timers.next_deadline()
            expired = deadline is not None and deadline <= self.now()
            if not (expired or self._soon or ((marked is None or marked) and self._poll(0, 1))):
                return deadline

    def stop(self) -> None:
        """End `run`, `run_until` or `run_for` after this iteration; if none is running, end the next at its start."""
        self._stopping = True

    def close(self) -> None:
        """Restore the signal handlers and close all descriptors; no effect if already closed."""
        if self._closed:
            return
        self._closed = True
        self._restored.close()
        self._timers.clear()
        self._soon.clear()
        self._watches.clear()
        if self._epoll is not None:
            self._epoll.close()
        self._selector.close()
        if self._alarm is not None:
            self._alarm.close()
        self._wake_in.close()
        self._wake_out.close()

    @contextlib.contextmanager
    def _claimed(self) -> Iterator[None]:
        if self._closed or self._running:
            raise LocalProtocolError(f"the reactor {'is closed' if self._closed else 'is already running'}")
        self._running = True
        try:
            yield
        finally:
            self._running = self._stopping = False

    def _serve_till(self, limit: int | None, finished: Callable[[], bool]) -> bool:
        """Process events until `finished` or stopped, or until the limit is reached or no event is left.

        Return True only if the limit was reached or no event is left.
        """
        wake = None if limit is None or self.clock.is_manual else self.call_at(limit, _nop)
        try:
            while not (self._stopping or finished()):
                if not self._step(limit):
                    return True
        finally:
            if wake is not None:
                wake.cancel()
        return False

    def _step(self, limit: int | None) -> bool:
        """Process one iteration; return False at the limit, or with a manual clock if no event is left before it."""
        if not self.clock.is_manual:
            self._turn(self._longest_wait())
            return limit is None or self.now() < limit
        return self._turn(0) > 0 or self._jump(limit)

    def _jump(self, limit: int | None) -> bool:
        """Advance the manual clock to the next deadline; if the limit comes first, advance to it and return False."""
        clock = cast("ManualClock", self.clock)
        deadline = self._timers.next_deadline()
        if deadline is not None and (limit is None or deadline <= limit):
            clock.now_ns = max(clock.now_ns, deadline)
            return True
        if limit is not None:
            clock.now_ns = max(clock.now_ns, limit)
        return False

    def _longest_wait(self) -> float | None:
        """Return the selector timeout in s (None: no timeout); set the alarm if the earliest deadline has changed."""
        if self._soon:
            return 0
        deadline = self._timers.next_deadline()
        if deadline is not None:
            if deadline == self._alarm_at:
                return None  # the alarm is set, and has fired if it is due
            wait_ns = deadline - self.now()
            if wait_ns <= 0:
                return 0
            if self._alarm is None:
                return wait_ns / 1e9
        if self._alarm is not None and deadline != self._alarm_at:
            self._alarm.set(deadline)
            self._alarm_at = deadline
        return None

    def _turn(self, timeout: float | None) -> int:
        """Wait, then process descriptors, queued calls and timers; return the number of callbacks that were called."""
        self._turns = turn = self._turns + 1
        watches, served, alarm_fired = self._watches, 0, timeout is not None
        for fd, events in self._poll(timeout, len(watches) + 1):
            watch = watches.get(fd)
            if watch is None:
                # the alarm, or a descriptor removed in this turn, which costs one extra check of the timers
                alarm_fired = True
                continue
            if watch.since == turn:
                continue  # the number now belongs to another file
            if events & _READABLE and watch.on_readable is not None:
                self._call(watch.on_readable)
                served += 1
            if events & _WRITABLE and watch.on_writable is not None:
                self._call(watch.on_writable)
                served += 1
        soon = self._soon
        for _ in range(len(soon)) if soon else ():
            self._call(soon.popleft())
            served += 1
        for timer in self._timers.pop_due(self.now()) if alarm_fired else ():
            callback = timer.take()
            if callback is not None:  # otherwise an earlier callback of this turn has cancelled it
                self._call(callback)
                served += 1
        return served

    def _select(self, timeout: float | None, _most: int) -> list[tuple[int, int]]:
        """Wait and return the ready descriptors with their event masks, as epoll does."""
        return [(key.fd, _FLAGS[events]) for key, events in self._selector.select(timeout)]

    def _call(self, callback: Callable[[], object]) -> None:
        try:
            callback()
        except Exception as error:  # noqa: BLE001 - no exception of a callback ends the loop
            self.errors += 1
            self._report(error)

    def _report(self, error: Exception) -> None:
        try:
            self.on_error(error)
        except Exception as second:  # noqa: BLE001 - nor does one of the handler
            self.errors += 1
            self._print_first_errors(second)

    def _print_first_errors(self, error: BaseException) -> None:
        if self.errors <= _PRINTED_ERRORS:
            traceback.print_exception(error, file=sys.stderr)
