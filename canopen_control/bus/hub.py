"""The hub process of a ``local:`` bus: sockets around `exchange.Exchange`, and the control socket.

``python -m canopen_control.bus.hub NAME`` serves two sockets. On the first, each end greets (`hello`), then sends and
receives records; one read and one write a turn for each end, however many frames, and none of them can make the hub
wait. On the second, requests as JSON lines: {"id", "method", "params"} is answered by {"id", "result"} or {"id",
"error"}, with the methods of `Control`. Two seconds after the last end has left, the hub is gone. It imports little, so
that it is there at once.
"""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import socket
import sys
from typing import TYPE_CHECKING

from canopen_control.bus.exchange import Exchange, Member
from canopen_control.bus.hello import HELLO_SIZE, VERSION, pack_hello, parse_hello
from canopen_control.bus.hubcontrol import Control
from canopen_control.errors import CanopenError
from canopen_control.host.jsonlines import LineServer
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import close_listener, listen, lock, same_user, socket_path
from canopen_control.host.spawn import report_failure, report_ready

if TYPE_CHECKING:
    from canopen_control.host.timer import Timer

__all__ = ["LINGER_NS", "Hub", "main"]

LINGER_NS = 2_000_000_000
_GREETING_NS = 5_000_000_000
_RETRY_NS = 50_000_000
_READ_SIZE = 65536
_BUFFER_SIZE = 1 << 20


class _End:
    """One connection: greeting first, then a member of the exchange."""

    __slots__ = ("greeting", "greeting_timer", "member", "reading", "socket", "writing")

    def __init__(self, sock: socket.socket) -> None:
        self.socket = sock
        self.member: Member | None = None
        self.greeting = b""
        self.greeting_timer: Timer | None = None
        self.reading = True
        self.writing = False


