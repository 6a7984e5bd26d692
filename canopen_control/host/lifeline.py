"""The child's side of `spawn` and `spawn_detached`: watches whether the parent lives, and reports readiness.

Kept apart from them because a child that starts nothing itself should not load what starting takes.
"""

from __future__ import annotations

import contextlib
import os
import stat
from typing import Final

from canopen_control.host.environment import LIFELINE, READY

READY_WORD: Final = b"ready"


def lifeline_fd() -> int | None:
    """Return the descriptor of this process' lifeline, None if it has none.

    It becomes readable, with an end of file, when the parent has died. Nothing is ever written to it.
    """
    return _inherited_pipe(LIFELINE)


def _inherited_pipe(variable: str) -> int | None:
    text = os.environ.get(variable, "")
    if not text.isdecimal():
        return None
    fd = int(text)
    try:
        # The variable may come from a parent that did not hand over the descriptor: the number is another file then.
        if not stat.S_ISFIFO(os.fstat(fd).st_mode):
            return None
        os.set_inheritable(fd, False)
    except OSError:
        return None
    return fd


def report_ready() -> None:
    """Tell `spawn_detached`, in the process that it started, that the service is up; a no-op in any other process."""
    _report(READY_WORD)


def report_failure(sentence: str) -> None:
    """Tell `spawn_detached`, in the process that it started, why there is no service; a no-op in any other process."""
    _report(" ".join(sentence.split()).encode()[:4000])


def _report(line: bytes) -> None:
    fd = _inherited_pipe(READY)
    os.environ.pop(READY, None)
    if fd is not None:
        with contextlib.suppress(OSError):  # the starter has given it up, and said so
            os.write(fd, line + b"\n")
        os.close(fd)


class LivenessReport:
    """What a child of `spawn` says of itself again and again: that it is ready, then that it is alive.

    In a process that nobody asked to report it says nothing.
    """

    def __init__(self) -> None:
        self._fd = _inherited_pipe(READY)
        os.environ.pop(READY, None)
        if self._fd is not None:
            os.set_blocking(self._fd, False)  # a starter that hangs must not hang us

    @property
    def is_asked_for(self) -> bool:
        """Whether anybody listens."""
        return self._fd is not None

    def beat(self) -> None:
        """Say so, from any thread; the first time it means that the service is up."""
        if self._fd is not None:
            with contextlib.suppress(OSError):
                os.write(self._fd, READY_WORD + b"\n")
