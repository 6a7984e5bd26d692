"""Programs of a test as forks of one process that has imported the package: in a guest, an interpreter takes seconds.

A child is what `canopen_control.host.fork` makes of a robot's children: a session, a command line, an environment and
descriptors of its own. Its modules are those of the server; everything else begins with it.
"""

from __future__ import annotations

import atexit
import functools
import importlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

#: modules that the programs of the guests import
MODULES = (
    *(f"canopen_control.cli.{verb}" for verb in ("axis", "bus", "command", "drive", "main", "run", "stop", "twist")),
    "canopen_control.cli.support.target",
    "canopen_control.client.drive_client",
    "canopen_control.controllers.diff_drive",
    "canopen_control.controllers.forward_command",
    "canopen_control.controllers.joint_state",
    "canopen_control.runtime.run_session",
    "canopen_control.runtime.setup",
    "canopen_control.virtual.control",
    "canopen_control.virtual.device",
    "canopen_control.virtual.launch",
    "canopen_control.virtual.node_host",
    "canopen_control.virtual.process",
)
_TESTS = str(Path(__file__).parents[1])
_ROOM = "x" * 8192  # command line and environment of a child overwrite those of the server
_OF_A_TEST = ("XDG_RUNTIME_DIR", "XDG_STATE_HOME")  # a test identifies its processes by these variables


class ForkedProgram:
    """A child of the server, with the methods of `subprocess.Popen` that tests need."""

    def __init__(self, server: ForkServer, arguments: Sequence[str], pid: int) -> None:
        self.args, self.pid = arguments, pid
        self.returncode: int | None = None
        self._server, self._descriptor = server, os.pidfd_open(pid)

    def poll(self) -> int | None:
        """Return the exit code, negative for a signal; None while it runs."""
        return self._wait(0)

    def wait(self, timeout: float) -> int:
        """Wait for its end; return the exit code."""
        code = self._wait(timeout)
        if code is None:
            raise subprocess.TimeoutExpired(list(self.args), timeout)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal; a no-op once it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def _wait(self, seconds: float) -> int | None:
        if self.returncode is None:
            poller = select.poll()
            poller.register(self._descriptor, select.POLLIN)
            if poller.poll(1000 * seconds):
                self.returncode = self._server.ask({"code_of": self.pid})
                os.close(self._descriptor)
        return self.returncode


class ForkServer:
    """The process that has imported the package; it ends with this one."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        code = (
            f"import sys; sys.path.insert(0, {_TESTS!r}); from support.fork_server import serve; "
            f"del sys.path[0]; serve({theirs.fileno()})"
        )
        environment = {name: value for name, value in os.environ.items() if name not in _OF_A_TEST}
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", code],
                pass_fds=[theirs.fileno()],
                env={**environment, "ROOM_OF_CHILDREN": _ROOM},
                stdin=subprocess.DEVNULL,
            )
        self._stream = ours.makefile("rw")
        ours.close()
        atexit.register(self._end)

    def start(
        self, arguments: Sequence[str], folder: Path, environment: dict[str, str], out: Path, err: Path
    ) -> ForkedProgram:
        """Start `canopen-control ARGUMENTS` in a folder, with its output in two files."""
        words, files = list(arguments), [str(out), str(err)]
        pid = self.ask({"words": words, "folder": str(folder), "environment": environment, "files": files})
        return ForkedProgram(self, words, pid)

    def ask(self, request: dict[str, Any]) -> int:
        print(json.dumps(request), file=self._stream, flush=True)
        answer = self._stream.readline()
        assert answer, "the server of forks has ended"
        return int(answer)

    def _end(self) -> None:
        self._stream.close()
        self._process.wait()


@functools.cache
def fork_server() -> ForkServer:
    """Return the server of this process."""
    return ForkServer()


# ---------------------------------------------------------------------------------------------- in the server


def serve(descriptor: int) -> None:
    """Fork on request, and say how the children ended, until the other end is closed."""
    from canopen_control.host.fork import ForkedProcess, fork

    for module in MODULES:
        importlib.import_module(module)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # SIGINT of the terminal: the tests end first
    children: dict[int, ForkedProcess] = {}
    with socket.socket(fileno=descriptor) as connection, connection.makefile("rw") as stream:
        for line in stream:
            request = json.loads(line)
            if "code_of" in request:
                answer = children.pop(request["code_of"]).wait()
            else:
                child = _fork(fork, request)
                children[child.pid] = child
                answer = child.pid
            print(answer, file=stream, flush=True)
    for child in children.values():  # the tests were ended before they could end them
        if child.poll() is None:
            os.kill(child.pid, signal.SIGKILL)


def _fork(fork: Any, request: dict[str, Any]) -> Any:
    words, (out, err) = request["words"], request["files"]
    with open(out, "wb") as output:
        return fork(
            (__name__, [err, request["folder"], *words]),
            [sys.executable, "-m", "canopen_control", *words],
            request["environment"],
            output=output.fileno(),
            keep=(),
        )


def main(arguments: list[str]) -> int:
    """Run the command line in the child: standard error's file, the folder, and its words."""
    from canopen_control.cli.main import main as command_line

    err, folder, *words = arguments
    with open(err, "wb") as file:
        os.dup2(file.fileno(), 2)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.chdir(folder)
    sys.path.insert(0, folder)
    sys.argv = ["canopen-control", *words]
    return command_line()
