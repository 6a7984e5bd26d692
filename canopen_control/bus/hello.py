"""How an opener and the hub of a ``local:`` bus greet each other: 64 bytes each way, then only records.

The opener says who it is; the hub answers with its own process, the label it gave, made unique, and what it can do. A
version that differs is refused with a sentence instead of garbage later. The hub's side is `HelloServer`: who connects
and says nothing keeps nobody waiting, and makes way for who comes.
"""

from __future__ import annotations

import contextlib
import functools
import os
import struct
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.host.sockets import close_listener, same_user

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable

    from canopen_control.host.reactor import Reactor
    from canopen_control.host.timer import Timer

__all__ = ["HELLO_SIZE", "LABEL_SIZE", "MAGIC", "VERSION", "Hello", "HelloServer", "pack_hello", "parse_hello"]

MAGIC: Final = b"CANlocal"
VERSION: Final = 1
LABEL_SIZE: Final = 48
_HELLO: Final = struct.Struct("<8sHHI48s")  # magic, version, abilities, pid, label
HELLO_SIZE: Final = _HELLO.size
_GREETING_NS: Final = 5_000_000_000
_RETRY_NS: Final = 50_000_000
_MOST_GREETING: Final = 64


class Hello(NamedTuple):
    """Who is at the other end."""

    version: int
    pid: int
    label: str
    abilities: int = 0  # of a hub: those of `wanted`


def pack_hello(pid: int, label: str, version: int = VERSION, abilities: int = 0) -> bytes:
    """Make a greeting; a label longer than 48 bytes of UTF-8 is cut."""
    return _HELLO.pack(MAGIC, version, abilities, pid, _cut(label))


def _cut(label: str) -> bytes:
    return label.encode()[:LABEL_SIZE].decode(errors="ignore").encode()


def parse_hello(data: bytes) -> Hello | None:
    """Take a greeting of `HELLO_SIZE` bytes apart; None if it is none."""
    if len(data) != HELLO_SIZE:
        return None
    magic, version, abilities, pid, label = _HELLO.unpack(data)
    if magic != MAGIC:
        return None
    return Hello(version, pid, label.rstrip(b"\0").decode(errors="replace"), abilities)


class _Newcomer:
    """A connection that has not greeted yet."""

    __slots__ = ("data", "socket", "timer")

    def __init__(self, sock: socket.socket, timer: Timer) -> None:
        self.socket, self.timer = sock, timer
        self.data = b""


class HelloServer:
    """Accepts who connects to `listener`, and hands those who greet to `admit(socket, hello)`; the rest is dropped."""

    def __init__(
        self, reactor: Reactor, listener: socket.socket, admit: Callable[[socket.socket, Hello], object]
    ) -> None:
        self._reactor, self._listener, self._admit = reactor, listener, admit
        self._newcomers: dict[socket.socket, _Newcomer] = {}  # in the order in which they came
        self._listen()

    @property
    def busy(self) -> bool:
        """Whether somebody has connected and not greeted yet."""
        return bool(self._newcomers)

    def accept(self) -> None:
        """Take the next who has connected, if there is one."""
        try:
            sock, _ = self._listener.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):  # it changed its mind
            return
        except OSError:  # no descriptor is left: looking again at once would be a loop
            self._reactor.remove_reader(self._listener)
            self._reactor.call_later(_RETRY_NS, self._listen)
            return
        if not same_user(sock):
            sock.close()
            return
        sock.setblocking(False)
        while len(self._newcomers) >= _MOST_GREETING:
            self._dismiss(next(iter(self._newcomers)))
        timer = self._reactor.call_later(_GREETING_NS, functools.partial(self._dismiss, sock))
        self._newcomers[sock] = _Newcomer(sock, timer)
        self._reactor.add_reader(sock, functools.partial(self._hear, self._newcomers[sock]))

    def close(self) -> None:
        """Listen no more and drop the newcomers; a second call does nothing."""
        if self._listener.fileno() >= 0:
            self._reactor.remove_reader(self._listener)
        close_listener(self._listener)
        for sock in list(self._newcomers):
            self._dismiss(sock)

    def _listen(self) -> None:
        if self._listener.fileno() >= 0:
            self._reactor.add_reader(self._listener, self.accept)

    def _dismiss(self, sock: socket.socket) -> None:
        self._release(sock)
        sock.close()

    def _release(self, sock: socket.socket) -> None:
        newcomer = self._newcomers.pop(sock, None)
        if newcomer is not None:
            newcomer.timer.cancel()
        self._reactor.remove_reader(sock)

    def _hear(self, newcomer: _Newcomer) -> None:
        try:
            data = newcomer.socket.recv(HELLO_SIZE - len(newcomer.data))
        except BlockingIOError:
            return
        except OSError:
            data = b""
        newcomer.data += data
        if data and len(newcomer.data) < HELLO_SIZE:
            return
        hello = parse_hello(newcomer.data)
        if hello is not None and hello.version == VERSION:
            self._release(newcomer.socket)
            self._admit(newcomer.socket, hello)
            return
        if hello is not None:
            _refuse(newcomer.socket)
        self._dismiss(newcomer.socket)


def _refuse(sock: socket.socket) -> None:
    """Tell the other version ours, as far as the kernel takes it at once."""
    with contextlib.suppress(OSError):
        sock.send(pack_hello(os.getpid(), ""))