class Hub:
    """Serves one bus from a reactor; `close` ends it, and `on_end` is called when it has ended by itself."""

    def __init__(self, reactor: Reactor, name: str) -> None:
        self.name = name
        self.exchange = Exchange()
        self.on_end = reactor.stop
        self._reactor = reactor
        self._path = socket_path("bus", name)
        self._listener = listen(self._path)
        self._ends: dict[int, _End] = {}  # by the member's number
        self._greeting: set[_End] = set()
        self._flush_planned = False
        self._timer: Timer | None = None
        self._linger: Timer | None = None
        control = Control(name, self.exchange, reactor.now, self._after)
        self._server = LineServer(reactor, socket_path("busctl", name), control.on_connect, control.on_message)
        reactor.add_reader(self._listener, self._accept)
        self._wait_for_ends()

    # Coming and going ----------------------------------------------------------------------------------------------

    def _accept(self) -> None:
        try:
            sock, _ = self._listener.accept()
        except OSError:  # it changed its mind
            return
        if not same_user(sock):
            sock.close()
            return
        sock.setblocking(False)
        end = _End(sock)
        self._greeting.add(end)
        end.greeting_timer = self._reactor.call_later(_GREETING_NS, functools.partial(self._dismiss, end))
        self._reactor.add_reader(sock, functools.partial(self._greet, end))

    def _dismiss(self, end: _End) -> None:
        """Drop a connection that is no member."""
        self._greeting.discard(end)
        if end.greeting_timer is not None:
            end.greeting_timer.cancel()
        self._reactor.remove_reader(end.socket)
        end.socket.close()

    def _greet(self, end: _End) -> None:
        try:
            data = end.socket.recv(HELLO_SIZE - len(end.greeting))
        except BlockingIOError:
            return
        except OSError:
            data = b""
        end.greeting += data
        if data and len(end.greeting) < HELLO_SIZE:
            return
        hello = parse_hello(end.greeting)
        if hello is not None and hello.version != VERSION:
            self._refuse(end)
            hello = None
        if hello is None:
            self._dismiss(end)
            return
        self._admit(end, self.exchange.join(hello.label, hello.pid))

    @staticmethod
    def _refuse(end: _End) -> None:
        """Tell the other version ours, as far as the kernel takes it at once."""
        with contextlib.suppress(OSError):
            end.socket.send(pack_hello(os.getpid(), ""))

    def _admit(self, end: _End, member: Member) -> None:
        self._greeting.discard(end)
        if end.greeting_timer is not None:
            end.greeting_timer.cancel()
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            end.socket.setsockopt(socket.SOL_SOCKET, option, _BUFFER_SIZE)  # the kernel takes what it allows
        end.member = member
        self._ends[member.number] = end
        member.outbox += pack_hello(os.getpid(), member.label)
        self._reactor.add_reader(end.socket, functools.partial(self._read, end, member))
        if self._linger is not None:
            self._linger.cancel()
        self._write(end, member)

    def _drop(self, end: _End, member: Member) -> None:
        self.exchange.leave(member)
        self._ends.pop(member.number, None)
        self._reactor.remove_reader(end.socket)
        self._reactor.remove_writer(end.socket)
        end.socket.close()
        self._wait_for_ends()

    def _wait_for_ends(self) -> None:
        if not self._ends:
            if self._linger is not None:
                self._linger.cancel()
            self._linger = self._reactor.call_later(LINGER_NS, self._expire)

    def _expire(self) -> None:
        """End, unless somebody is about to join: the lock is the one that openers hold while they start a hub."""
        try:
            with lock(self._path, 0):
                self._accept()
                if not self._greeting and not self._ends:
                    self._end()
                    return
        except CanopenError:
            pass  # an opener holds the lock
        except OSError:  # the folder is gone: nobody finds this hub any more
            self._end()
            return
        if not self._ends:
            self._linger = self._reactor.call_later(_RETRY_NS, self._expire)

    def _end(self) -> None:
        self.close()
        self.on_end()

    def close(self) -> None:
        """Leave nothing behind; a second call does nothing."""
        if self._listener.fileno() >= 0:
            self._reactor.remove_reader(self._listener)
        close_listener(self._listener)
        self._server.close()
        for end in list(self._greeting):
            self._dismiss(end)
        for end in list(self._ends.values()):
            self._reactor.remove_reader(end.socket)
            self._reactor.remove_writer(end.socket)
            end.socket.close()
        self._ends.clear()
        for timer in (self._timer, self._linger):
            if timer is not None:
                timer.cancel()

    # Frames --------------------------------------------------------------------------------------------------------

    def _read(self, end: _End, member: Member) -> None:
        try:
            data = end.socket.recv(_READ_SIZE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(end, member)
            return
        self.exchange.receive(member, data, self._reactor.now())
        self._after()

    def _after(self) -> None:
        """See to what the exchange wants next: writing at the end of this turn, a timer, less or more reading."""
        if self.exchange.dirty and not self._flush_planned:
            self._flush_planned = True
            self._reactor.call_soon(self._flush)
        if self.exchange.wire is not None or self._timer is not None:
            self._plan_tick()
            self._pace_readers()
        elif self.exchange.next_deadline() is not None:
            self._plan_tick()

    def _flush(self) -> None:
        self._flush_planned = False
        for member in self.exchange.take_dirty():
            end = self._ends.get(member.number)
            if end is not None and not end.writing:
                self._write(end, member)

    def _write(self, end: _End, member: Member) -> None:
        try:
            sent = end.socket.send(member.outbox) if member.outbox else 0
        except BlockingIOError:
            sent = 0
        except OSError:
            self._drop(end, member)
            return
        self.exchange.sent(member, sent)
        if bool(member.outbox) is not end.writing:
            end.writing = not end.writing
            if end.writing:
                self._reactor.add_writer(end.socket, functools.partial(self._write, end, member))
            else:
                self._reactor.remove_writer(end.socket)

    def _plan_tick(self) -> None:
        deadline = self.exchange.next_deadline()
        if self._timer is not None:
            if self._timer.active and self._timer.deadline_ns == deadline:
                return
            self._timer.cancel()
        self._timer = None if deadline is None else self._reactor.call_at(deadline, self._tick)

    def _tick(self) -> None:
        self.exchange.tick(self._reactor.now())
        self._after()

    def _pace_readers(self) -> None:
        for end in self._ends.values():
            member = end.member
            if member is not None and self.exchange.may_read(member) is not end.reading:
                end.reading = not end.reading
                if end.reading:
                    self._reactor.add_reader(end.socket, functools.partial(self._read, end, member))
                else:
                    self._reactor.remove_reader(end.socket)


def main(arguments: list[str] | None = None) -> int:
    """Serve the bus named on the command line until the last end has left."""
    (name,) = sys.argv[1:] if arguments is None else arguments
    reactor = Reactor()
    try:
        hub = Hub(reactor, name)
    except CanopenError as error:
        report_failure(str(error))
        return 1
    reactor.handle_signals({signal.SIGTERM: reactor.stop, signal.SIGINT: reactor.stop})
    report_ready()
    try:
        reactor.run()
    finally:
        hub.close()
        reactor.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
