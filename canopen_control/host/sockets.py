"""Unix sockets under names: where they live, who may use them, and which of them are alive.

They live in $XDG_RUNTIME_DIR/canopen_control, else in canopen_control-UID under the temporary folder. The folder is
ours alone: a folder (never a link to one), owned by this user, mode 0700, and its parent is one in which nobody else
can swap it. Anything else is refused with a sentence, never repaired in silence: somebody may be waiting inside.

A socket file outlives its process. It is stale when a connection to it is refused, and only `listen` removes one, under
a lock, so that of many who start at once exactly one serves. Both sides look at the other's user id.

Errors: what the user can mend is a ConfigError, a name in use is SocketInUse; OSError of a connection is the caller's.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import math
import os
import re
import socket
import stat
import struct
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from canopen_control.errors import CanopenError, ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


SocketKind = Literal["bus", "busctl", "drive", "robot"]
KINDS: Final[Mapping[SocketKind, int]] = {"bus": 32, "busctl": 32, "drive": 36, "robot": 32}
"""Kind of socket to the longest name it takes: the frames and the control of a `local:` bus, and one for each of its
virtual drives, `drive_name`, and for each robot."""
_NAME: Final = re.compile(r"[A-Za-z0-9_-]+")
_LONGEST_PATH: Final = 100  # struct sockaddr_un has 108 bytes on Linux, 104 elsewhere
_PROBE_S: Final = 0.5  # a listening process' kernel answers at once, whatever the process does
_LOCK_POLL_S: Final = 0.005
_LINUX: Final = sys.platform.startswith("linux")
_UCRED: Final = struct.Struct("3i")  # pid, uid, gid
_umask = threading.Lock()  # the umask is the process', not the thread's


class SocketInUse(CanopenError):
    """A living process serves this name already; `pid` is its process id, or 0 where that cannot be told."""

    def __init__(self, path: Path, pid: int) -> None:
        self.path, self.pid = path, pid
        super().__init__(f"{path.stem} is in use" + (f" by process {pid}" if pid else "") + f" ({path})")


# -- where


def runtime_dir() -> Path:
    """Return the folder of this user's sockets, made if need be; ConfigError when it cannot be trusted."""
    base = os.environ.get("XDG_RUNTIME_DIR", "")
    if base.startswith("/") and os.path.isdir(base):
        return private_folder(Path(base) / "canopen_control")
    import tempfile  # seldom needed, and it loads half of the library

    return private_folder(Path(tempfile.gettempdir()) / f"canopen_control-{os.getuid()}")


def private_folder(path: Path) -> Path:
    """Return `path`, made with mode 0700 if it is missing, after a look at what is really there."""
    _refuse_open_parent(path.parent)
    try:
        with contextlib.suppress(FileExistsError):
            path.mkdir(mode=0o700)
        found = os.lstat(path)
    except OSError as error:
        raise ConfigError(f"cannot make {path}: {error.strerror}; set XDG_RUNTIME_DIR to a folder of yours") from error
    problem = _distrust(found)
    if problem:
        raise ConfigError(f"{path} cannot hold sockets: {problem}")
    return path


def _distrust(found: os.stat_result) -> str:
    if stat.S_ISLNK(found.st_mode):
        return "it is a symbolic link; remove it"
    if not stat.S_ISDIR(found.st_mode):
        return "it is no folder; remove it"
    if found.st_uid != os.getuid():
        return f"it belongs to user id {found.st_uid}, not to yours ({os.getuid()}); remove it or set XDG_RUNTIME_DIR"
    if stat.S_IMODE(found.st_mode) & 0o077:
        return f"others have access to it (mode {stat.S_IMODE(found.st_mode):04o}); chmod 700 it"
    return ""


