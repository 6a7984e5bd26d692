"""Handshake and control records of a ``local:`` bus: subscriptions, time stamps and echo.

A port can request identifiers, time stamps, or its own frames. A hub that supports this announces it in its greeting.
The records are sent in the stream of frames, so that frames sent after a request follow it. The hub puts a stamp before
each chunk of frames received at once. A request record contains up to two identifiers, with the flags of linux/can.h;
the identifier of the record itself, all ones, is invalid for frames. A port without requests receives all frames but
its own, without stamps.
"""

from __future__ import annotations

import contextlib
import functools
import os
import struct
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.frame import RECORD_SIZE
from canopen_control.host.sockets import close_listener, same_user

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Iterable, Iterator

    from canopen_control.host.reactor import Reactor
    from canopen_control.host.timer import Timer


# Greeting of a port and the hub: 64 bytes in each direction, then only records. The port sends its process id and
# label; the hub answers with its own process id, the label it assigned and its abilities. Another version is refused
# with a message.


MAGIC: Final = b"CANlocal"
VERSION: Final = 1
LABEL_SIZE: Final = 48
_HELLO: Final = struct.Struct("<8sHHI48s")  # magic, version, abilities, pid, label
HELLO_SIZE: Final = _HELLO.size
_GREETING_NS: Final = 5_000_000_000
_RETRY_NS: Final = 50_000_000
_MAX_GREETING: Final = 64


class Hello(NamedTuple):
    """Greeting received from the peer, which is a port or the hub."""

    version: int
    pid: int
    label: str
    abilities: int = 0  # abilities of a hub: TAKES_SUBSCRIPTION, GIVES_STAMPS


def pack_hello(pid: int, label: str, version: int = VERSION, abilities: int = 0) -> bytes:
    """Return a greeting; a label longer than 48 bytes of UTF-8 is truncated."""
    return _HELLO.pack(MAGIC, version, abilities, pid, _cut(label))


def _cut(label: str) -> bytes:
    return label.encode()[:LABEL_SIZE].decode(errors="ignore").encode()


def parse_hello(data: bytes) -> Hello | None:
    """Return the content of a greeting of `HELLO_SIZE` bytes, or None if it is invalid."""
    if len(data) != HELLO_SIZE:
        return None
    magic, version, abilities, pid, label = _HELLO.unpack(data)
    if magic != MAGIC:
        return None
    return Hello(version, pid, label.rstrip(b"\0").decode(errors="replace"), abilities)


class _Newcomer:
    __slots__ = ("data", "socket", "timer")

    def __init__(self, sock: socket.socket, timer: Timer) -> None:
        self.socket, self.timer = sock, timer
        self.data = b""


class HelloServer:
    """Acceptor of connections on `listener` that calls `admit(socket, hello)` after a valid greeting.

    A connection without a valid greeting is dropped. A connection without any greeting does not delay others; it
    is dropped after five seconds, or earlier if too many wait.
    """

    def __init__(
        self, reactor: Reactor, listener: socket.socket, admit: Callable[[socket.socket, Hello], object]
    ) -> None:
        self._reactor, self._listener, self._admit = reactor, listener, admit
        self._newcomers: dict[socket.socket, _Newcomer] = {}  # in the order of connection
        self._listen()

    @property
    def busy(self) -> bool:
        """Whether a connection is open whose greeting is not complete."""
        return bool(self._newcomers)

    def accept(self) -> None:
        """Accept the next connection, if any."""
        try:
            sock, _ = self._listener.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):  # the peer closed it
            return
        except OSError:  # no descriptor is left: trying again at once would be a busy loop
            self._reactor.remove_reader(self._listener)
            self._reactor.call_later(_RETRY_NS, self._listen)
            return
        if not same_user(sock):
            sock.close()
            return
        sock.setblocking(False)
        while len(self._newcomers) >= _MAX_GREETING:
            self._dismiss(next(iter(self._newcomers)))
        timer = self._reactor.call_later(_GREETING_NS, functools.partial(self._dismiss, sock))
        self._newcomers[sock] = _Newcomer(sock, timer)
        self._reactor.add_reader(sock, functools.partial(self._receive, self._newcomers[sock]))

    def close(self) -> None:
        """Stop listening and drop connections without a complete greeting; a second call does nothing."""
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

    def _receive(self, newcomer: _Newcomer) -> None:
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
    """Send our protocol version to a peer with another version, as far as the socket accepts it at once."""
    with contextlib.suppress(OSError):
        sock.send(pack_hello(os.getpid(), ""))


