"""Child processes: attached ones, which end with their parent, and detached ones, which do not.

`spawn` gives every child a session of its own (the terminal's Ctrl-C reaches only the parent), a clean environment, a
log file of limited size, and a lifeline: a pipe whose other end only the parent holds. When the parent ends for any
reason, the kernel closes that end, and the child reads end of file at `lifeline_fd()`. `Child.watch_ready` waits
without blocking for a child that calls `report_ready`. A child with a gate prepares itself until `Child.open_gate`.

`spawn_detached` is for a process shared by several programs, such as the hub of a bus: it is not a child of its caller,
and reports through a pipe when it is ready.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.errors import CanopenError
from canopen_control.host.environment import GATE, LIFELINE, READY, clean_environment, has_ros_libraries
from canopen_control.host.files import LogFile, state_dir
from canopen_control.host.fork import ForkedProcess, can_fork, fork
from canopen_control.host.lifeline import READY_WORD

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.host.fork import Main
    from canopen_control.host.reactor import Reactor
    from canopen_control.host.timer import Timer


_POLL_NS: Final = 50_000_000  # for systems without pidfd
_ROTATE_NS: Final = 5_000_000_000
_LAST_LINES: Final = 10
_BUSY_STATES: Final = (b"R", b"D")  # states of proc_pid_stat(5)
#: for dash and bash: a background command is adopted by init when its shell ends
_DETACH: Final = ("/bin/sh", "-c", '"$@" &', "sh")


class Child:
    """Running child process, created by `spawn`.

    `log_path` is None if the child's output goes to the output of this process. Wait for the child with `wait` or
    `watch`. `readiness` is the parent's end of the pipe used by `report_ready`, `gate` the parent's end of the
    gate, -1 if there is none.
    """

    def __init__(
        self,
        process: subprocess.Popen[bytes] | ForkedProcess,
        name: str,
        lifeline: int,
        log: LogFile | None,
        readiness: int = -1,
        gate: int = -1,
    ) -> None:
        self.name = name
        self.pid = process.pid
        self._process = process
        self._lifeline, self._gate = lifeline, gate
        self.heard_at: int | None = None
        self._readiness = readiness
        self._on_ready: Callable[[], object] | None = None
        self._log = log
        self._pidfd = -1
        self._reactor: Reactor | None = None
        self._on_exit: Callable[[int, list[str]], object] | None = None
        self._timers: list[Timer] = []

    @property
    def log_path(self) -> Path | None:
        """Path of the log with the child's output, or None without a log."""
        return None if self._log is None else self._log.path

    @property
    def returncode(self) -> int | None:
        """Exit status, negative for a signal; None while the child runs, or until `poll` or `wait` is called."""
        return self._process.returncode

    def poll(self) -> int | None:
        """Check whether the child has ended; return its exit status, or None while it runs."""
        if self._process.poll() is not None:
            self.cut_lifeline()
        return self._process.returncode

    def wait(self, timeout: float | None = None) -> int | None:
        """Wait for the end of the child and return its exit status, or None after `timeout` s; blocks."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout)
        return self.poll()

    def terminate(self) -> None:
        self._process.terminate()

    def kill(self) -> None:
        """Kill the child and the processes in its group (SIGKILL); no effect once the child has ended."""
        # Until the child is waited for, its process id, which is also the group id, is not reused.
        if self._process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGKILL)

    def cut_lifeline(self) -> None:
        """Close the lifeline and the gate; the child then behaves as if this process had ended."""
        pipes, self._lifeline, self._gate = (self._lifeline, self._gate), -1, -1
        for pipe in pipes:
            if pipe >= 0:
                os.close(pipe)

    def open_gate(self) -> None:
        """Open the child's gate, so that the child continues; no effect without a gate."""
        gate, self._gate = self._gate, -1
        if gate >= 0:
            with contextlib.suppress(BrokenPipeError):  # the child has ended
                os.write(gate, b"\n")
            os.close(gate)

    def discard(self) -> None:
        """Kill a child that is not watched, wait for its end, and close its pipes; no effect if already done."""
        self.kill()
        self.wait()
        self.cut_lifeline()
        readiness, self._readiness = self._readiness, -1
        if readiness >= 0:
            os.close(readiness)

    def watch_ready(self, reactor: Reactor, on_ready: Callable[[], object]) -> None:
        """Call `on_ready()` once on the loop when the child has reported readiness or has closed its end of the pipe.

        `heard_at` is the time of the last report: a child with a `LivenessReport` repeats its report.
        """
        if self._readiness >= 0:
            self._on_ready = on_ready
            reactor.add_reader(self._readiness, partial(self._ready, reactor))

    def _ready(self, reactor: Reactor) -> None:
        on_ready, self._on_ready = self._on_ready, None
        if os.read(self._readiness, 4096):
            self.heard_at = reactor.now()
        else:
            self.unwatch_ready(reactor)
        if on_ready is not None:
            on_ready()

    def unwatch_ready(self, reactor: Reactor) -> None:
        """Stop listening to the child's reports; no effect if `watch_ready` is not active."""
        readiness, self._readiness, self._on_ready = self._readiness, -1, None
        if readiness >= 0:
            reactor.remove_reader(readiness)
            os.close(readiness)

    def is_busy(self) -> bool:
        """Whether a thread of the child runs, or waits for a processor or a disk; False if /proc is missing.

        A blocked or stopped process is not busy.
        """
        for path in Path(f"/proc/{self.pid}/task").glob("*/stat"):
            with contextlib.suppress(OSError):  # the thread has ended
                if path.read_bytes().rpartition(b") ")[2][:1] in _BUSY_STATES:
                    return True
        return False

    def last_lines(self, count: int = _LAST_LINES) -> list[str]:
        """Return the last `count` lines of the child's output; empty without a log."""
        return [] if self._log is None else self._log.last_lines(count)

    def watch(self, reactor: Reactor, on_exit: Callable[[int, list[str]], object]) -> None:
        """Call `on_exit(returncode, last_lines)` once on the loop when the child has ended.

        Until then the child's log is rotated when it is too long.
        """
        self._reactor, self._on_exit = reactor, on_exit
        # once it was waited for, its process id may be reused
        self._pidfd = _pidfd_open(self.pid) if self.poll() is None else -1
        if self._pidfd >= 0:
            reactor.add_reader(self._pidfd, self._poll_child)
        else:
            self._every(0, self._poll_child_again)
        if self._log is not None:
            self._rotate_again()

    def unwatch(self) -> None:
        """Stop watching the child; no effect if it is not watched."""
        if self._reactor is not None and self._pidfd >= 0:
            self._reactor.remove_reader(self._pidfd)
            os.close(self._pidfd)
        self._pidfd, self._on_exit = -1, None
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()

    def _poll_child(self) -> None:
        returncode, on_exit = self.poll(), self._on_exit
        if returncode is not None and on_exit is not None:
            self.unwatch()
            on_exit(returncode, self.last_lines())

    def _poll_child_again(self) -> None:
        self._poll_child()
        self._every(_POLL_NS, self._poll_child_again)

    def _rotate_again(self) -> None:
        if self._log is not None:
            self._log.rotate_if_long()
        self._every(_ROTATE_NS, self._rotate_again)

    def _every(self, period_ns: int, callback: Callable[[], object]) -> None:
        if self._reactor is not None and self._on_exit is not None:
            self._timers = [timer for timer in self._timers if timer.active]
            self._timers.append(self._reactor.call_later(period_ns, callback))


