"""Real processes of a test: started, watched, ended by their ids, and none of them left behind.

A process belongs to a test when its environment names the test's own runtime folder. That finds the children of
children and the hub as well, and nothing that anybody else has started.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from support.channel import channel_of, robby_of
from support.fork_server import fork_server
from support.host import TIMEOUT_S, eventually
from support.localbus import end_hubs

from canopen_control.client.drive_client import DriveClient
from canopen_control.rpc.messages.drive import DriveState, GetDriveState, SwitchFault
from canopen_control.rpc.messages.robot import GetStatus

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.client import RobotClient

_COVERAGE = "COVERAGE_PROCESS_CONFIG"  # a process measured for coverage starts with an interpreter
GONE_S = 10.0  # maximum lifetime of a process after the process that it depends on has ended


def go_first(pid: int) -> None:
    """Let a robot go before the other tests of a busy machine, children and all, where the user may."""
    with contextlib.suppress(PermissionError, ProcessLookupError):
        os.setpriority(os.PRIO_PROCESS, pid, -10)


class Program:
    """One process of the command line; `out` and `err` are what it has printed so far.

    With `forked` it is a fork of a process that has imported the package: what it does is the same, and it starts with
    a tenth of the work.
    """

    def __init__(
        self, arguments: list[str], folder: Path, number: int, environment: dict[str, str], *, forked: bool
    ) -> None:
        self.arguments = arguments
        self._paths = [folder / f"{number}-{arguments[0]}.{kind}" for kind in ("out", "err")]
        with self._paths[0].open("wb") as out, self._paths[1].open("wb") as err:
            self._process = (
                fork_server().start(arguments, folder, {**os.environ, **environment}, *self._paths)
                if forked
                else subprocess.Popen(
                    [sys.executable, "-m", "canopen_control", *arguments],
                    cwd=folder,
                    env={**os.environ, **environment},
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=err,
                )
            )
        self.pid = self._process.pid
        go_first(self.pid)

    @property
    def out(self) -> str:
        return self._paths[0].read_text()

    @property
    def err(self) -> str:
        return self._paths[1].read_text()

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def until(self, text: str, seconds: float = TIMEOUT_S) -> str:
        """Wait until it has printed `text`, and return the line that holds it."""
        assert eventually(lambda: text in self.out or not self.running, seconds), f"{self} has not said {text!r}"
        line = next((line for line in self.out.splitlines() if text in line), None)
        assert line is not None, f"{self} ended without saying {text!r}"
        return line

    def send(self, number: int) -> None:
        """Send a signal, to this process alone."""
        self._process.send_signal(number)

    def wait(self, seconds: float = TIMEOUT_S) -> int:
        """Wait for its end and return the exit code."""
        try:
            return self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"{self} has not ended within {seconds} s") from None

    def end(self, number: int = signal.SIGTERM, seconds: float = TIMEOUT_S) -> int:
        """End it by a signal; returns the exit code."""
        if self.running:
            self.send(number)
        return self.wait(seconds)

    def __str__(self) -> str:
        return f"{' '.join(self.arguments)} (pid {self.pid}); out: {self.out!r}, err: {self.err!r}"


class Stage:
    """The processes of one test; `folder` is its runtime folder, `place` where they run.

    They are forks unless they have an environment of their own, or `own_interpreters` is set: by tests of the start.
    """

    own_interpreters = _COVERAGE in os.environ

    def __init__(self, folder: Path, place: Path) -> None:
        self.folder, self.place = folder, place
        self.programs: list[Program] = []

    def start(self, *arguments: object, **environment: str) -> Program:
        """Start `canopen-control ARGUMENTS` and go on."""
        forked = not environment and not self.own_interpreters
        environment.setdefault("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "1")
        words = [str(argument) for argument in arguments]
        program = Program(words, self.place, len(self.programs), environment, forked=forked)
        self.programs.append(program)
        return program

    def call(self, *arguments: object, seconds: float = TIMEOUT_S, **environment: str) -> Program:
        """Run `canopen-control ARGUMENTS` to its end."""
        program = self.start(*arguments, **environment)
        program.wait(seconds)
        return program

    def robby(self, name: str, *options: object) -> Program:
        """Start robby on a bus of its own, and wait until it runs."""
        program = self.start("run", robby_of(self.place), "--as", name, "--can", channel_of(name), *options)
        program.until(f"{name} runs")
        return program

    def drive(self, name: str, node_id: int, *options: object) -> Program:
        """Start one virtual drive on its own, without the lifeline of a robot."""
        program = self.start(
            "drive", "--node-id", node_id, "--eds", "TMCM-1270.eds", "--can", channel_of(name), *options
        )
        program.until("ready on")
        return program

    def survivors(self) -> dict[int, str]:
        """Return all processes of the test that are there, by their id."""
        return processes_of(self.folder)

    def pid_of(self, words: str) -> int:
        """Wait for the only process of the test whose command line holds `words`; return its id.

        The shell that starts a hub and ends at once does not count.
        """

        def found() -> list[int]:
            there = self.survivors().items()
            return [pid for pid, line in there if words in line and not line.startswith("/bin/sh")]

        assert eventually(lambda: len(found()) == 1), f"{words!r}: {found()} of {self.survivors()}"
        return found()[0]

    def nobody_is_left(self, seconds: float = GONE_S) -> None:
        """Wait until no process of the test is there; fail if one survives."""
        assert eventually(lambda: not self.survivors(), seconds), f"still there: {self.survivors()}"

    def end(self) -> None:
        """End everything by its id; fail if something does not end as it should."""
        try:
            for program in reversed(self.programs):  # a robot before its drives: it waits for those that are gone
                with contextlib.suppress(ProcessLookupError):
                    program.end()
            end_hubs()
            self.nobody_is_left()
        finally:
            for pid in self.survivors():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            for program in self.programs:
                program.wait()


def processes_of(folder: Path) -> dict[int, str]:
    """Return the command lines, by process id, of all whose runtime folder is `folder`; without this process."""
    mark = f"XDG_RUNTIME_DIR={folder}".encode()
    result = {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdecimal() or int(entry.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):
            if mark in (entry / "environ").read_bytes().split(b"\0"):
                result[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode()
    return result


def cycles_pass(robot: RobotClient, count: int) -> None:
    """Wait until a robot has had so many cycles more."""
    before = robot.ask(GetStatus()).cycle.count
    assert eventually(lambda: robot.ask(GetStatus()).cycle.count >= before + count, TIMEOUT_S)


class DriveProbe:
    """A drive as it is, through its control socket: past the bus and past any master."""

    def __init__(self, bus: str, node_id: int) -> None:
        self._client = DriveClient.connect(channel_of(bus), node_id, TIMEOUT_S)
        self.hello = self._client.hello
        self.ask = self._client.ask

    @property
    def state(self) -> DriveState:
        """What the node says of itself."""
        return self.ask(GetDriveState())

    @property
    def speed(self) -> float:
        """The plant's velocity, in the drive's own units per second."""
        return self.state.axes[0].plant.velocity

    @property
    def power(self) -> str:
        """The CiA 402 state."""
        return self.state.axes[0].state

    def fault(self, name: str, on: bool = True) -> None:
        """Switch a fault."""
        self.ask(SwitchFault(name=name, on=on))

    def close(self) -> None:
        self._client.close()


def seconds_until(condition: Callable[[], bool], limit: float) -> float:
    """Wait until `condition` and return how long it took; fail after `limit` seconds."""
    begin = time.monotonic()
    assert eventually(condition, limit), f"not within {limit} s"
    return time.monotonic() - begin
