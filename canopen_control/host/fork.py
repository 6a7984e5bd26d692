"""Child processes that are forks of this process, with the modules that it has imported.

A fork is for programs of this package that have one thread, before they own anything that two processes cannot share:
`allow_forks` declares that, and `can_fork` is False in every other process, as in a user's program. The child begins
as a new interpreter would: default signals, only the descriptors that were passed, its own environment and session,
empty buffers, no exit functions, a garbage collector with default settings. `ps` and /proc show the command line and
environment that a separate interpreter would have.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import io
import os
import select
import signal
import sys
import threading
import traceback
from typing import TYPE_CHECKING, Final, NoReturn, TypeAlias

from canopen_control.host.quick_start import quick_imports

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence


_allowed = False
_THRESHOLDS: Final = gc.get_threshold()
_ARG_START, _ENV_END = 48, 51  # fields of proc_pid_stat(5)
_parents_objects: list[object] = []  # freeing a stream of the parent would close a descriptor of the child


#: module, and the arguments of its `main`
Main: TypeAlias = "tuple[str, Sequence[str]]"


def allow_forks() -> None:
    """Allow `spawn` to fork this process; forked children may fork too."""
    global _allowed
    _allowed = True


def forbid_forks() -> None:
    """Revoke `allow_forks`."""
    global _allowed
    _allowed = False


def can_fork() -> bool:
    """Whether a child may be a fork: forks are allowed, Linux has pidfd, and this process has only one thread."""
    return (
        _allowed and sys.platform == "linux" and hasattr(os, "pidfd_open") and len(os.listdir("/proc/self/task")) == 1
    )


class ForkedProcess:
    """Child process created by `fork`, with the part of the `subprocess.Popen` interface that `spawn` uses."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None

    def poll(self) -> int | None:
        return self._wait(os.WNOHANG)

    def wait(self, timeout: float | None = None) -> int | None:
        """Wait at most `timeout` s for the end of the child; return the exit status, or None while it runs."""
        if timeout is not None and self.poll() is None:
            descriptor = os.pidfd_open(self.pid)
            try:
                poller = select.poll()
                poller.register(descriptor, select.POLLIN)
                poller.poll(timeout * 1000)
            finally:
                os.close(descriptor)
        return self._wait(0 if timeout is None else os.WNOHANG)

    def _wait(self, flags: int) -> int | None:
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, flags)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def terminate(self) -> None:
        if self.poll() is None:
            os.kill(self.pid, signal.SIGTERM)


def fork(
    main: Main,
    argv: Sequence[str],
    environment: Mapping[str, str],
    *,
    output: int | None,
    keep: Collection[int],
    detached: bool = False,
) -> ForkedProcess:
    """Start `main` as a fork of this process with its own session; `argv` is the command line shown by ps.

    The child's standard input is empty; `output` receives standard output and error, None keeps those of this process.
    The child inherits only the descriptors `keep`. With `detached` the process that is returned ends at once, and its
    child, in the same session, is the program.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # closed, or gone
            stream.flush()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # our handlers must not run in the child
    try:
        pid = os.fork()
        if pid:
            return ForkedProcess(pid)
        _run_child(main, argv, environment, output, keep, mask, detached)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _run_child(
    main: Main,
    argv: Sequence[str],
    environment: Mapping[str, str],
    output: int | None,
    keep: Collection[int],
    mask: Collection[int],
    detached: bool,
) -> NoReturn:
    """Run the program in the fork, then end the process instead of returning to a caller."""
    code = 1
    try:
        os.setsid()
        if detached and os.fork():
            os._exit(0)
        gc.freeze()  # objects from before the fork are never collected, and their pages stay shared
        gc.enable()
        gc.set_threshold(*_THRESHOLDS)
        atexit._clear()  # noqa: SLF001 - exit functions of the parent; no public way
        _reset_descriptors(output, keep)
        _reset_environment(environment)
        _show(argv, environment)
        _reset_streams()
        module, arguments = main
        sys.argv = [module, *arguments]
        _reset_signals()
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        with quick_imports():
            program = importlib.import_module(module)
        code = program.main(list(arguments))
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)  # noqa: T201 - as the interpreter does
    except BaseException:  # noqa: BLE001 - as the interpreter does
        traceback.print_exc()
    finally:
        with contextlib.suppress(BaseException):
            threading._shutdown()  # type: ignore[attr-defined]  # noqa: SLF001 - as multiprocessing does
            atexit._run_exitfuncs()  # noqa: SLF001 - as multiprocessing does
            sys.stdout.flush()
        os._exit(code)


def _reset_descriptors(output: int | None, keep: Collection[int]) -> None:
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    for number in () if output is None else (1, 2):
        os.dup2(output or 0, number)
    for number in [int(entry) for entry in os.listdir("/proc/self/fd")]:
        if number > 2 and number not in keep:
            with contextlib.suppress(OSError):  # the descriptor of the listing is closed already
                os.close(number)


def _reset_environment(environment: Mapping[str, str]) -> None:
    os.environ.clear()
    os.environ.update(environment)


def _reset_streams() -> None:
    """Reopen the standard streams unbuffered, as with PYTHONUNBUFFERED."""
    _parents_objects.extend((sys.stdin, sys.stdout, sys.stderr, sys.__stdin__, sys.__stdout__, sys.__stderr__))
    usual = sys.__stdout__
    encoding, errors = ("utf-8", "strict") if usual is None else (usual.encoding, usual.errors or "strict")
    streams = {
        "stdin": open(0, encoding=encoding, closefd=False),  # noqa: SIM115 - as long as the process
        "stdout": io.TextIOWrapper(io.FileIO(1, "w", closefd=False), encoding, errors, write_through=True),
        "stderr": io.TextIOWrapper(io.FileIO(2, "w", closefd=False), encoding, "backslashreplace", write_through=True),
    }
    for name, stream in streams.items():
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)


def _reset_signals() -> None:
    """Restore the signal handlers of a new Python process; ignored signals stay ignored, as across exec."""
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals():
        if callable(signal.getsignal(number)):
            default = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
            signal.signal(number, default)


def _show(argv: Sequence[str], environment: Mapping[str, str]) -> None:
    """Make the kernel show this command line and environment, by overwriting the memory of the original ones.

    In this memory the environment follows the command line, and is not used any more. A command line that does not have
    a zero byte at its old end is shown as one string (proc_pid_cmdline(5)), so that its words are separated by spaces.
    """
    with contextlib.suppress(OSError, ValueError, IndexError):  # an older kernel shows the parent's command line
        with open("/proc/self/stat", "rb") as file:
            fields = file.read().rpartition(b")")[2].split()
        start, arg_end, _, end = map(int, fields[_ARG_START - 3 : _ENV_END - 2])  # the first element is field 3
        words = [word.encode(errors="surrogateescape") for word in argv]
        fits = sum(map(len, words)) + len(words) <= arg_end - start
        title = (b"\0" if fits else b" ").join(words).ljust(arg_end - start - 1, b"\0")
        variables = [f"{name}={value}".encode(errors="surrogateescape") for name, value in environment.items()]
        text = title[: end - start - 1] + b"\0"
        for variable in sorted(variables, key=len):  # a longer command line leaves no space for the longest variables
            text += variable + b"\0" if len(text) + len(variable) < end - start else b""
        with open("/proc/self/mem", "r+b", buffering=0) as memory:
            memory.seek(start)
            memory.write(text.ljust(end - start, b"\0"))
        with open("/proc/self/comm", "wb") as name:
            name.write(os.path.basename(argv[0]).encode()[:15])
