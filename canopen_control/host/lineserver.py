"""Line server on a Unix stream socket in the reactor: connections, a fair order of requests, and send buffers.

The owner interprets the lines; its `error_line` returns the line that a peer receives before it is disconnected.

Requests are small (64 KiB) and share each turn of the loop. For one millisecond the connections take turns with one
request each, the first requests of new connections first; the other requests wait for the next turn. A flooding peer
thus delays every other peer by one request, and the owner's other work by one millisecond and one request.

When the maximum number of connections is reached, an idle client is disconnected with a message: first a client
that never sent a request, then the client that has been silent for longest, last a client with a recent or pending
request. `may_idle(connection)` exempts silent connections that receive data or on which something depends; the owner
accepts at most `MAX_KEPT` of these.

The server never blocks, and its memory is bounded: bytes that the kernel does not accept wait in a buffer of at most 1
MiB per connection, and a peer that reads too slowly is disconnected with `reason` "slow". `on_close` is never called
inside a `send` but from the loop, so that an owner may send while it iterates over its connections.
"""

from __future__ import annotations

import contextlib
import errno
from collections import deque
from typing import TYPE_CHECKING, Final

from canopen_control.host import sockets
from canopen_control.host.lineclient import MAX_REQUEST, LineBuffer

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable
    from pathlib import Path

    from canopen_control.host.reactor import Reactor
    from canopen_control.host.timer import Timer


MAX_KEPT: Final = 64
_MAX_CONNECTIONS: Final = 72
_CHUNK: Final = 1 << 14  # bytes per connection and turn
_SHARE_NS: Final = 1_000_000  # time per turn for the requests of all connections
_LINES_PER_TURN: Final = 64
_ACCEPTS_PER_TURN: Final = 16
_GRACE_NS: Final = 500_000_000  # new connections are not disconnected, those with a recent request last
_LINGER_NS: Final = 1_000_000_000  # maximum time for sending a last answer
_NO_DESCRIPTOR: Final = frozenset((errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM))  # accept(2)
_ACCEPT_PAUSE_NS: Final = 100_000_000  # pause when no descriptors are left, instead of a busy loop
_ANOTHER_USERS: Final = "this program belongs to another user"
_EVICTED: Final = "too many connections are open and this one was idle; connect again for the next request"