def _refuse_open_parent(parent: Path) -> None:
    """Refuse a parent in which another user could put a folder of his own in place of ours."""
    try:
        found = parent.stat()
    except OSError as error:
        raise ConfigError(f"no folder {parent} for the sockets: {error.strerror}; set XDG_RUNTIME_DIR") from error
    if found.st_uid not in (0, os.getuid()):
        raise ConfigError(
            f"{parent} belongs to user id {found.st_uid}, not to yours ({os.getuid()}); "
            "set XDG_RUNTIME_DIR to a folder of yours, or unset it"
        )
    if found.st_mode & stat.S_IWOTH and not found.st_mode & stat.S_ISVTX:
        raise ConfigError(f"everybody may write to {parent}, and it is not sticky; set XDG_RUNTIME_DIR to another")


def drive_name(channel: str, node_id: int) -> str:
    """Return the name of the control socket of a virtual drive, `<bus>-<node>`; `channel` is the bus' with its kind."""
    bus = channel
    for kind in ("local:", "memory:", "virtual:"):
        bus = bus.removeprefix(kind)
    safe = "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in bus)
    return f"{safe[:31]}-{node_id}"


def check_name(name: str, longest: int = 32) -> str:
    """Return `name` if it can be the name of a bus or a robot; ConfigError otherwise."""
    if len(name) > longest or not _NAME.fullmatch(name):
        raise ConfigError(f"{name!r} is no name: use 1 to {longest} of A-Z a-z 0-9 _ -")
    return name


def socket_path(kind: SocketKind, name: str) -> Path:
    """Return the path of the socket `name`; `kind` is one of `KINDS`."""
    file = f"{kind}-{check_name(name, KINDS[kind])}.sock"
    folder = runtime_dir()
    path = folder / file
    return path if len(os.fsencode(path)) <= _LONGEST_PATH else _short_folder(folder) / file


def _short_folder(folder: Path) -> Path:
    """Return a folder with a short path that stands in for `folder`, one for each of them."""
    import hashlib

    digest = hashlib.sha256(os.fsencode(folder)).hexdigest()[:12]
    return private_folder(private_folder(Path("/tmp") / f"canopen_control-{os.getuid()}") / digest)


def list_sockets(kind: SocketKind) -> list[str]:
    """Return the names of this kind behind which somebody listens, sorted."""
    folder = runtime_dir()
    longest = folder / f"{kind}-{'x' * KINDS[kind]}.sock"
    folders = [folder] if len(os.fsencode(longest)) <= _LONGEST_PATH else [folder, _short_folder(folder)]
    paths = [path for place in folders for path in place.glob(f"{kind}-*.sock") if _is_alive(path)]
    return sorted({path.stem.removeprefix(f"{kind}-") for path in paths})


# -- who


def _peer(sock: socket.socket) -> tuple[int, int] | None:
    """Return the process id (0 if unknown) and the user id of the other end, or None if it is gone already."""
    try:
        if _LINUX:
            pid, uid, _ = _UCRED.unpack(sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size))
            return pid, uid
        # struct xucred of the BSDs: version, uid, ...; LOCAL_PEERCRED is 1 at level 0
        return 0, struct.unpack_from("=Ii", sock.getsockopt(0, 1, 76))[1]
    except OSError:
        return None


def same_user(sock: socket.socket) -> bool:
    """Tell whether the other end of a Unix socket runs under this process' user id."""
    peer = _peer(sock)
    return peer is not None and peer[1] == os.getuid()


def peer_pid(sock: socket.socket) -> int:
    """Return the process id of the other end of a Unix socket, 0 where that cannot be told."""
    peer = _peer(sock)
    return peer[0] if peer is not None else 0


# -- opening


@contextlib.contextmanager
def lock(path: Path, timeout: float = 10.0) -> Iterator[None]:
    """Hold the lock that belongs to `path` (the file `<path>.lock`) across processes and threads.

    Waits up to `timeout` seconds for whoever has it, then raises CanopenError. The kernel frees it with its holder.
    """
    fd = open_lock(Path(f"{path}.lock"))
    try:
        _flock(fd, path, time.monotonic() + timeout)
        yield
    finally:
        os.close(fd)


def open_lock(path: Path) -> int:
    """Return a descriptor of the lock file `path`, made if need be; ConfigError for what is no file of ours."""
    try:
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o600)
    except OSError as error:
        reason = "it is a symbolic link" if error.errno == errno.ELOOP else error.strerror or str(error)
        advice = "make room there" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "remove it"
        raise ConfigError(f"{path} cannot be a lock: {reason}; {advice}, and try again") from error
    if not stat.S_ISREG(os.fstat(fd).st_mode):
        os.close(fd)
        raise ConfigError(f"{path} cannot be a lock: it is no file; remove it, and try again")
    return fd


