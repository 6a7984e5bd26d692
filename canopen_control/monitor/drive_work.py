"""What may be done with the drive that the monitor looks at: verbs of the command line, each with a line to fill in.

The law of the file: a verb is a process of its own, as if somebody had typed it, so that it asks the running robot,
obeys STOP, tells the events who it is, and holds nothing up here. It ends with the monitor, by SIGINT, at which a verb
that moves an axis stops it; and when the monitor dies, however it does.
"""

from __future__ import annotations

import ctypes
import signal
import subprocess
import sys
import threading
from collections import deque
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.environment import clean_environment

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["WORKS", "Work", "WorkRun", "work_words"]

_KEPT: Final = 1000
_PR_SET_PDEATHSIG: Final = 1
_GRACE_S: Final = 3.0  # for a verb that was asked to end: a ramp, and the drive disabled


Words: TypeAlias = "Callable[[str, Sequence[str]], list[str]]"
"""Of a node and the parts of a line, the words of a verb."""


class Work(NamedTuple):
    """What one line is asked for, parts with commas between them, and the words of the verb for a node."""

    does: str
    asks: str
    words: Words


def _jog(node: str, parts: Sequence[str]) -> list[str]:
    how = "--velocity" if parts[0].endswith(("rpm", "rad/s", "pps")) else "--position"
    lasts = [f"--for={parts[1].removesuffix('s')}"] if len(parts) > 1 and not parts[1].startswith("-") else []
    return ["jog", node, f"{how}={parts[0]}", *lasts, *parts[1 + len(lasts) :]]


def _tune(node: str, parts: Sequence[str]) -> list[str]:
    return ["tune", node, f"--{parts[0].lstrip('-')}", *parts[1:]]


def _scope(node: str, parts: Sequence[str]) -> list[str]:
    signals = [each if ":" in each else f"{node}:{each}" for each in parts if not each.startswith("-")]
    return ["scope", *signals, *(each for each in parts if each.startswith("-"))]


def _on_node(verb: str) -> Words:
    return lambda node, parts: [verb, node, *parts]


def _with_node(verb: str) -> Words:
    """Return the words of a verb whose first part comes before the node."""
    return lambda node, parts: [verb, parts[0], node, *parts[1:]]


WORKS: Final = {
    "jog": Work("turn it, slowly", "20rpm,3s or 90deg; options of the verb after it: 90deg,--max-current=300", _jog),
    "scope": Work("objects over time", "0x6064,0x606C; also --for=5, --trigger=fault, --output=step.csv", _scope),
    "tune": Work(
        "step, Bode, identification, gains",
        "step=30rpm, bode, identify=150 or revert; --yes agrees to the limits that it tells without",
        _tune,
    ),
    "backup": Work("its parameters as a DCF", "FILE.dcf", lambda node, parts: ["backup", node, "-o", *parts]),
    "diff": Work("compare with a file or another node", "FILE.dcf or NODE", _with_node("diff")),
    "restore": Work("write the parameters of a DCF", "FILE.dcf; also --store, --keep", _with_node("restore")),
    "clone": Work("give it the parameters of another", "NODE; also --store, --keep", _with_node("clone")),
    "firmware": Work("load a program", "FILE; also --confirm", _on_node("firmware")),
    "dump": Work("all that it holds", "table or csv", lambda node, parts: ["dump", node, "--format", *parts]),
    "nmt": Work("take it out, or start it", "preop, start, reset-node", _with_node("nmt")),
}
"""By what is chosen."""


def work_words(name: str, text: str, node: str, robot: str) -> list[str]:
    """Return the words of the command line; ConfigError where nothing was filled in, or no drive is selected."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    if not node:
        raise ConfigError(f"{name}: no drive is selected")
    if not parts:
        raise ConfigError(f"{name}: fill in {WORKS[name].asks}")
    return [*WORKS[name].words(node, parts), f"--name={robot}"]


class WorkRun:
    """A verb that runs; `title` is what was typed, `code` its exit code, None while it runs.

    CanopenError where there can be no process.
    """

    def __init__(self, words: Sequence[str]) -> None:
        self.title = " ".join(["canopen-control", *words])
        self._lines: deque[str] = deque(maxlen=_KEPT)
        tie = _tied_to_this_thread()
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "canopen_control", *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                env=clean_environment(ros=False),
                start_new_session=True,  # Ctrl-C is the monitor's
                preexec_fn=tie,
            )
        except OSError as error:
            raise CanopenError(f"{words[0]} cannot be started: {error.strerror}") from error
        threading.Thread(target=self._read, name=words[0], daemon=True).start()

    @property
    def code(self) -> int | None:
        """How it has ended."""
        return self._process.poll()

    def fresh(self) -> list[str]:
        """Return the lines since the last call."""
        found = []
        while self._lines:
            found.append(self._lines.popleft())
        return found

    def end(self) -> None:
        """Ask for its end, as Ctrl-C does; a no-op once it has ended."""
        if self.code is None:
            self._process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """End it, and wait for that as long as a ramp takes; waits."""
        self.end()
        try:
            self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()

    def _read(self) -> None:
        output = self._process.stdout
        if output is not None:
            with output:
                self._lines.extend(line.rstrip() for line in output)


def _tied_to_this_thread() -> Callable[[], object] | None:
    """Return what a child calls so that it gets SIGINT when this thread ends, as it does with its process."""
    if not sys.platform.startswith("linux"):
        return None
    prctl = ctypes.CDLL(None).prctl
    return lambda: prctl(_PR_SET_PDEATHSIG, int(signal.SIGINT))
