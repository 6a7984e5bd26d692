"""Runs the real xacro over a file, in a process of its own.

The law of the file: an expression that never ends, or that takes all memory, is the user's mistake and costs him a
sentence, not his computer; so xacro gets a process that the kernel ends when its time or memory is over, and this one
never imports it. The process is begun early (`XacroRun`), so that who has other files to read need not wait for it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.errors import RobotConfigError
from canopen_control.urdf import xacro_child

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from types import TracebackType

__all__ = ["XacroLimits", "XacroRun"]

_HINT: Final = "look for a power, a range or a macro in it that never ends"


@dataclass(frozen=True, slots=True)
class XacroLimits:
    """What one xacro file may take: s of the processor, s, bytes of memory."""

    processor_s: int = 10
    wall_s: int = 30
    memory: int = 1 << 30


class XacroRun:
    """One run of xacro over `path`, begun at once; `close` ends it, wanted or not.

    `mappings` are its arguments; one that it does not have is refused, unless its name ends in `?`.
    """

    def __init__(self, path: Path, mappings: Mapping[str, str], limits: XacroLimits | None = None) -> None:
        self._path, self._limits = path, limits or XacroLimits()
        # Isolated and without site it starts in a third of the time; what it imports is found where we find it.
        folders = "\n".join(each for each in sys.path if os.path.isabs(each))
        numbers = (self._limits.processor_s, self._limits.wall_s, self._limits.memory)
        arguments = [folders, os.fspath(path), *map(str, numbers), *(f"{key}:={mappings[key]}" for key in mappings)]
        command = [sys.executable, "-I", "-S", xacro_child.__file__, *arguments]
        lifeline, self._lifeline = os.pipe()  # it ends with us, however we end
        try:
            self._process = subprocess.Popen(command, stdin=lifeline, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        except (OSError, ValueError) as error:
            os.close(self._lifeline)
            reason = error.strerror if isinstance(error, OSError) else error
            raise RobotConfigError(f"{path}: xacro cannot be started: {reason}") from error
        finally:
            os.close(lifeline)

    def __enter__(self) -> XacroRun:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End the process if it still runs; a second call does nothing."""
        if self._lifeline >= 0:
            os.close(self._lifeline)
            self._lifeline = -1
        self._process.kill()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def result(self) -> str:
        """Wait for the URDF text; RobotConfigError if there is none."""
        try:
            answer, _ = self._process.communicate(timeout=self._limits.wall_s)
        except subprocess.TimeoutExpired:
            raise RobotConfigError(self._ended(-signal.SIGALRM)) from None
        if answer[:1] == xacro_child.URDF:
            return answer[1:].decode("utf-8")
        reason = answer[1:].decode("utf-8", "replace")
        raise RobotConfigError(f"{self._path}: xacro: {reason}" if reason else self._ended(self._process.returncode))

    def _ended(self, code: int) -> str:
        """Say why there is no answer."""
        if code in (-signal.SIGXCPU, -signal.SIGKILL):  # the kernel sends the second where both limits are one
            return f"{self._path}: xacro took more than {self._limits.processor_s} s of the processor; {_HINT}"
        if code == -signal.SIGALRM:
            return f"{self._path}: xacro took more than {self._limits.wall_s} s; {_HINT}"
        return f"{self._path}: xacro ended without an answer (exit code {code}), as for want of memory; {_HINT}"