def claim(path: Path, timeout: float = 0.0) -> int:
    """Hold a lock file as long as this process lives, with its id in it; SocketInUse with that of who holds it.

    Waits up to `timeout` seconds for him to end. Closing the descriptor that is returned lets go of it.
    """
    fd = open_lock(path)
    try:
        _flock(fd, path, time.monotonic() + timeout)
    except CanopenError:
        owner = os.pread(fd, 16, 0).decode(errors="replace").strip()
        os.close(fd)
        raise SocketInUse(path, int(owner) if owner.isdecimal() else 0) from None
    os.truncate(fd, 0)
    os.write(fd, f"{os.getpid()}\n".encode())
    return fd


def _flock(fd: int, path: Path, deadline: float) -> None:
    while True:
        try:
            return fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= deadline:
                raise CanopenError(f"another process has held {path}.lock for too long; is one stuck?") from None
        time.sleep(_LOCK_POLL_S)


def listen(path: Path, backlog: int = 64) -> socket.socket:
    """Return a non-blocking listening socket at `path`, in place of a stale one; SocketInUse if it is served already.

    End it with `close_listener`, which removes the file too.
    """
    # not the lock of `path` itself: whoever starts a server may hold that one until the server listens
    with lock(path.with_name(path.name + ".listen")):
        _remove_stale(path)
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            _bind_private(sock, path)
            sock.listen(backlog)
            sock.setblocking(False)
        except BaseException:
            sock.close()
            raise
    return sock


def _bind_private(sock: socket.socket, path: Path) -> None:
    with _umask:
        previous = os.umask(0o077)
        try:
            sock.bind(str(path))
        finally:
            os.umask(previous)


def _remove_stale(path: Path) -> None:
    try:
        found = os.lstat(path)
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(found.st_mode):
        raise ConfigError(f"{path} is no socket; remove it")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        if _answers(probe, path):
            raise SocketInUse(path, peer_pid(probe))
    path.unlink(missing_ok=True)


def _is_alive(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        return _answers(probe, path)


def _answers(probe: socket.socket, path: Path) -> bool:
    """Tell whether somebody listens at `path`; a full queue of connections is a sign of life."""
    probe.settimeout(_PROBE_S)
    try:
        probe.connect(str(path))
    except (ConnectionRefusedError, FileNotFoundError):
        return False
    except (TimeoutError, BlockingIOError):
        return True
    except OSError as error:
        if error.errno == errno.ENOTSOCK:
            return False
        raise
    return True


def close_listener(sock: socket.socket) -> None:
    """Remove the socket's file, then close it; a second close is a no-op."""
    if sock.fileno() < 0:
        return
    # While it still listens nobody takes it for stale, so that the file is surely this socket's.
    with contextlib.suppress(OSError):
        os.unlink(sock.getsockname())
    sock.close()


def _timeval(seconds: float) -> bytes:
    """Return a `struct timeval`, at least 1 us where it is a time at all."""
    whole, part = divmod(math.ceil(seconds * 1_000_000), 1_000_000)
    return struct.pack("@ll", whole, part)


def connect(path: Path, timeout: float | None = 5.0) -> socket.socket:
    """Return a connection to `path` with this timeout set.

    OSError from the system: FileNotFoundError and ConnectionRefusedError mean that nobody is there, BlockingIOError
    that the server has let it wait for all of the timeout. CanopenError when the server is another user's.
    """
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        if timeout:
            # A socket with a timeout of Python's would not wait where the queue of connections is full: a STOP was
            # refused at once while strangers came and went.
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _timeval(timeout))
        sock.connect(str(path))
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _timeval(0.0))
        sock.settimeout(timeout)
        if not same_user(sock):
            raise CanopenError(f"{path} is served by another user; not talking to it")
    except BaseException:
        sock.close()
        raise
    return sock
