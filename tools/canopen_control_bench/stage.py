"""The environment of a bench: separate folders, virtual drives, and the measured programs, each a process.

Nothing outside the stage's own folder is touched, and whatever it started is ended by its id when
the stage is left, the hubs included.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.local import ask_hub
from canopen_control.data_files import data_path
from canopen_control.errors import CanopenError
from canopen_control.host.environment import MODULE, clean_environment
from canopen_control.host.sockets import list_sockets
from canopen_control.rpc.messages.hub import GetHubStatus
from canopen_control_bench.machine import cpu_ns, wakeups
from canopen_control_bench.turns import Turn

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


EDS = str(data_path("eds", "TMCM-1270.eds"))
TIMEOUT_S = 60.0
_DOMAINS = 100  # ROS domain: a benchmark receives no other benchmark or robot of this machine, nor do they receive it
_OWN = ""  # name of this package in tables with others
_SLOWEST_NS = 10_000_000  # period of a free-running cycle


class Program:
    """A process of the stage: `python -m WORDS`, with its error output in a file."""

    def __init__(self, folder: Path, words: Sequence[str], *, ros: bool = False) -> None:
        self.words = words
        self.errors = folder / f"{words[0].rpartition('.')[2]}-{time.monotonic_ns()}.err"
        with self.errors.open("wb") as errors:
            self.process = subprocess.Popen(
                [*MODULE, *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                env=clean_environment(ros=ros),
            )
        self.pid = self.process.pid
        self._drain: threading.Thread | None = None

    def line(self, seconds: float = TIMEOUT_S) -> str:
        """Return its next line; raises CanopenError with its error output if it ends or is silent."""
        assert self.process.stdout is not None
        watchdog = threading.Timer(seconds, self.process.kill)
        watchdog.start()
        line = self.process.stdout.readline()
        watchdog.cancel()
        if not line:
            self.process.wait(TIMEOUT_S)
            said = self.errors.read_text().strip().splitlines()[-3:]
            raise CanopenError(f"{self.words[0]} ended with {self.process.returncode}: {' | '.join(said)}")
        return line

    def until(self, words: str) -> str:
        """Return its next line that begins with `words`; raises CanopenError like `line`."""
        while not (line := self.line()).startswith(words):
            pass
        return line

    def tell(self, line: str) -> None:
        """Write a line to its standard input."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def drain(self) -> None:
        """Discard its output from now on: a full pipe would block it."""
        assert self.process.stdout is not None
        self._drain = threading.Thread(target=self.process.stdout.read, daemon=True)
        self._drain.start()

    def end(self) -> None:
        """End it by force if it does not end within a few seconds after its standard input is closed."""
        with contextlib.suppress(OSError):
            if self.process.stdin is not None:
                self.process.stdin.close()
        if self.process.poll() is None:
            self.process.terminate()
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        if self._drain is not None:
            self._drain.join()
        if self.process.stdout is not None:
            self.process.stdout.close()


class Contender(Program):
    """A program that runs turns, see `canopen_control_bench.turns`."""

    def __init__(self, folder: Path, words: Sequence[str], others: dict[str, int]) -> None:
        super().__init__(folder, words)
        self.others = dict(others)
        self._before: dict[str, int] = {}
        self._woken: dict[str, int] = {}
        self._due_s = TIMEOUT_S
        assert "ready" in json.loads(self.line())

    def order(self, cycles: int, period_ns: int) -> None:
        """Start a turn."""
        self._before = {name: cpu_ns(pid) for name, pid in self.others.items()}
        self._woken = {name: wakeups(pid) for name, pid in self._pids.items()}
        self._due_s = TIMEOUT_S + 2 * cycles * max(period_ns, _SLOWEST_NS) / 1e9
        self.tell(json.dumps({"cycles": cycles, "period_ns": period_ns}))

    def answer(self) -> Turn:
        """Wait for the results of a turn, and add the CPU time of other programs and the number of wake-ups."""
        turn = Turn(**json.loads(self.line(self._due_s)))
        turn.others_ns = {name: cpu_ns(self.others[name]) - before for name, before in self._before.items()}
        woken = {name: wakeups(pid) - self._woken[name] for name, pid in self._pids.items() if name in self._woken}
        turn.wakeups, turn.others_wakeups = woken.pop(_OWN), woken
        return turn

    @property
    def _pids(self) -> dict[str, int]:
        return {_OWN: self.pid, **self.others}

    def turn(self, cycles: int, period_ns: int) -> Turn:
        """Run a turn of so many cycles, and return its results."""
        self.order(cycles, period_ns)
        return self.answer()

    def leave(self) -> None:
        """End the program and wait for its end."""
        self.tell(json.dumps("end"))
        self.process.wait(TIMEOUT_S)
        self.end()