def end_children(children: Sequence[Child], reactor: Reactor, grace: float) -> None:
    """Send SIGTERM to all children, and SIGKILL to those still running after `grace` s; blocks.

    The children are unwatched first, so that none is restarted.
    """
    for child in children:
        child.unwatch()
        child.unwatch_ready(reactor)
        child.terminate()
    for child in children:
        if child.wait(grace) is None:
            child.kill()
            child.wait(grace)


def _pidfd_open(pid: int) -> int:
    try:
        return os.pidfd_open(pid) if sys.platform.startswith("linux") else -1
    except OSError:  # kernels before 5.3, or a sandbox
        return -1


def spawn(
    argv: Sequence[str],
    *,
    name: str,
    log_dir: Path | None = None,
    ros: bool = False,
    inherit_stdout: bool = False,
    reports: bool = False,
    gated: bool = False,
    main: Main | None = None,
) -> Child:
    """Start a child process and return at once; raise CanopenError if it cannot be started.

    Where `can_fork` allows, the child is a fork of this process that calls `main`, which must be equivalent to `argv`.

    The child's standard output and error go to `<log_dir>/<name>.log` (default folder: `state_dir()`), unless they are
    inherited; its standard input is empty. `ros` means that the child imports rclpy, `reports` that it calls
    `report_ready`, `gated` that it waits at its `gate_fd` until `open_gate`.
    """
    log = None if inherit_stdout else LogFile(log_dir or state_dir(), name)
    forked = main is not None and can_fork() and (not ros or has_ros_libraries())
    environment = clean_environment(ros=ros, forked=forked)
    with contextlib.ExitStack() as parent_ends, contextlib.ExitStack() as child_ends:
        alive, lifeline = _pipe(child_ends, parent_ends)  # nothing is written: end of file means the end of the parent
        environment[LIFELINE] = str(alive)
        readiness = -1
        if reports:
            readiness, ready = _pipe(parent_ends, child_ends)
            environment[READY] = str(ready)
        gate = -1
        if gated:
            passage, gate = _pipe(child_ends, parent_ends)
            environment[GATE] = str(passage)
        try:
            process = _start(argv, environment, log, main if forked else None)
        except OSError as error:
            raise CanopenError(f"cannot start {name} ({argv[0]}): {error.strerror}") from error
        parent_ends.pop_all()
    return Child(process, name, lifeline, log, readiness, gate)


