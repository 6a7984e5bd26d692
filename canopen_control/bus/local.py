"""Port of a ``local:`` bus: a Unix stream to the hub, one system call per direction for all frames of a cycle.

The first opener starts the hub, decided under a lock; the hub is not its child process. After the hub has ended,
`receive` and `send` raise `BusClosed`, and the next opening starts a new hub. `ask_hub` sends control requests, for the
members and faults of a bus.
"""

from __future__ import annotations

import contextlib
import os
import socket
from typing import TYPE_CHECKING, Final, NoReturn, TypeVar

from canopen_control.bus.error_events import note_errors
from canopen_control.bus.error_frames import has_error_frames
from canopen_control.bus.port import BusEventKind, BusEventLog, PortStats, Records, SendQueue, whole_records
from canopen_control.bus.subscription import (
    GIVES_STAMPS,
    HELLO_SIZE,
    TAKES_SUBSCRIPTION,
    VERSION,
    Chunk,
    Hello,
    chunks_of,
    pack_hello,
    pack_stamp_request,
    pack_subscription,
    parse_hello,
)
from canopen_control.errors import BusClosed, BusError, BusNotOpen, CanopenError, ConfigError, RemoteError
from canopen_control.frame import RECORD_SIZE
from canopen_control.host.sockets import connect, list_sockets, lock, peer_pid, socket_path

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from canopen_control.rpc.messages.declare import Request


A = TypeVar("A")
_RECEIVE_SIZE: Final = 65536
_BUFFER_SIZE: Final = 1 << 20
_GREETING_TIMEOUT_S: Final = 5.0
_STARTING_S: Final = 15.0  # a loaded machine needs seconds to start a hub
_ANSWER_S: Final = 5.0
_UNANSWERED: Final = ("BusClosed", "Timeout", "RemoteProtocolError")
_HUB: Final = "canopen_control.bus.hub"
_CLOSED_HERE: Final = "closed on this side"
_NOTHING: Final = Chunk(0, own=False, records=b"")
_HUB_GONE: Final = "the hub process has ended; start this program again, which starts a new hub"


