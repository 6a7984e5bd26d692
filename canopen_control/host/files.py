"""Files on a disk that may be full: complete writes, and rotated logs of child processes.

Errors name the file and say what is left of it. A child keeps its log open, so that the log can only be rotated
in place: the content is copied to `<name>.log.1` and the file is truncated; the child writes in append mode and
continues at the start. The kernel copies, on a thread without the interpreter lock. Output during this millisecond is
lost; a line in the file reports the loss.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shlex
import shutil
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.errors import CanopenError, ConfigError, DiskFull

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from typing import BinaryIO


#: errors that end a write in progress: no space, quota or size limit, a broken disk
FULL: Final = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO))
NO_SPACE: Final = frozenset((errno.ENOSPC, errno.EDQUOT))


def make_private(path: str | Path) -> None:
    """Create an empty file that only the user can access, unless it exists; raise OSError on failure.

    Logs of robots are private, and later openers keep the mode of the file.
    """
    with contextlib.suppress(FileExistsError):
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600))


def write_whole(path: str | Path, data: bytes) -> None:
    """Write a file completely, or leave it unchanged and raise DiskFull if the disk is full, else ConfigError.

    A device or a pipe cannot be replaced: it gets the data directly, possibly only a part before an error.
    """
    path = Path(path)
    if path.exists() and not path.is_file():  # a device or a pipe cannot be replaced
        with telling(path, "a part of the data was written"):
            path.write_bytes(data)
        return
    target = path.resolve()  # a symbolic link is kept
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        with telling(path, "the file is unchanged" if path.exists() else "nothing was written"):
            part.write_bytes(data)
            with contextlib.suppress(OSError):
                part.chmod(target.stat().st_mode)
            os.replace(part, target)
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


@contextlib.contextmanager
def telling(path: str | Path, remains: str) -> Iterator[None]:
    """Convert an OSError during a write to `path` to DiskFull, with the text `remains`, or to ConfigError."""
    try:
        yield
    except OSError as error:
        raise failed(path, error, remains) from error


def failed(path: str | Path, error: OSError, remains: str) -> CanopenError:
    """Return the error for an OSError during a write to `path`: DiskFull if the disk is full, else ConfigError."""
    reason = error.strerror or str(error)
    if error.errno in FULL:
        return DiskFull(str(path), reason, f"{remains}{space_advice(path, error)}")
    return ConfigError(f"{path} cannot be written: {reason}")


def space_advice(path: str | Path, error: OSError) -> str:
    """Return advice naming the full file system of `path`, such as "; free some space on ...", or "" if not full."""
    if error.errno not in NO_SPACE:
        return ""
    place = Path(os.path.realpath(path))
    mount = next(folder for folder in (place, *place.parents) if os.path.ismount(folder) or folder == folder.parent)
    return f"; free some space on the file system of {mount}"


LIMIT: Final = 10_000_000
_TAIL: Final = 8192
_ROTATED: Final = b"--- rotated: earlier output is in the file with the suffix .1; a line may be missing here\n"


def state_dir(name: str = "") -> Path:
    """Return the log folder of the robot or bus `name`, below $XDG_STATE_HOME or ~/.local/state."""
    base = os.environ.get("XDG_STATE_HOME", "")
    root = Path(base) if base.startswith("/") else Path.home() / ".local" / "state"
    return root / "canopen_control" / name


class LogFile:
    """Log of a child process, `<folder>/<name>.log`; `limit` is the approximate maximum length in bytes."""

    def __init__(self, folder: Path, name: str, *, limit: int = LIMIT) -> None:
        self.path = folder / f"{name}.log"
        self._limit = limit
        self._start = 0  # position at which the output of this run begins
        self._busy: threading.Thread | None = None

    @contextlib.contextmanager
    def opened_for(self, argv: Sequence[str]) -> Iterator[BinaryIO]:
        """Open the log for a child and write a start line; raise ConfigError or DiskFull if that fails."""
        try:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if self.path.exists() and self.path.stat().st_size > self._limit:
                self.path.replace(self._old)
            make_private(self.path)
            file = open(self.path, "ab", buffering=0)  # noqa: SIM115 - closed below; errors of opening are handled separately
            os.fchmod(file.fileno(), 0o600)  # created by an older version
            command = " ".join(shlex.join(argv).split())
            file.write(f"--- {time.strftime('%Y-%m-%d %H:%M:%S')} {command}\n".encode(errors="replace"))
            self._start = file.tell()
        except OSError as error:
            title = f"cannot write the log {self.path}"
            if advice := space_advice(self.path, error):
                raise DiskFull(title, error.strerror or str(error), f"its process was not started{advice}") from error
            raise ConfigError(f"{title}: {error.strerror}; set XDG_STATE_HOME to a writable folder") from error
        with file:
            yield file

    @property
    def _old(self) -> Path:
        return self.path.with_name(self.path.name + ".1")

    def last_lines(self, count: int) -> list[str]:
        """Return at most the last `count` lines of this run; empty if the file was removed."""
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
        """Rotate the log on a thread if it exceeds the limit; the check itself takes microseconds."""
        with contextlib.suppress(OSError):
            if self.path.stat().st_size <= self._limit or (self._busy is not None and self._busy.is_alive()):
                return
            self._busy = threading.Thread(target=self.rotate, name=f"rotate {self.path.name}", daemon=True)
            self._busy.start()

    def rotate(self) -> None:
        """Copy the log to a file whose name ends in `.1`, and truncate the log."""
        with contextlib.suppress(OSError):  # disk full: truncating still helps
            make_private(self._old)
            shutil.copyfile(self.path, self._old)
        with contextlib.suppress(OSError):
            os.truncate(self.path, 0)
            with open(self.path, "ab", buffering=0) as file:
                file.write(_ROTATED)
        self._start = 0
