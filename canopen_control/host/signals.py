"""Signal handlers in a program without a reactor, for the duration of a `with` block or of a whole process."""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import time

from canopen_control.errors import CanopenError

TYPE_CHECKING = False  # the command line imports this before all else
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # SIGHUP: the terminal was closed
INTERRUPTED = 130  #: exit code of a program that one of these signals has ended: 128 + SIGINT, as shells report it
_IMPORT = "<frozen importlib._bootstrap>"  # the file of the frames of an import
_STARTS = ("Popen.__init__", "Popen.__enter__")  # functions that start a process, up to its `with` block
_AGAIN_S = 0.01
_LONGEST_IMPORT_S = 10.0  # imports take seconds on a busy computer; a second signal does not wait


@contextlib.contextmanager
def on_signals(numbers: Iterable[signal.Signals], call: Callable[[], object]) -> Iterator[None]:
    """Context in which each of these signals calls `call` on the main thread; its end restores the handlers."""
    before = {number: signal.signal(number, lambda *_: call()) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            # None: the handler was not set by Python, and Python cannot restore it
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


LONGEST_SUSPENSION_S = 0.5  #: the default of `cmd_vel_timeout`, the shortest timeout of a command


class SuspensionWatch:
    """Watch for a suspension of this process, by Ctrl-Z or SIGSTOP, that is longer than `LONGEST_SUSPENSION_S`.

    A context manager for the main thread of a program that sends commands repeatedly: the robot has ended a command
    that was not renewed, and the program must not continue the motion when it is resumed. `renew` is called with each
    command; `seconds` is the time in s from the last `renew` to the end of a long suspension, 0.0 without one.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self._renewed_s = time.monotonic()
        self._handler = contextlib.ExitStack()

    def __enter__(self) -> SuspensionWatch:
        self._handler.enter_context(on_signals((signal.SIGCONT,), self._resumed))
        return self

    def __exit__(self, *_: object) -> None:
        self._handler.close()

    def renew(self) -> None:
        self._renewed_s = time.monotonic()

    def require_unsuspended(self) -> None:
        """Act like `renew`, but raise CanopenError after a long suspension."""
        if self.seconds:
            raise CanopenError(
                f"this program was suspended for {self.seconds:.1f} s, so its command has ended; start it again to "
                "move the robot"
            )
        self.renew()

    def _resumed(self) -> None:
        away = time.monotonic() - self._renewed_s
        if away > LONGEST_SUSPENSION_S:
            self.seconds = away


def interrupt() -> None:
    """Raise KeyboardInterrupt as Ctrl-C does, for signals that end a program in the same way."""
    raise KeyboardInterrupt


class ProcessSignals:
    """SIGINT, SIGTERM and SIGHUP of one process, from the start to the end of its `main`.

    Each signal raises KeyboardInterrupt on the main thread, and sets `received`, because the exception may be lost: a C
    library that calls Python replaces it by another exception, and it cannot be raised while Python frees an object.
    During an import it is raised afterwards, or at a second signal, because an extension module that is partly imported
    crashes; likewise while a process is started, which would not be reaped. A SIGHUP after another signal
    is ignored, because kernel and shell both send one when a terminal is closed. After `finish` the process ends
    anyway: the first signal is ignored, and a second signal ends the process at once.
    """

    def __init__(self) -> None:
        self.received = False
        self._finished = False
        self._ignored = 0
        self._deferred = 0

    def begin(self) -> None:
        """Install the handlers, and receive signals that were blocked before `exec`; ignored signals stay ignored."""
        for number in ENDING:
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                signal.signal(number, self._handle)
        sys.unraisablehook = self._raise_again
        atexit.register(self._ignore)  # the first of the exit functions is the last that runs
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)

    def finish(self) -> None:
        """Raise no further KeyboardInterrupt; from now on a second signal ends the process."""
        self._finished = True
        _stop_timer()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._finished:
            self._ignored += 1
            if self._ignored > 1:
                os._exit(INTERRUPTED)
            return
        if number == signal.SIGHUP and self.received:
            return
        first, self.received = not self.received, True
        if (
            _must_complete(frame)
            and (first or number == signal.SIGALRM)
            and self._deferred < _LONGEST_IMPORT_S / _AGAIN_S
        ):
            self._deferred += 1
            self._handle_soon()
        else:
            _stop_timer()
            raise KeyboardInterrupt

    def _handle_soon(self) -> None:
        signal.signal(signal.SIGALRM, self._handle)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)

    def _raise_again(self, unraisable: sys.UnraisableHookArgs) -> None:
        """Re-raise a KeyboardInterrupt that could not be raised where it occurred; report any other exception."""
        if unraisable.exc_type is not KeyboardInterrupt:
            sys.__unraisablehook__(unraisable)
        elif not self._finished:
            self._handle_soon()

    def _ignore(self) -> None:
        """Ignore the signals while the interpreter frees its objects, because no Python handler can run then."""
        for number in ENDING:
            if signal.getsignal(number) == self._handle:
                signal.signal(number, signal.SIG_IGN)


def _stop_timer() -> bool:
    """Stop the timer of `ProcessSignals`; return whether it was running."""
    owner = getattr(signal.getsignal(signal.SIGALRM), "__self__", None)
    return isinstance(owner, ProcessSignals) and signal.setitimer(signal.ITIMER_REAL, 0)[0] > 0


def _must_complete(frame: FrameType | None) -> bool:
    """Whether a frame, or one of the frames that called it, belongs to an import or to the start of a process."""
    while frame is not None and frame.f_code.co_filename != _IMPORT and frame.f_code.co_qualname not in _STARTS:
        frame = frame.f_back
    return frame is not None


def block_for_exec() -> None:
    """Keep SIGINT, SIGTERM and SIGHUP pending across `exec`, until `ProcessSignals.begin` of the new program."""
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    if _stop_timer():  # a signal came during an import
        raise KeyboardInterrupt
