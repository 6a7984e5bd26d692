"""The processes of a campaign: marked by an environment variable, found, measured and ended by process id."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


MARK: Final = "CANOPEN_CONTROL_CAMPAIGN"
_PAGE: Final = os.sysconf("SC_PAGE_SIZE")
_ROLES: Final = {"drive": "canopen_control drive --node-id {node} ", "recorder": "trace.flight", "bridge": "ros.bridge"}
_TOOLS: Final = str(Path(__file__).parents[1])


def marked(mark: str) -> dict[int, str]:
    """Return the command lines of all living processes with this mark, by process id; zombies count as dead."""
    wanted = f"{MARK}={mark}".encode()
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal() and int(entry.name) != os.getpid():
            with contextlib.suppress(OSError):
                if wanted in (entry / "environ").read_bytes().split(b"\0"):
                    found[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
    return found


def resident_mb(pid: int) -> float | None:
    """Return the resident memory of a process, or None if it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE / 1e6
    except (OSError, IndexError):
        return None


class Program:
    """A process of the command line; its output is in `path`."""

    def __init__(self, folder: Path, name: str, words: Sequence[str], mark: str) -> None:
        self.words, self.path, self.mark = list(words), folder / f"{name}.out", mark
        self.started = time.monotonic()
        with self.path.open("wb") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", "canopen_control", *words],
                stdin=subprocess.DEVNULL, stdout=output, stderr=output, env={**os.environ, MARK: mark},
                start_new_session=True,
            )  # fmt: skip
        self.pid = self.process.pid

    @property
    def code(self) -> int | None:
        """Its exit code, or None while it is running."""
        return self.process.poll()

    def output(self) -> str:
        """Return its output so far."""
        return self.path.read_text(errors="replace")

    def wait_for(self, ready: Callable[[str], bool], seconds: float) -> bool:
        """Wait until `ready` accepts its output; return False if it ends first or the timeout expires."""
        end = time.monotonic() + seconds
        while not ready(self.output()):
            if self.code is not None or time.monotonic() > end:
                return ready(self.output())
            time.sleep(0.02)
        return True

    def send(self, number: int) -> None:
        """Send it a signal; does nothing if it has ended."""
        if self.code is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def wait(self, seconds: float) -> int | None:
        """Wait for its end and return its exit code, or None on timeout."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self.process.wait(seconds)
        return None

    def end(self, seconds: float = 5.0) -> None:
        """End it, by force if necessary."""
        self.send(signal.SIGCONT)
        self.send(signal.SIGTERM)
        if self.wait(seconds) is None:
            self.send(signal.SIGKILL)
            self.process.wait()


class Run(Program):
    """One `canopen-control run` and its child processes."""

    def find(self, role: str, node: int = 0) -> int | None:
        """Return the process id of a child: drive (of a node), recorder or bridge."""
        words = _ROLES[role].format(node=node)
        return next((pid for pid, line in marked(self.mark).items() if words in line and pid != self.pid), None)

    def survivors(self) -> dict[int, str]:
        """Return its remaining processes."""
        return marked(self.mark)


def start_helper(module: str, *words: str) -> subprocess.Popen[bytes]:
    """Start a module of this package as a separate process, so that it does not slow down the listener."""
    path = os.pathsep.join([_TOOLS, *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.Popen(
        [sys.executable, "-P", "-m", f"campaigner.{module}", *words],
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
