"""Named Unix sockets: their paths, access rights, whether a process listens, and the running robots that they name.

The sockets are in $XDG_RUNTIME_DIR/canopen_control, or in canopen_control-UID in the temporary folder. The folder must
be private: a folder (not a link), owned by this user, with mode 0700, in a parent where no other user can replace it.
Anything else is refused with a message, never repaired silently, because it may be an attack.

A socket file outlives its process. It is stale if a connection to it is refused. Only `listen` removes a stale file,
under a lock, so that of several processes that start at once exactly one listens. Client and server check each other's
user id.

Errors: ConfigError for what the user can repair, DiskFull without space, SocketInUse for a name in use; OSErrors of a
connection are raised as they are.
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

from canopen_control.errors import CanopenError, ConfigError, DiskFull, NoRobotError, nearest

TYPE_CHECKING = False  # the module typing takes longer to import than this one
if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from typing import Final, Literal

    SocketKind = Literal["bus", "busctl", "drive", "gateway", "robot"]


KINDS: Final[Mapping[SocketKind, int]] = {"bus": 32, "busctl": 32, "drive": 36, "gateway": 32, "robot": 32}
"""Maximum name length by kind of socket: frames and control of a `local:` bus, one per virtual drive (see
`drive_name`), one per gateway of CiA 309-3, one per robot."""
_NAME: Final = re.compile(r"[A-Za-z0-9_-]+")
_LONGEST_PATH: Final = 100  # struct sockaddr_un has 108 bytes on Linux, 104 elsewhere
_PROBE_S: Final = 0.5  # the kernel accepts at once for a listening process, even a busy one
_LOCK_POLL_S: Final = 0.005
_LINUX: Final = sys.platform.startswith("linux")
_UCRED: Final = struct.Struct("3i")  # pid, uid, gid
_OWN_FOLDER: Final = "set XDG_RUNTIME_DIR to a folder that you own"
_umask = threading.Lock()  # the umask belongs to the process, not to the thread


class SocketInUse(CanopenError):
    """Error for a name on which a process already listens; `pid` is the process id, 0 if unknown."""

    def __init__(self, path: Path, pid: int) -> None:
        self.path, self.pid = path, pid
        super().__init__(f"{path.stem} is in use" + (f" by process {pid}" if pid else "") + f" ({path})")


# -- paths


def runtime_dir() -> Path:
    """Return the folder of this user's sockets, and create it if missing; raise ConfigError if it is not private."""
    base = os.environ.get("XDG_RUNTIME_DIR", "")
    if base.startswith("/") and os.path.isdir(base):
        return private_folder(Path(base) / "canopen_control")
    import tempfile  # rarely needed, and it imports half of the standard library

    return private_folder(Path(tempfile.gettempdir()) / f"canopen_control-{os.getuid()}")


def private_folder(path: Path) -> Path:
    """Return the folder `path`, and create it with mode 0700 if missing; raise ConfigError if it is not private."""
    _refuse_open_parent(path.parent)
    try:
        with contextlib.suppress(FileExistsError):
            path.mkdir(mode=0o700)
        status = os.lstat(path)
    except OSError as error:
        raise _not_created(path, error) from error
    problem = _distrust(status)
    if problem:
        raise ConfigError(f"{path} cannot be used for sockets: {problem}")
    return path


def _not_created(path: Path, error: OSError, advice: str = _OWN_FOLDER) -> CanopenError:
    """Return the error for a folder or socket that cannot be created: DiskFull without space, else ConfigError."""
    from canopen_control.host.files import space_advice  # rarely needed

    reason = error.strerror or str(error)
    if space := space_advice(path, error):
        return DiskFull(f"cannot create {path}", reason, f"nothing was started{space}")
    return ConfigError(f"cannot create {path}: {reason}; {advice}")


def _distrust(status: os.stat_result) -> str:
    if stat.S_ISLNK(status.st_mode):
        return "it is a symbolic link; remove it"
    if not stat.S_ISDIR(status.st_mode):
        return "it is not a folder; remove it"
    if status.st_uid != os.getuid():
        return f"it belongs to user id {status.st_uid}, not to yours ({os.getuid()}); remove it or set XDG_RUNTIME_DIR"
    if stat.S_IMODE(status.st_mode) & 0o077:
        return f"other users have access to it (mode {stat.S_IMODE(status.st_mode):04o}); run chmod 700 on it"
    return ""