class Connection:
    """Connection of one peer of a `LineServer`, with its receive and send buffers.

    The owner may use `name` and `context` freely; `reason` is why the connection has ended, or "".
    """

    def __init__(self, server: LineServer, sock: socket.socket, name: str) -> None:
        self.name = name
        self.pid = sockets.peer_pid(sock)
        self.context: object = None
        self.reason = ""
        self._server = server
        self._socket = sock
        self._input = LineBuffer(MAX_REQUEST)
        self._output = bytearray()
        self._linger: Timer | None = None
        self._next: bytes | None = None  # line that waits for its turn
        self._requests = self._unanswered = 0
        self._connected_at = self._last = server.reactor.now()

    @property
    def closed(self) -> bool:
        """Whether the connection has ended, or will end once the last reply has been sent."""
        return bool(self.reason)

    @property
    def pending(self) -> int:
        return len(self._output)

    def fileno(self) -> int:
        return self._socket.fileno()

    def expect_answer(self) -> None:
        """Count a request as pending until `answer`; a client with a pending request is the last to be disconnected."""
        self._unanswered += 1

    def answer(self, line: bytes) -> None:
        """Send the reply to a request counted by `expect_answer`."""
        self._unanswered -= 1
        self.send(line)

    def send(self, line: bytes) -> None:
        """Send one or more lines, including their newlines; no effect after the end of the connection.

        The method never blocks, and never raises because of the peer.
        """
        if self.reason:
            return
        if not self._output:
            line = line[self._write(line) :]
        if not line or self.reason:
            return
        if len(self._output) + len(line) > self._server.limit:
            self._end("slow")
            return
        if not self._output:
            self._server.reactor.add_writer(self._socket, self._on_writable)
        self._output += line

    def close(self, reason: str = "closed") -> None:
        """Close the connection after everything has been sent, or after one second; no effect if already closed."""
        if self.reason:
            return
        if not self._output:
            self._end(reason)
            return
        self.reason = reason
        self._server.reactor.remove_reader(self._socket)
        self._linger = self._server.reactor.call_later(_LINGER_NS, self._release)

    def refuse(self, kind: str, message: str) -> None:
        self.send(self._server.error_line(kind, message))
        self.close(message)

    def start(self) -> None:
        self._server.reactor.add_reader(self._socket, self._on_readable)

    def abandon(self, reason: str) -> None:
        """Close the connection at once, and discard unsent data; called by the server."""
        self._end(reason)
        self._release()

    def _write(self, data: bytes | bytearray) -> int:
        try:
            return self._socket.send(data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:
            self._end("gone")
            return 0

    def _on_writable(self) -> None:
        del self._output[: self._write(self._output)]
        if self._output or self._socket.fileno() < 0:
            return
        self._server.reactor.remove_writer(self._socket)
        if self.reason:
            self._release()

    def eviction_order(self, now: int) -> tuple[int, int] | None:
        """Return the eviction rank as (class, time), lowest first; None if the connection is new or has ended."""
        if now - self._connected_at < _GRACE_NS or self.reason:
            return None
        if not self._requests:
            return 0, self._connected_at
        return (1 if now - self._last >= _GRACE_NS and self._unanswered <= 0 else 2), self._last

    def _on_readable(self) -> None:
        if self._next is not None:
            return  # first the lines already received
        try:
            data = self._socket.recv(_CHUNK)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data = b""
        if not data:
            self._end("gone")
            return
        self._input.feed(data)
        self._queue_turn()

    def _queue_turn(self) -> None:
        """Queue the connection for its next received line, if any; refuse a line that is too long."""
        self._next = None if self.reason else self._input.next_line()
        if self._next is not None:
            self._server.line_up(self, first=not self._requests)
        elif self._input.overflow and not self.reason:
            self.refuse("RemoteProtocolError", f"a request is longer than {MAX_REQUEST} bytes")

    def serve(self) -> None:
        """Pass the queued line to the owner; called by the server."""
        line, self._next = self._next, None
        if line is None or self.reason:
            return
        self._requests += 1
        self._last = self._server.reactor.now()
        try:
            self._server.on_line(self, line)
        finally:
            # the following lines are served even if the owner raised
            self._queue_turn()

    def _end(self, reason: str) -> None:
        """Stop reading and writing at once; the loop then closes the socket and calls `on_close`."""
        self.reason = self.reason or reason
        self._output.clear()
        self._server.reactor.remove_reader(self._socket)
        self._server.reactor.remove_writer(self._socket)
        self._server.reactor.call_soon(self._release)

    def _release(self) -> None:
        if self._socket.fileno() < 0:
            return
        if self._linger is not None:
            self._linger.cancel()
        self._server.reactor.remove_reader(self._socket)
        self._server.reactor.remove_writer(self._socket)
        self._socket.close()
        self._server.forget(self)


def _ignore(_connection: Connection) -> None:
    pass


def _none(_connection: Connection) -> bool:
    return False


class LineServer:
    """Server on a Unix socket, run by a reactor.

    Each callback receives the `Connection`; `on_line` also receives the line, without its newline. `on_close` is called
    once for each connection passed to `on_connect`, with the cause in `connection.reason`: "gone" (the peer left),
    "slow", "closed", or the sentence sent to the peer, for which `error_line(kind, message)` creates the line.
    SocketInUse is raised if another server listens at the path. `listener` is a socket on which the owner listens
    already. `refused` counts peers of other users.
    """

    def __init__(
        self,
        reactor: Reactor,
        path: Path,
        on_connect: Callable[[Connection], object],
        on_line: Callable[[Connection, bytes], object],
        on_close: Callable[[Connection], object] = _ignore,
        *,
        error_line: Callable[[str, str], bytes],
        limit: int = 1 << 20,
        may_idle: Callable[[Connection], bool] = _none,
        listener: socket.socket | None = None,
    ) -> None:
        self.reactor = reactor
        self.path = path
        self.limit = limit
        self.refused = 0
        self.on_connect, self.on_line, self.on_close, self.may_idle = on_connect, on_line, on_close, may_idle
        self.error_line = error_line
        self._connections: dict[Connection, None] = {}  # in the order of connection
        self._count = 0
        self._newcomers: deque[Connection] = deque()  # new connections whose first line waits
        self._waiting: deque[Connection] = deque()
        self._planned = False
        self._socket = sockets.listen(path) if listener is None else listener
        reactor.add_reader(self._socket, self._on_readable)

    @property
    def connections(self) -> list[Connection]:
        """Open connections, except those that are about to close."""
        return [connection for connection in self._connections if not connection.closed]

    def close(self) -> None:
        """Close all connections at once and remove the socket; `on_close` is called for each connection.

        No effect if the server is closed already.
        """
        if self._socket.fileno() < 0:
            return
        self.reactor.remove_reader(self._socket)
        sockets.close_listener(self._socket)
        for connection in list(self._connections):
            connection.abandon("closed")

    def forget(self, connection: Connection) -> None:
        """Remove a connection that has ended; called by the connection."""
        if connection in self._connections:
            del self._connections[connection]
            self.on_close(connection)

    def line_up(self, connection: Connection, *, first: bool) -> None:
        """Queue a connection whose next line is to be processed; called by the connection."""
        (self._newcomers if first else self._waiting).append(connection)
        if not self._planned:
            self._planned = True
            self.reactor.call_soon(self._serve_turn)

    def _serve_turn(self) -> None:
        """Process queued connections, one line each, up to the limits of this turn in time and lines."""
        until = self.reactor.now() + _SHARE_NS
        try:
            for _ in range(_LINES_PER_TURN):
                queue = self._newcomers or self._waiting
                if not queue:
                    break
                queue.popleft().serve()
                if self.reactor.now() >= until:
                    break
        finally:
            self._planned = bool(self._newcomers or self._waiting)
            if self._planned:
                self.reactor.call_soon(self._serve_turn)

    def _on_readable(self) -> None:
        for _ in range(_ACCEPTS_PER_TURN):
            full = len(self._connections) >= _MAX_CONNECTIONS
            if full and not self._make_room():
                self._pause()  # the peer waits in the kernel
                return
            try:
                sock, _ = self._socket.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                if error.errno in _NO_DESCRIPTOR and self._make_room():
                    self._make_room()  # closes one more, for a file that the new connection's request may need
                    continue
                self._pause()
                return
            self._admit(sock)
            if full:
                return  # the next turn shows whether another connection must be closed

    def _pause(self) -> None:
        self.reactor.remove_reader(self._socket)
        self.reactor.call_later(_ACCEPT_PAUSE_NS, self._resume)

    def _resume(self) -> None:
        if self._socket.fileno() >= 0:
            self.reactor.add_reader(self._socket, self._on_readable)

    def _make_room(self) -> bool:
        """Disconnect a client with a message, so that another can connect; return False if all are new or exempt."""
        now = self.reactor.now()
        candidates = [
            connection
            for connection in self._connections
            if connection.eviction_order(now) is not None and not self.may_idle(connection)
        ]
        if not candidates:
            return False
        evicted = min(candidates, key=lambda connection: connection.eviction_order(now) or (0, 0))
        evicted.send(self.error_line("BusError", _EVICTED))
        evicted.abandon(_EVICTED)
        return True

    def _turn_away(self, sock: socket.socket) -> None:
        self.refused += 1
        with sock, contextlib.suppress(OSError):
            sock.send(self.error_line("BusError", _ANOTHER_USERS))

    def _admit(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        if not sockets.same_user(sock):
            self._turn_away(sock)
            return
        self._count += 1
        connection = Connection(self, sock, f"#{self._count}")
        self._connections[connection] = None
        connection.start()
        self.on_connect(connection)
