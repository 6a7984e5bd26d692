"""The machine of the run: its description, its load, and the CPU time of processes.

CPU is read from the kernel's own clock of a process (clock_getcpuclockid(3)), all its threads, in nanoseconds; where
there is none, from /proc in hundredths of a second.
"""

from __future__ import annotations

import contextlib
import datetime
import os
import platform
import re
import subprocess
import time
from pathlib import Path
from typing import TYPE_CHECKING

import canopen_control
from canopen_control.version import build

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


_CPU_CLOCK = 2  # from linux/posix-timers.h: the scheduler's clock of a process
_IDLE = (3, 4)  # idle and iowait: columns of /proc/stat
_PROBE_S = 0.5
_VOLUNTARY = re.compile(r"^voluntary_ctxt_switches:\s*(\d+)", re.MULTILINE)


def cpu_ns(pid: int) -> int:
    """Return the CPU time of a process so far in ns; 0 if it does not exist."""
    with contextlib.suppress(OSError, OverflowError):
        return time.clock_gettime_ns((~pid << 3) | _CPU_CLOCK)
    with contextlib.suppress(OSError):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) * 1_000_000_000 // os.sysconf("SC_CLK_TCK")
    return 0


def wakeups(pid: int) -> int:
    """Return how often all threads of a process were woken so far; 0 if it does not exist."""
    found = 0
    with contextlib.suppress(OSError):
        for thread in Path(f"/proc/{pid}/task").iterdir():
            found += int(_VOLUNTARY.findall((thread / "status").read_text())[0])
    return found


def resident_bytes(pid: int | None = None) -> int:
    """Return the resident memory of a process, by default of this one."""
    pages = int(Path(f"/proc/{'self' if pid is None else pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def idle_part(seconds: float = _PROBE_S) -> float | None:
    """Return the idle share of all CPUs, measured for `seconds`; None if the kernel does not report it."""
    before = _jiffies()
    time.sleep(seconds)
    after = _jiffies()
    if before is None or after is None:
        return None
    passed = [late - early for early, late in zip(before, after, strict=True)]
    return sum(passed[column] for column in _IDLE) / max(1, sum(passed))


def _jiffies() -> list[int] | None:
    try:
        return [int(text) for text in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    except OSError:
        return None


@contextlib.contextmanager
def apart(measured: int, others: Iterable[int]) -> Iterator[None]:
    """Reserve the last CPU for a process, moving all others to the remaining CPUs; undone at the end."""
    processors = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    if len(processors) < 2:
        yield
        return
    rest = [pid for pid in (*others, os.getpid()) if pid != measured]
    _place([measured], processors[-1:])
    _place(rest, processors[:-1])
    try:
        yield
    finally:
        _place([measured, *rest], processors)


def _place(pids: Iterable[int], processors: Iterable[int]) -> None:
    for pid in pids:
        with contextlib.suppress(OSError):  # the process has ended
            for thread in os.listdir(f"/proc/{pid}/task"):
                os.sched_setaffinity(int(thread), processors)


def may_be_realtime() -> bool:
    """Whether this user may use SCHED_FIFO; tried in a child process, so that this one is not changed."""
    if not hasattr(os, "sched_setscheduler"):
        return False
    child = os.fork()
    if child == 0:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        except OSError:
            os._exit(1)
        os._exit(0)
    return os.waitpid(child, 0)[1] == 0


def describe() -> dict[str, str | int | float | None]:
    """Return a description of the machine and its load before the run."""
    idle = idle_part()
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "machine": f"{os.cpu_count()} x {_processor()}",
        "kernel": f"{platform.system()} {platform.release()}",
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "package": build(),
        "commit": _commit(),
        "nice": os.getpriority(os.PRIO_PROCESS, 0),
        "load": round(os.getloadavg()[0], 2),
        "idle": None if idle is None else round(idle, 2),
    }


def _commit() -> str | None:
    """Return the commit of the measured checkout, or None for an installed package."""
    asked = ["git", "-C", str(Path(canopen_control.__file__).parent), "rev-parse", "--show-toplevel", "HEAD"]
    with contextlib.suppress(OSError):
        done = subprocess.run(asked, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
        folder, _, commit = done.stdout.strip().partition("\n")
        if not done.returncode and Path(folder, "tools", __package__).is_dir():
            return commit[:12]
    return None


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith(("model name", "Model")):
                return line.partition(":")[2].strip()
    return platform.machine()