class LocalPort:
    """Port of a ``local:`` bus; see `canopen_control.bus.port.Port`.

    `label` was assigned by the hub, `abilities` are those of the hub.
    """

    def __init__(self, name: str, sock: socket.socket, label: str, abilities: int = 0) -> None:
        self.channel = f"local:{name}"
        self.label = label
        self.stats = PortStats()
        self._socket = sock
        self._abilities = abilities
        self._partial = b""
        self._chunks: list[Chunk] | None = None  # chunks of the last read, if stamps were requested
        self._queue = SendQueue()
        self._events = BusEventLog()
        self.events = self._events.drain
        """Return the bus events since the last call."""
        self._dropping = False
        self._closed_reason = ""
        sock.setblocking(False)
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            sock.setsockopt(socket.SOL_SOCKET, option, _BUFFER_SIZE)  # the kernel limits the size

    @property
    def wants_write(self) -> bool:
        return bool(self._queue.data)

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> bytes:
        try:
            data = self._socket.recv(_RECEIVE_SIZE)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._lose()
        if self._partial or len(data) % RECORD_SIZE:
            data = self._reassemble(data)
        if self._chunks is not None:
            self._chunks = [*chunks_of(data, self._chunks[-1])]
            data = (
                self._chunks[0].records
                if len(self._chunks) == 1
                else b"".join([chunk.records for chunk in self._chunks])
            )
        self.stats.rx += len(data) // RECORD_SIZE
        if has_error_frames(data):
            self._events.extend(note_errors(data, self.stats))
        return data

    def _reassemble(self, data: bytes) -> bytes:
        data = self._partial + data
        complete = len(data) - len(data) % RECORD_SIZE
        self._partial = data[complete:]
        return data[:complete]

    def ask_stamps(self, *, echo: bool = False) -> None:
        """Request time stamps from now on; with `echo`, also this port's own frames, in the order of the bus.

        A second call does nothing. Hubs of earlier versions do not support it; see `gives_stamps`.
        """
        if self.gives_stamps and self._chunks is None:
            self._chunks = [_NOTHING]
            self._report(pack_stamp_request(echo=echo))

    @property
    def gives_stamps(self) -> bool:
        """Whether the hub supports time stamps."""
        return bool(self._abilities & GIVES_STAMPS)

    def receive_stamped(self) -> tuple[bytes, list[int]]:
        """Return received records, and the hub's time stamp of each in monotonic ns (0: unknown)."""
        records = self.receive()
        if self._chunks is None:
            return records, [0] * (len(records) // RECORD_SIZE)
        if len(self._chunks) == 1:
            return records, self._chunks[0].stamps if records else []
        return records, [stamp for chunk in self._chunks for stamp in chunk.stamps] if records else []

    def receive_chunks(self) -> list[Chunk]:
        """Return received records as chunks with time stamps; without stamps, as one chunk."""
        records = self.receive()
        if not records:
            return []
        return [Chunk(0, own=False, records=records)] if self._chunks is None else self._chunks

    def send(self, records: Records) -> None:
        count = whole_records(records)
        if self._queue.data:
            self._enqueue(records)
            self.flush()
        elif (sent := self._write(records)) != len(records):
            self._enqueue(memoryview(records)[sent:])
        self.stats.tx += count

    def _write(self, data: Records) -> int:
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._lose()

    def _enqueue(self, records: Records) -> None:
        dropped = self._queue.put(records)
        self.stats.queued = len(self._queue)
        self.stats.lost += dropped
        if dropped and not self._dropping:
            self._events.add(BusEventKind.OVERRUN, f"bus {self.channel}: the hub does not keep up, frames are dropped")
        self._dropping = dropped > 0

    def set_filter(self, can_ids: Iterable[int]) -> None:
        """Subscribe to identifiers; the hub omits chunks without these identifiers, other frames may still arrive."""
        if self._abilities & TAKES_SUBSCRIPTION:
            self._report(pack_subscription(can_ids))

    def _report(self, records: bytes) -> None:
        """Send control records, which are not counted as frames."""
        with contextlib.suppress(BusClosed):  # the next receive or send reports it
            self.send(records)
            self.stats.tx -= len(records) // RECORD_SIZE

    def flush(self) -> None:
        if self._queue.data:
            self._queue.taken(self._write(self._queue.data))
            self.stats.queued = len(self._queue)

    def _lose(self) -> NoReturn:
        if not self._closed_reason:
            self._closed_reason = _HUB_GONE
            self.stats.lost += self._queue.clear()
            self.stats.queued = 0
            self._events.add(BusEventKind.CLOSED, f"bus {self.channel}: {_HUB_GONE}")
        raise BusClosed(self.channel, self._closed_reason)

    def close(self) -> None:
        """Close the port; a second call does nothing. Queued records are sent as far as the socket accepts them."""
        if self._closed_reason == _CLOSED_HERE:
            return
        if not self._closed_reason:
            with contextlib.suppress(BusClosed):
                self.flush()
        self._closed_reason = _CLOSED_HERE
        self._socket.close()


def greet(sock: socket.socket, name: str, label: str) -> LocalPort | None:
    """Exchange greetings with the hub on a new connection; return None if the hub has closed it.

    Raise BusError if the hub has another version or does not answer. The socket is closed unless a port is returned.
    """
    try:
        sock.settimeout(_GREETING_TIMEOUT_S)
        sock.sendall(pack_hello(os.getpid(), label))
        answer = _read_hello(sock)
    except TimeoutError:
        pid = peer_pid(sock)
        sock.close()
        raise BusError(f"bus local:{name}: its hub does not answer; end it with: kill {pid}") from None
    except OSError:
        answer = None
    if answer is not None and answer.version == VERSION:
        return LocalPort(name, sock, answer.label, answer.abilities)
    sock.close()
    if answer is None:
        return None
    raise BusError(
        f"bus local:{name}: its hub (process {answer.pid}) uses protocol version {answer.version}, "
        f"this program {VERSION}; close all programs that use the bus, then open the bus again"
    )


def _read_hello(sock: socket.socket) -> Hello | None:
    data = b""
    while len(data) < HELLO_SIZE:
        chunk = sock.recv(HELLO_SIZE - len(data))
        if not chunk:
            return None
        data += chunk
    return parse_hello(data)


def open_local(name: str, label: str = "") -> LocalPort:
    """Open a port on a ``local:`` bus, starting its hub if necessary; raise BusError if that fails."""
    path = socket_path("bus", name)
    port = _join(path, name, label)
    if port is not None:
        return port
    with lock(path, 2 * _STARTING_S):  # held by one opener at a time, and by a hub that is about to end
        port = _join(path, name, label)
        if port is None:
            _start_hub(name)
            port = _join(path, name, label)
    if port is None:
        raise BusError(f"bus local:{name}: its hub ended right after the start; check the free memory of the computer")
    return port


def join_local(name: str, label: str = "") -> LocalPort:
    """Open a port on a ``local:`` bus whose hub runs; raise BusNotOpen if none runs, BusError as in `open_local`."""
    port = _join(socket_path("bus", name), name, label)
    if port is None:
        raise _not_open(name)
    return port


def _not_open(name: str) -> BusNotOpen:
    """Return the error for a ``local:`` bus that is not open, with a list of the open buses."""
    return BusNotOpen(f"local:{name}", [f"local:{socket_name}" for socket_name in list_sockets("bus")])


def _start_hub(name: str) -> None:
    """Start the hub as a detached process and wait until it listens."""
    from canopen_control.host.environment import lean_python
    from canopen_control.host.spawn import spawn_detached

    try:
        argv = [*lean_python(_HUB), name]
        spawn_detached(argv, _STARTING_S, name=f"hub-{name}", main=(_HUB, [name]))
    except ConfigError:
        raise
    except CanopenError as error:
        raise BusError(f"bus local:{name}: {error}") from error


def _join(path: Path, name: str, label: str) -> LocalPort | None:
    try:
        sock = connect(path, _GREETING_TIMEOUT_S)
    except (FileNotFoundError, ConnectionRefusedError, ConnectionResetError):
        return None
    except OSError as error:
        raise BusError(f"bus local:{name}: {path} cannot be opened: {error.strerror or error}") from error
    return greet(sock, name, label)


def ask_hub(name: str, request: Request[A]) -> A:
    """Send a control request of `rpc.messages.hub` to the hub of a ``local:`` bus; return the reply.

    Raise BusNotOpen if the bus is not open, BusError if its hub does not answer, ConfigError if the hub refuses.
    """
    from canopen_control.host.lineclient import LineClient
    from canopen_control.rpc.client import Client
    from canopen_control.rpc.messages.hub import HUB

    try:
        stream = LineClient(socket_path("busctl", name), _ANSWER_S, label=f"the hub of bus local:{name}")
    except RemoteError:
        raise _not_open(name) from None
    try:
        return Client(HUB, stream, _ANSWER_S).ask(request)
    except RemoteError as error:
        raise (BusError if error.kind in _UNANSWERED else ConfigError)(str(error)) from error
    finally:
        stream.close()