def _pipe(reader: contextlib.ExitStack, writer: contextlib.ExitStack) -> tuple[int, int]:
    """Return the reading and writing ends of a pipe; the stack `reader` closes the former, `writer` the latter."""
    reading, writing = os.pipe()
    reader.callback(os.close, reading)
    writer.callback(os.close, writing)
    return reading, writing


def _start(
    argv: Sequence[str], environment: dict[str, str], log: LogFile | None, main: Main | None
) -> subprocess.Popen[bytes] | ForkedProcess:
    passed = [int(environment[variable]) for variable in (LIFELINE, READY, GATE) if variable in environment]
    with contextlib.nullcontext() if log is None else log.opened_for(argv) as output:
        if main is not None:
            return fork(main, argv, environment, output=None if output is None else output.fileno(), keep=passed)
        return subprocess.Popen(
            list(argv),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            env=environment,
            pass_fds=passed,
            start_new_session=True,
        )


# -- detached


def spawn_detached(
    argv: Sequence[str],
    ready: float = 5.0,
    *,
    name: str = "detached",
    log_dir: Path | None = None,
    main: Main | None = None,
) -> None:
    """Start a process that is not a child of this process; return once it has called `report_ready`.

    `main` is used as in `spawn`. Raise CanopenError with the sentence passed to `report_failure`, with the last
    lines of the log (`<log_dir>/<name>.log`, default folder: `state_dir()`) if the process has ended, or if `ready` s
    have elapsed.
    """
    log = LogFile(log_dir or state_dir(), name)
    reading, writing = os.pipe()
    try:
        try:
            group = _start_detached(argv, writing, log, main)
        finally:
            os.close(writing)
        report = _read_report(reading, time.monotonic() + ready)
    finally:
        os.close(reading)
    if report == READY_WORD:
        return
    if report is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(group, signal.SIGKILL)  # a process still held the pipe: the group is the one created here
        raise CanopenError(f"{name} was not ready within {ready:g} s and was ended; its log is {log.path}")
    why = report.decode(errors="replace") or "it ended at once; " + " | ".join(log.last_lines(_LAST_LINES))
    raise CanopenError(f"{name} could not be started: {why}")


def _start_detached(argv: Sequence[str], report_fd: int, log: LogFile, main: Main | None) -> int:
    """Start the process through an intermediate shell or fork that ends at once; return the id of the process group."""
    environment = clean_environment(ros=False)
    environment[READY] = str(report_fd)
    starter: subprocess.Popen[bytes] | ForkedProcess
    with log.opened_for(argv) as output:
        if main is not None and can_fork():
            starter = fork(main, argv, environment, output=output.fileno(), keep=[report_fd], detached=True)
        else:
            starter = subprocess.Popen(
                [*_DETACH, *argv],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env=environment,
                pass_fds=(report_fd,),
                start_new_session=True,
            )
    starter.wait()
    return starter.pid


def _read_report(fd: int, deadline: float) -> bytes | None:
    """Return the reported line; b"" if all possible senders have ended, or None after the deadline."""
    report = b""
    while not report.endswith(b"\n"):
        readable, _, _ = select.select([fd], [], [], max(deadline - time.monotonic(), 0))
        if not readable:
            return None
        data = os.read(fd, 4096)
        if not data:
            break
        report += data
    return report.strip()
