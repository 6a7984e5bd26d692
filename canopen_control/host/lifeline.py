"""The child's side of `spawn` and `spawn_detached`: is the parent alive, and telling the starter that we are ready.

Kept apart from them because a child that starts nothing itself should not load what starting takes.
"""

from __future__ import annotations

import contextlib
import os
import stat
from typing import Final

from canopen_control.host.environment import LIFELINE, READY

__all__ = ["READY_WORD", "lifeline_fd", "report_failure", "report_ready"]

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
        with contextlib.suppress(OSError):  # the starter has lost patience, and said so
            os.write(fd, line + b"\n")
        os.close(fd)
