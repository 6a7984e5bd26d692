"""A server of lines on a Unix stream socket, in the reactor: who is connected, whose turn it is, what waits to leave.

What a line means is the owner's; `complaint` makes the line that tells a peer why it is sent away.

Requests are small (64 KiB) and share each turn of the loop: they are served one of each connection in turn, a
newcomer's first one before the others', for a millisecond; the rest waits for the next turn. So whoever floods delays
others by the time of one request for each who floods, and the owner's own work by a millisecond and a request.

Nobody is locked out: where all places are taken, whoever is idle has to leave, and is told so; first those who never
asked anything, then who has been silent longest. `keeps(connection)` names those who may stay although they are
silent, because something is sent to them or depends on them; the owner takes at most `MAX_KEPT`.

It never blocks, and its memory is bounded: what the kernel does not take waits in a buffer of at most 1 MiB for each
connection, and a peer that reads too slowly for that is dropped, `reason` "slow". `on_close` never happens inside a
`send`: the end of a connection is told from the loop, so that whoever walks through his connections may send to them.
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
_CHUNK: Final = 1 << 14  # of each connection in each turn
_SHARE_NS: Final = 1_000_000  # of each turn, for the requests of all
_LINES_PER_TURN: Final = 64
_ACCEPTS_PER_TURN: Final = 16
_GRACE_NS: Final = 500_000_000  # whoever has just come or just asked may go on
_LINGER_NS: Final = 1_000_000_000  # how long a last answer may take to leave
_NO_DESCRIPTOR: Final = frozenset((errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM))  # accept(2)
_ACCEPT_PAUSE_NS: Final = 100_000_000  # out of descriptors: look again later instead of spinning
_ANOTHER_USERS: Final = "this is another user's"
_MADE_WAY: Final = "all places are taken and this connection was idle; connect again when there is something to ask"


class Connection:
    """One peer of a `LineServer`; `name` and `context` are free for the owner, `reason` says why it ended."""

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
        self._next: bytes | None = None  # a line that waits for its turn
        self._asked = self._unanswered = 0
        self._came = self._last = server.reactor.now()

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

    def expect_answer(self) -> None:
        """Count a request that `answer` will answer: a client that waits for one is not closed for another."""
        self._unanswered += 1

    def answer(self, line: bytes) -> None:
        """Send the line of an answer."""
        self._unanswered -= 1
        self.send(line)

    def send(self, line: bytes) -> None:
        """Send one or more lines with their ends; on a connection that has ended a no-op.

        Never blocks, never raises for the peer's sake.
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
        self.send(self._server.complaint(kind, message))
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

    def eviction_order(self, now: int) -> tuple[int, int] | None:
        """Return in which order it has to make way, lowest first: a class and a time; None: not now. For the server."""
        if now - self._came < _GRACE_NS or self.reason:
            return None
        if not self._asked:
            return 0, self._came
        return (1 if now - self._last >= _GRACE_NS and self._unanswered <= 0 else 2), self._last

    def _on_readable(self) -> None:
        if self._next is not None:
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
        self._line_up()

    def _line_up(self) -> None:
        """Wait for the turn of the next line, if there is one."""
        self._next = None if self.reason else self._input.next_line()
        if self._next is not None:
            self._server.line_up(self, first=not self._asked)
        elif self._input.overflow and not self.reason:
            self.refuse("RemoteProtocolError", f"a request is longer than {MAX_REQUEST} bytes")

    def serve(self) -> None:
        """Serve the line whose turn it is; for the server."""
        line, self._next = self._next, None
        if line is None or self.reason:
            return
        self._asked += 1
        self._last = self._server.reactor.now()
        try:
            self._server.on_line(self, line)
        finally:
            # also when the owner raised: the lines behind the one that made him raise are innocent
            self._line_up()

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


def _none(_connection: Connection) -> bool:
    return False


class LineServer:
    """Serves a Unix socket from a reactor.

    Each callback gets the `Connection`; `on_line` also the line, without its end. `on_close` is called once for each
    connection that `on_connect` saw, and finds why in `connection.reason`: "gone" (the peer left), "slow", "closed", or
    the sentence the peer was told, of which `complaint(kind, message)` makes the line. SocketInUse when somebody serves
    the path already. `listener` is for an owner who listens at the path before he serves. `refused` counts peers of
    other users.
    """

    def __init__(
        self,
        reactor: Reactor,
        path: Path,
        on_connect: Callable[[Connection], object],
        on_line: Callable[[Connection, bytes], object],
        on_close: Callable[[Connection], object] = _ignore,
        *,
        complaint: Callable[[str, str], bytes],
        limit: int = 1 << 20,
        keeps: Callable[[Connection], bool] = _none,
        listener: socket.socket | None = None,
    ) -> None:
        self.reactor = reactor
        self.path = path
        self.limit = limit
        self.refused = 0
        self.on_connect, self.on_line, self.on_close, self.keeps = on_connect, on_line, on_close, keeps
        self.complaint = complaint
        self._connections: dict[Connection, None] = {}  # in the order in which they came
        self._count = 0
        self._newcomers: deque[Connection] = deque()  # whose first line waits
        self._waiting: deque[Connection] = deque()
        self._planned = False
        self._socket = sockets.listen(path) if listener is None else listener
        reactor.add_reader(self._socket, self._on_readable)

    @property
    def connections(self) -> list[Connection]:
        """Those who are here and not about to go."""
        return [connection for connection in self._connections if not connection.closed]

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

    def line_up(self, connection: Connection, *, first: bool) -> None:
        """Have a line of a connection served when it is its turn; for the connection."""
        (self._newcomers if first else self._waiting).append(connection)
        if not self._planned:
            self._planned = True
            self.reactor.call_soon(self._serve_turn)

    def _serve_turn(self) -> None:
        """Serve one line of each in turn, as long as this turn's share lasts."""
        until = self.reactor.now() + _SHARE_NS
        try:
            for _ in range(_LINES_PER_TURN):
                lined_up = self._newcomers or self._waiting
                if not lined_up:
                    break
                lined_up.popleft().serve()
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
                    self._make_room()  # one more, for a file that the newcomer's request may need
                    continue
                self._pause()
                return
            self._admit(sock)
            if full:
                return  # whether there is one more to make room for shows in the next turn

    def _pause(self) -> None:
        self.reactor.remove_reader(self._socket)
        self.reactor.call_later(_ACCEPT_PAUSE_NS, self._resume)

    def _resume(self) -> None:
        if self._socket.fileno() >= 0:
            self.reactor.add_reader(self._socket, self._on_readable)

    def _make_room(self) -> bool:
        """Close the connection of an idle client, told why, so that another may come; False if none is idle."""
        now = self.reactor.now()
        candidates = [
            each for each in self._connections if each.eviction_order(now) is not None and not self.keeps(each)
        ]
        if not candidates:
            return False
        leaving = min(candidates, key=lambda each: each.eviction_order(now) or (0, 0))
        leaving.send(self.complaint("BusError", _MADE_WAY))
        leaving.abandon(_MADE_WAY)
        return True

    def _turn_away(self, sock: socket.socket) -> None:
        self.refused += 1
        with sock, contextlib.suppress(OSError):
            sock.send(self.complaint("BusError", _ANOTHER_USERS))

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