TAKES_SUBSCRIPTION: Final = 1
GIVES_STAMPS: Final = 2
"""Abilities of a hub in its greeting: it supports subscriptions; it supports stamps and echo."""
STAMP_STEP_NS: Final = 1000
"""Interval between the stamps of one chunk, whose frames arrived together: the resolution of recordings in us."""
_RECORD: Final = struct.Struct("=5sBxxII")  # mark, kind, identifiers
_STAMP: Final = struct.Struct("=5sBxxq")  # mark, _OWN or 0, monotonic ns of the first frame
MARK: Final = b"\xff" * 5
"""Beginning of a control record."""
_COUNT: Final = 0x03
_STAMPS: Final = 0x10
_ECHO: Final = 0x20
_OWN: Final = 0x01
_LAST: Final = 0x80
_MAX: Final = 4096  # maximum number of identifiers; beyond it a port receives all frames


def pack_subscription(can_ids: Iterable[int]) -> bytes:
    """Return the records with which a port requests only these identifiers."""
    identifiers = sorted(set(can_ids))
    pairs = [identifiers[at : at + 2] for at in range(0, len(identifiers), 2)] or [[]]
    last = len(pairs) - 1
    return b"".join(
        _RECORD.pack(MARK, len(pair) | (_LAST if number == last else 0), *pair, *[0] * (2 - len(pair)))
        for number, pair in enumerate(pairs)
    )


def pack_stamp_request(*, echo: bool = False) -> bytes:
    """Return the record that requests time stamps, and with `echo` also the port's own frames."""
    return _RECORD.pack(MARK, _STAMPS | (_ECHO if echo else 0), 0, 0)


def pack_stamp(at_ns: int) -> bytes:
    """Return the record that precedes a chunk received at `at_ns`, in monotonic ns."""
    return _STAMP.pack(MARK, 0, at_ns)


def own_stamp(stamp: bytes) -> bytes:
    """Return `stamp` in the form for the port that sent the chunk."""
    return MARK + bytes((_OWN,)) + stamp[len(MARK) + 1 :]


class Chunk(NamedTuple):
    """Records received at once; the first has the time `at_ns` (0: unknown), the others follow at `STAMP_STEP_NS`."""

    at_ns: int
    own: bool
    records: bytes

    @property
    def stamps(self) -> list[int]:
        """Time of each record in monotonic ns (0: unknown)."""
        count = len(self.records) // RECORD_SIZE
        return [*range(self.at_ns, self.next_ns, STAMP_STEP_NS)] if self.at_ns else [0] * count

    @property
    def next_ns(self) -> int:
        """Time in ns of a record that follows the chunk without its own stamp (0: unknown)."""
        return self.at_ns and self.at_ns + len(self.records) // RECORD_SIZE * STAMP_STEP_NS


def chunks_of(data: bytes, before: Chunk) -> Iterator[Chunk]:
    """Yield the chunks of records, split at the stamps; records before the first stamp continue `before`."""
    at_ns, own, begin, mark = before.next_ns, before.own, 0, -1
    if data.startswith(MARK):  # the usual case
        _, kind, at_ns = _STAMP.unpack_from(data)
        own, begin, mark = bool(kind & _OWN), RECORD_SIZE, RECORD_SIZE - 1
    while True:
        mark = data.find(MARK, mark + 1)
        while mark % RECORD_SIZE and mark > 0:  # data of a frame that contain the mark
            mark = data.find(MARK, mark + 1)
        end = len(data) if mark < 0 else mark
        yield Chunk(at_ns, own, data[begin:end])
        if mark < 0:
            return
        _, kind, at_ns = _STAMP.unpack_from(data, mark)
        own, begin = bool(kind & _OWN), mark + RECORD_SIZE


class Subscription:
    """Requests of one port: `ids` is None for all identifiers, `echoes` adds the port's own frames."""

    __slots__ = ("_pending_ids", "echoes", "ids", "stamps")

    def __init__(self) -> None:
        self.ids: frozenset[int] | None = None
        self.stamps = self.echoes = False
        self._pending_ids: set[int] = set()

    def take(self, records: bytes) -> bytes:
        """Apply and remove the request records; return the remaining records, which are frames."""
        frames = []
        for at in range(0, len(records), RECORD_SIZE):
            if records.startswith(MARK, at):
                self._receive(*_RECORD.unpack_from(records, at)[1:])
            else:
                frames.append(records[at : at + RECORD_SIZE])
        return b"".join(frames)

    def _receive(self, kind: int, *can_ids: int) -> None:
        if kind & _STAMPS:
            self.stamps, self.echoes = True, bool(kind & _ECHO)
            return
        self._pending_ids.update(can_ids[: kind & _COUNT])
        if kind & _LAST:
            self.ids = frozenset(self._pending_ids) if len(self._pending_ids) <= _MAX else None
            self._pending_ids = set()
