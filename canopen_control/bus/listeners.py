"""Who has CAN sockets open on an interface: which processes, what they hear, what the kernel sends for them.

The kernel has no table of raw CAN sockets with their owners; it is put together of what it does tell. A socket says its
protocol (``system.sockprotoname`` of its descriptor in /proc) and, borrowed with pidfd_getfd, its interface and its
filters; tasks of the broadcast manager are in /proc/net/can-bcm by the socket's inode; the receive lists in
/proc/net/can say how many sockets there are that hear something, and so how many nobody but root could name.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import os
import re
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.bus.rawsocket import CAN_RAW_FILTER, EVERYTHING, FILTER_SIZE, SOL_CAN_RAW

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["Listener", "count_hearing", "find_listeners"]

PROC = Path("/proc")
_PIDFD_GETFD = 438  # on every architecture
_INODE = re.compile(r"socket:\[(\d+)\]")
_BOUND = re.compile(r"bound (\S+)")
_TASK = re.compile(r"^tx_op: ([0-9A-Fa-f]+)\S* .*\bt2=(\d+)", re.MULTILINE)
_MOST_SHOWN = 128  # filters; Python fetches options of 1 KiB at most
_VERB = ("-m", "canopen_control")  # options of the interpreter may come before it
_RAW, _BCM = "CAN_RAW", "CAN_BCM"
_RECEIVE_LISTS = ("all", "fil", "inv", "sff", "eff")  # that of error frames names sockets that may hear nothing else


@dataclass(frozen=True, slots=True)
class Listener:
    """One socket. `protocol` is the kernel's name, such as ``CAN_RAW``; `interface` is empty for all of them.

    Of a socket that cannot be borrowed `interface` is None, and of one with too many or unknown filters `identifiers`.
    Otherwise these are how many it hears, -1 for all, 0 for one that only sends. `tasks` are (identifier, period in us)
    of what the kernel sends for it.
    """

    pid: int
    command: str
    protocol: str
    interface: str | None
    identifiers: int | None = None
    tasks: tuple[tuple[int, int], ...] = ()


def find_listeners(interface: str, proc: Path = PROC) -> list[Listener]:
    """Return the CAN sockets of an interface, and those of which this user may not know the interface, by process."""
    found = (each for pid in _processes(proc) for each in _sockets_of(pid, proc))
    return [each for each in found if each.interface in (interface, "", None)]


def count_hearing(interface: str, proc: Path = PROC) -> int:
    """Return how many sockets there are that hear something of an interface."""
    hearing = set()
    for path in (proc / "net" / "can" / f"rcvlist_{name}" for name in _RECEIVE_LISTS):
        with contextlib.suppress(OSError):
            for line in path.read_text().splitlines():
                words = line.split()
                if len(words) == 7 and words[0] in (interface, "any"):
                    hearing.add((words[4], words[6]))  # userdata, which is the socket or the task; ident
    return len(hearing)


def _processes(proc: Path) -> list[int]:
    return sorted(int(entry.name) for entry in proc.iterdir() if entry.name.isdecimal())


def _sockets_of(pid: int, proc: Path) -> Iterator[Listener]:
    folder = proc / str(pid) / "fd"
    seen = set()
    try:
        descriptors = sorted(folder.iterdir(), key=lambda entry: int(entry.name))
    except OSError:
        return  # ended, or another user's
    for entry in descriptors:
        with contextlib.suppress(OSError):
            match = _INODE.fullmatch(os.readlink(entry))
            if match is None or match[1] in seen:
                continue
            seen.add(match[1])
            protocol = os.getxattr(entry, "system.sockprotoname").rstrip(b"\0").decode()
            if protocol.startswith("CAN"):
                yield _listener(pid, int(entry.name), match[1], protocol, proc)


def _listener(pid: int, descriptor: int, inode: str, protocol: str, proc: Path) -> Listener:
    command = _command(pid, proc)
    if protocol == _BCM:
        interface, tasks = _bcm(inode, proc)
        return Listener(pid, command, protocol, interface, 0 if tasks else None, tasks)
    try:
        interface, identifiers = _borrowed(pid, descriptor, protocol)
    except OSError:
        interface, identifiers = None, None
    return Listener(pid, command, protocol, interface, identifiers)


def _command(pid: int, proc: Path) -> str:
    """Return what a process was started as, without the interpreter of our own verbs."""
    words = (proc / str(pid) / "cmdline").read_bytes().decode(errors="replace").split("\0")
    words = [word for word in words if word]
    if _VERB in itertools.pairwise(words[1:4]):
        return " ".join(["canopen-control", *words[words.index("canopen_control") + 1 :]])
    if len(words) > 1 and Path(words[0]).name.startswith("python") and not words[1].startswith("-"):
        words = words[1:]
    return " ".join([Path(words[0]).name, *words[1:]]) if words else f"process {pid}"


def _bcm(inode: str, proc: Path) -> tuple[str | None, tuple[tuple[int, int], ...]]:
    try:
        text = (proc / "net" / "can-bcm" / inode).read_text()
    except OSError:
        return None, ()
    bound = _BOUND.search(text)
    tasks = tuple((int(identifier, 16), int(period)) for identifier, period in _TASK.findall(text))
    return (None if bound is None else bound[1].replace("any", "")), tasks


def _borrowed(pid: int, descriptor: int, protocol: str) -> tuple[str, int | None]:
    """Return interface and number of identifiers of a socket of another process; raise OSError where it may not be."""
    process = os.pidfd_open(pid)
    try:
        number = _pidfd_getfd(process, descriptor)
    finally:
        os.close(process)
    with socket.socket(fileno=number) as sock:
        interface = str(sock.getsockname()[0])
        return interface, _identifiers(sock) if protocol == _RAW else None


def _pidfd_getfd(process: int, descriptor: int) -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    number = int(libc.syscall(_PIDFD_GETFD, process, descriptor, 0))
    if number < 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))
    return number


def _identifiers(sock: socket.socket) -> int | None:
    try:
        filters = sock.getsockopt(SOL_CAN_RAW, CAN_RAW_FILTER, _MOST_SHOWN * FILTER_SIZE)
    except OSError:  # there are more
        return None
    return -1 if filters == EVERYTHING else len(filters) // FILTER_SIZE
