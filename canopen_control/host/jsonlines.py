"""A server of JSON lines on a Unix stream socket, in the reactor.

What is no JSON object on a line is answered with {"error": {"kind", "message"}}, and the connection is closed.

It never blocks, and its memory is bounded: what the kernel does not take waits in a buffer of at most 1 MiB for each
connection, and a peer that reads too slowly for that is dropped, `reason` "slow". `on_close` never happens inside a
`send`: the end of a connection is told from the loop, so that whoever walks through his connections may send to them.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Final

from canopen_control.host import sockets
from canopen_control.host.lines import MAX_LINE, LineBuffer, Message, decode, encode

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from canopen_control.host.reactor import Reactor, Timer

__all__ = ["Connection", "LineServer", "Message", "decode", "encode"]

_CHUNK: Final = 1 << 16
_LINES_PER_TURN: Final = 64  # a peer that floods shares the loop with everybody else
_ACCEPTS_PER_TURN: Final = 16
_MAX_CONNECTIONS: Final = 64
_LINGER_NS: Final = 1_000_000_000  # how long a last answer may take to leave
_ACCEPT_PAUSE_NS: Final = 100_000_000  # out of descriptors: look again later instead of spinning
_TURNED_AWAY: Final = encode({"error": {"kind": "BusError", "message": "too many connections, or another user's"}})


class Connection:
    """One peer of a `LineServer`; `name` and `context` are free for the owner, `reason` says why it ended."""

    def __init__(self, server: LineServer, sock: socket.socket, name: str) -> None:
        self.name = name
        self.pid = sockets.peer_pid(sock)
        self.context: object = None
        self.reason = ""
        self._server = server
        self._socket = sock
        self._input = LineBuffer()
        self._output = bytearray()
        self._linger: Timer | None = None
        self._more = False  # lines wait in the buffer, and a call to serve them is on its way

    @property
    def closed(self) -> bool:
        """Whether it has ended, or ends as soon as the last answer has left."""
        return bool(self.reason)

    @property
    def pending(self) -> int:
        """The number of bytes that wait for the peer to read."""
        return len(self._output)

    def fileno(self) -> int:
        """Return the descriptor; -1 once it is closed."""
        return self._socket.fileno()

    def send(self, message: Message) -> None:
        """Send a message; on a connection that has ended a no-op. Never blocks, never raises for the peer's sake."""
        if not self.reason:
            self.send_encoded(encode(message))

    def send_encoded(self, line: bytes) -> None:
        """Send one or more lines as `encode` makes them; for what goes to many peers."""
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
        """End the connection once what was sent has left, a second later at most; a second close is a no-op."""
        if self.reason:
            return
        if not self._output:
            self._end(reason)
            return
        self.reason = reason
        self._server.reactor.remove_reader(self._socket)
        self._linger = self._server.reactor.call_later(_LINGER_NS, self._release)

    def refuse(self, kind: str, message: str) -> None:
        """Tell the peer what was wrong and close."""
        self.send({"error": {"kind": kind, "message": message}})
        self.close(message)

    def start(self) -> None:
        """Begin to read; for the server."""
        self._server.reactor.add_reader(self._socket, self._on_readable)

    def abandon(self, reason: str) -> None:
        """End now, whatever has not left; for the server."""
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

    def _on_readable(self) -> None:
        if self._more:
            return  # first what is here already
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
        self._serve_lines()

    def _serve_lines(self) -> None:
        self._more = True
        try:
            for _ in range(_LINES_PER_TURN):
                line = None if self.reason else self._input.next_line()
                if line is None:
                    self._more = False
                    break
                self._serve(line)
        finally:
            # also when the owner raised: the lines behind the one that made him raise are innocent
            if self._more:
                self._server.reactor.call_soon(self._serve_lines)
        if self._input.overflow:
            self.refuse("RemoteProtocolError", f"a line is longer than {MAX_LINE} bytes")

    def _serve(self, line: bytes) -> None:
        try:
            message = decode(line)
        except ValueError as error:
            self.refuse("RemoteProtocolError", f"not a JSON object on a line: {error}")
        else:
            self._server.on_message(self, message)

    def _end(self, reason: str) -> None:
        """Stop at once; the socket goes, and the owner hears of it, from the loop."""
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


class LineServer:
    """Serves a Unix socket from a reactor.

    Each callback gets the `Connection`; `on_message` also the message. `on_close` is called once for each connection
    that `on_connect` saw, and finds why in `connection.reason`: "gone" (the peer left), "slow", "closed", or the
    sentence the peer was told. SocketInUse when somebody serves the path already. `refused` counts peers of other
    users, and those beyond the sixty-fourth.
    """

    def __init__(
        self,
        reactor: Reactor,
        path: Path,
        on_connect: Callable[[Connection], object],
        on_message: Callable[[Connection, Message], object],
        on_close: Callable[[Connection], object] = _ignore,
        *,
        limit: int = 1 << 20,
    ) -> None:
        self.reactor = reactor
        self.path = path
        self.limit = limit
        self.refused = 0
        self.on_connect, self.on_message, self.on_close = on_connect, on_message, on_close
        self._connections: dict[Connection, None] = {}  # in the order in which they came
        self._count = 0
        self._socket = sockets.listen(path)
        reactor.add_reader(self._socket, self._on_readable)

    @property
    def connections(self) -> list[Connection]:
        """Those who are here and not about to go."""
        return [connection for connection in self._connections if not connection.closed]

    def broadcast(self, message: Message, to: Iterable[Connection] | None = None) -> None:
        """Send a message to all, or to some; it is encoded once."""
        line = encode(message)
        for connection in self.connections if to is None else to:
            connection.send_encoded(line)

    def close(self) -> None:
        """End all connections now and remove the socket; `on_close` is called for each. A second close is a no-op."""
        if self._socket.fileno() < 0:
            return
        self.reactor.remove_reader(self._socket)
        sockets.close_listener(self._socket)
        for connection in list(self._connections):
            connection.abandon("closed")

    def forget(self, connection: Connection) -> None:
        """Strike a connection that has ended off the list; for the connection."""
        if connection in self._connections:
            del self._connections[connection]
            self.on_close(connection)

    def _on_readable(self) -> None:
        for _ in range(_ACCEPTS_PER_TURN):
            try:
                sock, _ = self._socket.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError:
                self._pause()
                return
            self._admit(sock)

    def _pause(self) -> None:
        self.reactor.remove_reader(self._socket)
        self.reactor.call_later(_ACCEPT_PAUSE_NS, self._resume)

    def _resume(self) -> None:
        if self._socket.fileno() >= 0:
            self.reactor.add_reader(self._socket, self._on_readable)

    def _turn_away(self, sock: socket.socket) -> None:
        self.refused += 1
        with sock, contextlib.suppress(OSError):
            sock.send(_TURNED_AWAY)

    def _admit(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        if len(self._connections) >= _MAX_CONNECTIONS or not sockets.same_user(sock):
            self._turn_away(sock)
            return
        self._count += 1
        connection = Connection(self, sock, f"#{self._count}")
        self._connections[connection] = None
        connection.start()
        self.on_connect(connection)
