"""The log file of a child process, which the child itself writes, and which cannot fill the disk.

The child holds the file open, so that it can only be rotated in place: what it holds is copied to `<name>.log.1` and
the file is emptied; the child writes in append mode and goes on at the start. The copy is the kernel's work, on a
thread that does not hold the interpreter lock meanwhile. What is written during that millisecond is lost; the file
says so.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from typing import BinaryIO

__all__ = ["LogFile", "state_dir"]

LIMIT: Final = 10_000_000
_TAIL: Final = 8192
_ROTATED: Final = b"--- rotated: what came before is in the file that ends in .1; a line may be missing here\n"


def state_dir(name: str = "") -> Path:
    """Return the folder for the logs of the robot or bus `name`: below $XDG_STATE_HOME, else ~/.local/state."""
    base = os.environ.get("XDG_STATE_HOME", "")
    root = Path(base) if base.startswith("/") else Path.home() / ".local" / "state"
    return root / "canopen_control" / name


class LogFile:
    """The file `<folder>/<name>.log`; `limit` is its greatest length in bytes, more or less."""

    def __init__(self, folder: Path, name: str, *, limit: int = LIMIT) -> None:
        self.path = folder / f"{name}.log"
        self._limit = limit
        self._start = 0  # where the output of this run begins
        self._busy: threading.Thread | None = None

    @contextlib.contextmanager
    def opened_for(self, argv: Sequence[str]) -> Iterator[BinaryIO]:
        """Open it for a child to inherit, with a line that says what starts; ConfigError when it cannot be written."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if self.path.exists() and self.path.stat().st_size > self._limit:
                self.path.replace(self._old)
            file = open(self.path, "ab", buffering=0)  # noqa: SIM115 - closed below, errors of opening apart
            command = " ".join(shlex.join(argv).split())
            file.write(f"--- {time.strftime('%Y-%m-%d %H:%M:%S')} {command}\n".encode(errors="replace"))
            self._start = file.tell()
        except OSError as error:
            raise ConfigError(
                f"cannot write the log {self.path}: {error.strerror}; set XDG_STATE_HOME to a folder of yours"
            ) from error
        with file:
            yield file

    @property
    def _old(self) -> Path:
        return self.path.with_name(self.path.name + ".1")

    def last_lines(self, count: int) -> list[str]:
        """Return the last lines of this run, at most `count`; none when the file is gone."""
        try:
            with open(self.path, "rb") as file:
                size = file.seek(0, os.SEEK_END)
                start = min(self._start, size) if size >= self._start else 0
                file.seek(max(start, size - _TAIL))
                text = file.read(_TAIL).decode(errors="replace")
        except OSError:
            return []
        return text.splitlines()[-count:]

    def rotate_if_long(self) -> None:
        """Rotate it, on a thread, when it is longer than the limit; looking takes microseconds."""
        with contextlib.suppress(OSError):
            if self.path.stat().st_size <= self._limit or (self._busy is not None and self._busy.is_alive()):
                return
            self._busy = threading.Thread(target=self.rotate, name=f"rotate {self.path.name}", daemon=True)
            self._busy.start()

    def rotate(self) -> None:
        """Copy it to `.1` and empty it."""
        with contextlib.suppress(OSError):  # a full disk: emptying it is what helps
            shutil.copyfile(self.path, self._old)
        with contextlib.suppress(OSError):
            os.truncate(self.path, 0)
            with open(self.path, "ab", buffering=0) as file:
                file.write(_ROTATED)
        self._start = 0