def _refuse_open_parent(parent: Path) -> None:
    """Raise ConfigError if `parent` cannot be used, or if another user could replace a folder in it."""
    try:
        status = parent.stat()
    except OSError as error:
        raise ConfigError(f"cannot use {parent} for sockets: {error.strerror}; {_OWN_FOLDER}") from error
    if status.st_uid not in (0, os.getuid()):
        raise ConfigError(
            f"{parent} belongs to user id {status.st_uid}, not to yours ({os.getuid()}); {_OWN_FOLDER}, or unset it"
        )
    if status.st_mode & stat.S_IWOTH and not status.st_mode & stat.S_ISVTX:
        raise ConfigError(f"{parent} is writable for all users and has no sticky bit; {_OWN_FOLDER}")


def drive_name(channel: str, node_id: int) -> str:
    """Return the name of the control socket of a virtual drive, `<bus>-<node>`.

    `channel` is the name of the channel with its kind, such as "local:can0".
    """
    bus = channel
    for kind in ("local:", "memory:", "virtual:"):
        bus = bus.removeprefix(kind)
    safe = "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in bus)
    return f"{safe[:31]}-{node_id}"


def check_name(name: str, longest: int = 32) -> str:
    """Return `name` if it is a valid name of a bus or robot, else raise ConfigError."""
    if len(name) > longest or not _NAME.fullmatch(name):
        raise ConfigError(f"{name!r} is not a valid name: use 1 to {longest} of A-Z a-z 0-9 _ -")
    return name


def socket_path(kind: SocketKind, name: str) -> Path:
    """Return the path of the socket of a bus, drive, gateway or robot; raise ConfigError for an invalid name."""
    file = f"{kind}-{check_name(name, KINDS[kind])}.sock"
    folder = runtime_dir()
    path = folder / file
    return path if len(os.fsencode(path)) <= _LONGEST_PATH else _short_folder(folder) / file


def _short_folder(folder: Path) -> Path:
    """Return a private folder with a short path that is always the same for `folder`."""
    import hashlib

    digest = hashlib.sha256(os.fsencode(folder)).hexdigest()[:12]
    return private_folder(private_folder(Path("/tmp") / f"canopen_control-{os.getuid()}") / digest)


def list_sockets(kind: SocketKind) -> list[str]:
    """Return the names of all sockets of this kind on which a process listens, sorted."""
    folder = runtime_dir()
    longest = folder / f"{kind}-{'x' * KINDS[kind]}.sock"
    folders = [folder] if len(os.fsencode(longest)) <= _LONGEST_PATH else [folder, _short_folder(folder)]
    paths = [path for place in folders for path in place.glob(f"{kind}-*.sock") if _is_alive(path)]
    return sorted({path.stem.removeprefix(f"{kind}-") for path in paths})


# -- peers


def _peer(sock: socket.socket) -> tuple[int, int] | None:
    """Return the process id (0 if unknown) and the user id of a socket's peer, or None if the peer is gone."""
    try:
        if _LINUX:
            pid, uid, _ = _UCRED.unpack(sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size))
            return pid, uid
        # struct xucred of the BSDs: version, uid, ...; LOCAL_PEERCRED is 1 at level 0
        return 0, struct.unpack_from("=Ii", sock.getsockopt(0, 1, 76))[1]
    except OSError:
        return None


def same_user(sock: socket.socket) -> bool:
    """Whether the peer of a Unix socket has the user id of this process."""
    peer = _peer(sock)
    return peer is not None and peer[1] == os.getuid()


def peer_pid(sock: socket.socket) -> int:
    """Return the process id of a Unix socket's peer, or 0 if unknown."""
    peer = _peer(sock)
    return peer[0] if peer is not None else 0


# -- opening


@contextlib.contextmanager
def lock(path: Path, timeout: float = 10.0) -> Iterator[None]:
    """Context in which the lock of `path` (the file `<path>.lock`) is held across processes and threads.

    Entering waits up to `timeout` s for the current holder, then raises CanopenError. The kernel releases the lock when
    the holder ends.
    """
    fd = open_lock(Path(f"{path}.lock"))
    try:
        _flock(fd, path, time.monotonic() + timeout)
        yield
    finally:
        os.close(fd)


def open_lock(path: Path) -> int:
    """Open the lock file `path`, which is created if missing, and return its descriptor.

    Raise ConfigError if it cannot be opened or is not a regular file.
    """
    try:
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o600)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise _not_created(path, error) from error
        reason = "it is a symbolic link" if error.errno == errno.ELOOP else error.strerror or str(error)
        raise ConfigError(f"{path} cannot be a lock: {reason}; remove it, and try again") from error
    if not stat.S_ISREG(os.fstat(fd).st_mode):
        os.close(fd)
        raise ConfigError(f"{path} cannot be a lock: it is not a file; remove it, and try again")
    return fd