class Witness(Program):
    """A bare timer that runs with a contender, see `canopen_control_bench.witness`."""

    def stalls(self) -> list[tuple[int, int]]:
        """End it, and return the intervals in which it was late."""
        self.tell("end")
        return [(edge, woke) for edge, woke in json.loads(self.line())["stalls"]]


class Slaves(Program):
    """Virtual drives that can answer without work, see `canopen_control_bench.slaves`."""

    def replay(self, on: bool) -> None:
        """Make them answer without work from now on, or act as drives again."""
        self.tell("replay" if on else "live")
        self.line()


class Stage:
    """The folders and processes of one bench."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.programs: list[Program] = []

    def drives(self, channel: str, node_ids: str, *options: str) -> Program:
        """Run virtual drives in one process, and return it when they are running."""
        drives = self.start("canopen_control", "drive", "--node-id", node_ids, "--eds", EDS, "--can", channel, *options)
        drives.line()
        drives.drain()
        return drives

    def slaves(self, channel: str, first: int, count: int) -> Slaves:
        """Run the bench's own virtual drives in one process, and return it when they are running."""
        slaves = Slaves(self.folder, ["canopen_control_bench.slaves", channel, str(first), str(count)])
        self.programs.append(slaves)
        slaves.line()
        return slaves

    def witness(self, cpu: int, period_ns: int) -> Witness:
        """Start a bare timer on a CPU, and return it when it is running."""
        witness = Witness(self.folder, ["canopen_control_bench.witness", str(cpu), str(period_ns)])
        self.programs.append(witness)
        witness.line()
        return witness

    def start(self, *words: str, ros: bool = False) -> Program:
        """Run `python -m WORDS`."""
        program = Program(self.folder, words, ros=ros)
        self.programs.append(program)
        return program

    def contender(self, *words: str, others: dict[str, int]) -> Contender:
        """Start a program that runs turns, and return it when it is ready."""
        contender = Contender(self.folder, words, others)
        self.programs.append(contender)
        return contender

    def cpu_s(self) -> dict[str, float]:
        """Return the CPU seconds of the running programs by kind, and of the hubs, since their start."""
        used: dict[str, float] = {}
        for program in self.programs:
            kind = program.words[1 if program.words[0] == "canopen_control" else 0].rpartition(".")[2]
            used[kind] = used.get(kind, 0.0) + cpu_ns(program.pid) / 1e9
        used["hub"] = sum(cpu_ns(ask_hub(name, GetHubStatus()).pid) for name in list_sockets("busctl")) / 1e9
        return {f"{kind} CPU s": round(seconds, 2) for kind, seconds in used.items() if seconds}

    def close(self) -> None:
        """End all processes."""
        for program in reversed(self.programs):
            program.end()
        for name in list_sockets("busctl"):
            with contextlib.suppress(CanopenError, OSError):
                os.kill(ask_hub(name, GetHubStatus()).pid, signal.SIGTERM)


@contextlib.contextmanager
def stage() -> Iterator[Stage]:
    """Provide a stage in temporary folders, and clean it up at the end."""
    names = ("XDG_RUNTIME_DIR", "XDG_STATE_HOME", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_DOMAIN_ID")
    kept = {name: os.environ.get(name) for name in names}
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        os.environ.update(XDG_RUNTIME_DIR=folder, XDG_STATE_HOME=f"{folder}/state")
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % _DOMAINS)
        played = Stage(Path(folder))
        try:
            yield played
        finally:
            played.close()
            for name, value in kept.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value
