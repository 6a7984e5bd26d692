"""Hub process of a ``local:`` bus: sockets around a `FrameRouter`, and the control socket.

``python -m canopen_control.bus.hub NAME`` serves two sockets. On the first, each port sends a greeting and then
exchanges records: one read and one write per port and turn, however many frames, and no port can block the hub. The
second serves the requests of `rpc.messages.hub` (see `hubcontrol`). The hub ends two seconds after the last port was
closed.

To start quickly it imports little: the control socket (msgspec takes a third of the time) is loaded right after the
first greeting, or at the first control request.
"""

from __future__ import annotations

import functools
import os
import signal
import socket
import sys
from typing import TYPE_CHECKING, Final

from canopen_control.bus.frame_router import FrameRouter, RouterPort
from canopen_control.bus.subscription import GIVES_STAMPS, TAKES_SUBSCRIPTION, Hello, HelloServer, pack_hello
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.lifeline import report_failure, report_ready
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import close_listener, listen, lock, socket_path

if TYPE_CHECKING:
    from canopen_control.bus.hubcontrol import HubControl
    from canopen_control.host.timer import Timer


LINGER_NS: Final = 2_000_000_000
_RETRY_NS: Final = 50_000_000
_READ_SIZE: Final = 65536
_BUFFER_SIZE: Final = 1 << 20


class _End:
    __slots__ = ("member", "reading", "socket", "writing")

    def __init__(self, sock: socket.socket, member: RouterPort) -> None:
        self.socket, self.member = sock, member
        self.reading = True
        self.writing = False


class Hub:
    """Server of one ``local:`` bus on a reactor; `on_end` is called when the hub ends by itself."""

    def __init__(self, reactor: Reactor, name: str) -> None:
        self.name = name
        self.router = FrameRouter()
        self.on_end = reactor.stop
        self._reactor = reactor
        self._started = reactor.now()
        self._path = socket_path("bus", name)
        self._hello_server = HelloServer(reactor, listen(self._path), self._admit)
        self._ends: dict[int, _End] = {}  # key: number of the member
        self._flush_planned = False
        self._timer: Timer | None = None
        self._linger: Timer | None = None
        self._control: HubControl | None = None
        self._control_listener = listen(socket_path("busctl", name))
        reactor.add_reader(self._control_listener, self._serve_control)
        self._wait_for_ends()

    # -- members

    def _serve_control(self) -> None:
        """Load and start the control server; connections made before this call have waited in the kernel."""
        if self._control is None and self._control_listener.fileno() >= 0:
            self._reactor.remove_reader(self._control_listener)  # a failed import is not repeated
            from canopen_control.rpc.quick_verbs import import_msgspec

            import_msgspec()
            from canopen_control.bus.hubcontrol import HubControl

            self._control = HubControl(
                self.name, self.router, self._reactor, self._control_listener, started=self._started, after=self._after
            )

    def _admit(self, sock: socket.socket, hello: Hello) -> None:
        member = self.router.join(hello.label, hello.pid)
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            sock.setsockopt(socket.SOL_SOCKET, option, _BUFFER_SIZE)  # the kernel limits the size
        end = self._ends[member.number] = _End(sock, member)
        member.outbox += pack_hello(os.getpid(), member.label, abilities=TAKES_SUBSCRIPTION | GIVES_STAMPS)
        self._reactor.add_reader(sock, functools.partial(self._read, end))
        if self._linger is not None:
            self._linger.cancel()
        self._write(end)
        self._reactor.call_soon(self._serve_control)

    def _drop(self, end: _End) -> None:
        self.router.leave(end.member)
        self._ends.pop(end.member.number, None)
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
        """End the hub, unless a port is about to be opened: openers hold the lock while they start a hub."""
        try:
            with lock(self._path, 0):
                self._hello_server.accept()
                if not self._hello_server.busy and not self._ends:
                    self._end()
                    return
        except ConfigError:  # the folder was removed, or the lock is invalid: no opener can find this hub
            self._end()
            return
        except CanopenError:
            pass  # an opener holds the lock
        if not self._ends:
            self._linger = self._reactor.call_later(_RETRY_NS, self._expire)

    def _end(self) -> None:
        self.close()
        self.on_end()

    def close(self) -> None:
        """Close all sockets and remove their files; a second call does nothing."""
        self._hello_server.close()
        if self._control is not None:
            self._control.close()
        elif self._control_listener.fileno() >= 0:
            self._reactor.remove_reader(self._control_listener)
            close_listener(self._control_listener)
        for end in list(self._ends.values()):
            self._reactor.remove_reader(end.socket)
            self._reactor.remove_writer(end.socket)
            end.socket.close()
        self._ends.clear()
        for timer in (self._timer, self._linger):
            if timer is not None:
                timer.cancel()

    # -- frames

    def _read(self, end: _End) -> None:
        try:
            data = end.socket.recv(_READ_SIZE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(end)
            return
        self.router.receive(end.member, data, self._reactor.now())
        self._after()

    def _after(self) -> None:
        """Update writers, readers and the timer after the router has changed."""
        if self.router.dirty and not self._flush_planned:
            self._flush_planned = True
            self._reactor.call_soon(self._flush)
        if self.router.wire is not None or self._timer is not None:
            self._plan_tick()
            self._pace_readers()
        elif self.router.next_deadline() is not None:
            self._plan_tick()

    def _flush(self) -> None:
        self._flush_planned = False
        for member in self.router.take_dirty():
            end = self._ends.get(member.number)
            if end is not None and not end.writing:
                self._write(end)

    def _write(self, end: _End) -> None:
        member = end.member
        try:
            sent = end.socket.send(member.outbox) if member.outbox else 0
        except BlockingIOError:
            sent = 0
        except OSError:
            self._drop(end)
            return
        self.router.sent(member, sent)
        if bool(member.outbox) is not end.writing:
            end.writing = not end.writing
            if end.writing:
                self._reactor.add_writer(end.socket, functools.partial(self._write, end))
            else:
                self._reactor.remove_writer(end.socket)

    def _plan_tick(self) -> None:
        deadline = self.router.next_deadline()
        if self._timer is not None:
            if self._timer.active and self._timer.deadline_ns == deadline:
                return
            self._timer.cancel()
        self._timer = None if deadline is None else self._reactor.call_at(deadline, self._tick)

    def _tick(self) -> None:
        self.router.tick(self._reactor.now())
        self._after()

    def _pace_readers(self) -> None:
        for end in self._ends.values():
            if self.router.may_read(end.member) is not end.reading:
                end.reading = not end.reading
                if end.reading:
                    self._reactor.add_reader(end.socket, functools.partial(self._read, end))
                else:
                    self._reactor.remove_reader(end.socket)


def main(arguments: list[str] | None = None) -> int:
    """Serve the bus named on the command line until its last port is closed; return 1 if the hub cannot start."""
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
