"""Child's side of `spawn` and `spawn_detached`: detects the end of the parent, and reports readiness.

The module is separate so that children need not import the code that starts processes.
"""

from __future__ import annotations

import contextlib
import os
import stat
from typing import Final

from canopen_control.host.environment import GATE, LIFELINE, READY

READY_WORD: Final = b"ready"


def lifeline_fd() -> int | None:
    """Return the descriptor of this process's lifeline, or None without a lifeline.

    The descriptor becomes readable, with end of file, when the parent has ended. Nothing is ever written to it.
    """
    return _inherited_pipe(LIFELINE)


def gate_fd() -> int | None:
    """Return the descriptor of this process's gate, or None without a gate; the caller must close it.

    The descriptor becomes readable with one byte when the parent opens the gate, or with end of file if the gate will
    never be opened.
    """
    fd = _inherited_pipe(GATE)
    os.environ.pop(GATE, None)
    return fd


def _inherited_pipe(variable: str) -> int | None:
    text = os.environ.get(variable, "")
    if not text.isdecimal():
        return None
    fd = int(text)
    try:
        # The variable may come from a parent that did not pass the descriptor: the number is another file then.
        if not stat.S_ISFIFO(os.fstat(fd).st_mode):
            return None
        os.set_inheritable(fd, False)
    except OSError:
        return None
    return fd


def report_ready() -> None:
    """Report to `spawn` or `spawn_detached` that this process is ready; no effect without a waiting starter."""
    _report(READY_WORD)


def report_failure(sentence: str) -> None:
    """Report to `spawn_detached` why this process could not start; no effect without a waiting starter."""
    _report(" ".join(sentence.split()).encode()[:4000])


def _report(line: bytes) -> None:
    fd = _inherited_pipe(READY)
    os.environ.pop(READY, None)
    if fd is not None:
        with contextlib.suppress(OSError):  # the starter gave up waiting, and reported it
            os.write(fd, line + b"\n")
        os.close(fd)


class LivenessReport:
    """Reports of a child to `spawn`: the first means that it is ready, each later one that it is still running.

    The methods have no effect in a process whose starter has not requested reports.
    """

    def __init__(self) -> None:
        self._fd = _inherited_pipe(READY)
        os.environ.pop(READY, None)
        if self._fd is not None:
            os.set_blocking(self._fd, False)  # a blocked starter must not block this process

    @property
    def is_asked_for(self) -> bool:
        return self._fd is not None

    def beat(self) -> None:
        """Send a report; callable from any thread. The first report informs the starter that the child is ready."""
        if self._fd is not None:
            with contextlib.suppress(OSError):
                os.write(self._fd, READY_WORD + b"\n")
