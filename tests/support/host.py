"""What the tests of `host` share: a folder of their own for sockets and logs, and processes that do not stay."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import threading
    from collections.abc import Callable

    import pytest

ROOT = Path(__file__).parents[2]
SECOND_NS = 1_000_000_000
_FUTEX = ("202", "98")  # system call number on x86-64 and arm64
TIME_SCALE = float(os.environ.get("CANOPEN_CONTROL_TIME_SCALE", "1"))  # factor for a slow machine
#: Timeout in s for another process or thread; it is long enough for a busy machine, and not a limit of a reaction time.
TIMEOUT_S = 60.0 * TIME_SCALE


def use_private_folders(monkeypatch: pytest.MonkeyPatch, folder: Path) -> Path:
    """Let sockets and logs live below `folder`, and let children find the package."""
    run = folder / "run"
    run.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(run))
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "state"))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "1")
    return run


def python(code: str) -> list[str]:
    """Return the command line that runs `code`; without site, which triples the time to start."""
    return [sys.executable, "-S", "-c", code]


def eventually(condition: Callable[[], bool], seconds: float = TIMEOUT_S) -> bool:
    """Wait for another process; returns soon when the condition holds."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005 * TIME_SCALE)  # checking also costs CPU time on a slow machine
    return True


def waits(thread: threading.Thread) -> bool:
    """Wait until a thread of this process waits in the kernel for anything but a lock, such as the GIL."""
    call = Path(f"/proc/self/task/{thread.native_id}/syscall")
    return eventually(lambda: call.read_text().split()[0] not in ("running", *_FUTEX))


def runs(pid: int) -> bool:
    """Whether a process is there and no zombie."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def open_descriptors() -> int:
    """Return how many descriptors this process has open."""
    return len(os.listdir("/proc/self/fd"))