def claim(path: Path, timeout: float = 0.0) -> int:
    """Lock a file until this process ends, write the process id into it, and return its descriptor.

    Raise SocketInUse with its process id if another process still holds the lock after `timeout` s.
    Closing the returned descriptor releases the lock.
    """
    fd = open_lock(path)
    try:
        _flock(fd, path, time.monotonic() + timeout)
    except CanopenError:
        owner = os.pread(fd, 16, 0).decode(errors="replace").strip()
        os.close(fd)
        raise SocketInUse(path, int(owner) if owner.isdecimal() else 0) from None
    with contextlib.suppress(OSError):  # disk full: the lock holds, but its owner is unknown
        os.truncate(fd, 0)
        os.write(fd, f"{os.getpid()}\n".encode())
    return fd


def _flock(fd: int, path: Path, deadline: float) -> None:
    while True:
        try:
            return fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= deadline:
                raise CanopenError(
                    f"another process holds {path}.lock for too long; check whether it is stopped or blocked"
                ) from None
        time.sleep(_LOCK_POLL_S)


def listen(path: Path, backlog: int = 64, *, advice: str = _OWN_FOLDER) -> socket.socket:
    """Return a non-blocking socket listening at `path`; replace a stale file, but raise SocketInUse for one in use.

    `close_listener` closes the socket and removes the file. `advice` is the text for a path that cannot be created.
    """
    # not the lock of `path` itself, which a starter may hold until the server listens
    with lock(path.with_name(path.name + ".listen")):
        _remove_stale(path)
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            _bind_private(sock, path, advice)
            sock.listen(backlog)
            sock.setblocking(False)
        except BaseException:
            sock.close()
            raise
    return sock


def _bind_private(sock: socket.socket, path: Path, advice: str) -> None:
    with _umask:
        previous = os.umask(0o077)
        try:
            sock.bind(str(path))
        except OSError as error:
            raise _not_created(path, error, advice) from error
        finally:
            os.umask(previous)


def _remove_stale(path: Path) -> None:
    try:
        status = os.lstat(path)
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(status.st_mode):
        raise ConfigError(f"{path} is not a socket; remove it")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        if _answers(probe, path):
            raise SocketInUse(path, peer_pid(probe))
    path.unlink(missing_ok=True)


def _is_alive(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        return _answers(probe, path)


def _answers(probe: socket.socket, path: Path) -> bool:
    """Whether a process listens at `path`; a full backlog counts as listening."""
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
    """Remove the file of a listening socket, then close the socket; no effect if already closed."""
    if sock.fileno() < 0:
        return
    # While the socket listens, no process treats the file as stale, so that it still belongs to this socket.
    with contextlib.suppress(OSError):
        os.unlink(sock.getsockname())
    sock.close()


def _timeval(seconds: float) -> bytes:
    """Return a time in s as a `struct timeval`, at least 1 us if positive."""
    whole_seconds, microseconds = divmod(math.ceil(seconds * 1_000_000), 1_000_000)
    return struct.pack("@ll", whole_seconds, microseconds)


def connect(path: Path, timeout: float | None = 5.0) -> socket.socket:
    """Connect to `path`; return the socket with its timeout set to `timeout` in s.

    OSErrors are raised as they are: FileNotFoundError and ConnectionRefusedError mean that no process listens,
    BlockingIOError that the server did not accept within the timeout. CanopenError is raised if the server belongs to
    another user.
    """
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        if timeout:
            # With a Python timeout `connect` would not wait while the backlog is full: a STOP was refused at once
            # while other clients connected and disconnected.
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _timeval(timeout))
        sock.connect(str(path))
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _timeval(0.0))
        sock.settimeout(timeout)
        if not same_user(sock):
            raise CanopenError(f"{path} is served by a process of another user; the connection was closed")
    except BaseException:
        sock.close()
        raise
    return sock


_START = "start one: canopen-control run robby"


def find_robots() -> list[str]:
    """Return the names of this user's running robots, sorted."""
    return list_sockets("robot")


def select_robot(name: str | None = None) -> str:
    """Return `name` if that robot is running, or the only running robot if `name` is None; else raise ConfigError."""
    running = find_robots()
    if name is not None:
        if check_name(name) in running:
            return name
        if not running:
            raise ConfigError(f"no robot {name!r} is running; {_START} --as {name}")
        near = nearest(name, running, listed=False) or f"; running: {', '.join(running)}"
        raise ConfigError(f"no robot {name!r} is running{near}")
    if not running:
        raise NoRobotError(f"no robot is running; {_START}")
    if len(running) > 1:
        raise ConfigError(f"several robots are running: {', '.join(running)}; choose one with --name")
    return running[0]
