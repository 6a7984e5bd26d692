"""Clients of the robot's API server in virtual time, including clients that never read.

A client connects and stays silent; or subscribes to everything and does not read; or sends a command that ends with its
connection, and disconnects; or requests the status and waits for each answer. Unread data stay in a buffer of some KiB,
as in a kernel; a server that waited for such a client would delay the robot, which is counted in `blocked`. Times are
in ns.
"""

from __future__ import annotations

import os
import struct
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

from canopen_control.host.lineclient import LineBuffer
from canopen_control.rpc import wire
from canopen_control.rpc.messages.robot import ROBOT, CommandController, GetStatus, Subscribe
from canopen_control.runtime.api import ApiServer

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Sequence

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.runtime.api import RequestObserver
    from canopen_control.runtime.core import RobotCore
    from canopen_control.simulation.robot_under_test import RobotUnderTest
    from canopen_control.simulation.virtual_time import Actor


_MS: Final = 1_000_000
EVERY_NS: Final = 100 * _MS  # request interval of a client that reads
_DEAF_NS: Final = 20 * _MS  # request interval of a client that does not read
_ROOM: Final = 4096  # kernel buffer in bytes for a client that does not read
_BLOCKED_NS: Final = 1000 * _MS  # delay of a server that waits for such a client
_STATE_RATE: Final = 50.0


class _ServerEnd:
    """Server's end of a simulated connection, as a non-blocking socket."""

    def __init__(self, client: SimulatedClient, actor: Actor) -> None:
        self._client, self._actor = client, actor
        self._fileno = actor.selector.allocate()
        self.inbox = bytearray()
        self.open = True

    def fileno(self) -> int:
        return self._fileno if self.open else -1

    def setblocking(self, _on: bool) -> None:
        """Ignored; the connection never blocks."""

    def getsockopt(self, _level: int, _option: int, _size: int = 0) -> bytes:
        """Return the peer credentials (SO_PEERCRED): user and group id, and a reproducible process id."""
        return struct.pack("3i", self._client.pid or self._fileno, os.getuid(), os.getgid())

    def arrived(self) -> None:
        """Notify the server of new data or of the end of the connection."""
        self._actor.selector.set_ready(self._fileno)
        self._actor.arrived()

    def recv(self, most: int) -> bytes:
        """Return data from the client, or b"" after the client has left; raise BlockingIOError if there is none yet."""
        data = bytes(self.inbox[:most])
        del self.inbox[:most]
        if not self.inbox and self._client.here:
            self._actor.selector.clear_ready(self._fileno)
        if not data and self._client.here:
            raise BlockingIOError
        return data

    def send(self, data: bytes) -> int:
        """Send what the client accepts, return its length; raise BlockingIOError for 0, BrokenPipeError at the end."""
        if not self._client.here:
            raise BrokenPipeError
        accepted = self._client.take(data)
        if not accepted:
            raise BlockingIOError
        return accepted

    def sendall(self, data: bytes) -> None:
        """Send all data; if the client does not accept all of it, the robot's process is blocked."""
        if self._client.take(data) < len(data):
            self._client.block()

    def close(self) -> None:
        self._actor.selector.clear_ready(self._fileno)
        self.open = False


class _Listener:
    """Listening socket for simulated clients."""

    def __init__(self, actor: Actor) -> None:
        self._actor = actor
        self._fileno = actor.selector.allocate()
        self._waiting: list[_ServerEnd] = []

    def fileno(self) -> int:
        return self._fileno

    def add(self, end: _ServerEnd) -> None:
        self._waiting.append(end)
        self._actor.selector.set_ready(self._fileno)
        self._actor.arrived()

    def accept(self) -> tuple[_ServerEnd, str]:
        """Return the oldest pending connection; raise BlockingIOError if none is pending."""
        if not self._waiting:
            self._actor.selector.clear_ready(self._fileno)
            raise BlockingIOError
        return self._waiting.pop(0), ""


class SimulatedClient:
    """Simulated client of the robot's API server; `reads` is False for a client that never reads.

    `dropped` is True once the robot has closed the connection, `waits_since` the time of the oldest unanswered request,
    `came_ns` the time of the connection, `asks` whether the client ever sent a request. `pid` is its process, 0 for
    none.
    """

    def __init__(self, clients: SimulatedClients, actor: Actor, *, reads: bool, pid: int = 0) -> None:
        self._clients, self.reads, self.pid = clients, reads, pid
        self.here = True
        self.came_ns = clients.robot.now_ns
        self.waits_since: int | None = None
        self.answers = 0
        self.end = _ServerEnd(self, actor)
        self._lines, self._unread, self._number = LineBuffer(), 0, 0

    @property
    def dropped(self) -> bool:
        return not self.end.open

    def ask(self, request: Request[Any]) -> None:
        self._number += 1
        if self.waits_since is None:
            self.waits_since = self._clients.robot.now_ns
        self.end.inbox += wire.request_line(self._number, ROBOT.of(type(request)).name, request)
        self.end.arrived()

    @property
    def asks(self) -> bool:
        return self._number > 0

    def take(self, data: bytes) -> int:
        """Receive server data up to the free buffer space; return the number of accepted bytes."""
        if not self.reads:
            accepted = min(len(data), _ROOM - self._unread)
            self._unread += accepted
            return accepted
        self._lines.feed(bytes(data))
        while (line := self._lines.next_line()) is not None:
            if b'"id":' in line[:8]:
                self.answers, self.waits_since = self.answers + 1, None
        return len(data)

    def leave(self) -> None:
        """Close the client's end of the connection."""
        self.here = False
        self.end.arrived()

    def block(self) -> None:
        """Stall the robot's process, as a server would that waits for this client, and count the stall."""
        self._clients.blocked += 1
        self._clients.robot.host.stall(_BLOCKED_NS)


C = TypeVar("C", bound=SimulatedClient)


class SimulatedClients:
    """All simulated clients of a robot.

    `blocked` counts how often the robot waited for a client, `all` are the clients of the robot's current process;
    `observer` receives each request, in the robot's time.
    """

    def __init__(self, robot: RobotUnderTest) -> None:
        self.robot = robot
        self.blocked = 0
        self.all: list[SimulatedClient] = []
        self.observer: RequestObserver | None = None
        self._core: RobotCore | None = None
        self._listener: _Listener
        self._server: ApiServer

    def connect(self, *, reads: bool) -> SimulatedClient:
        """Connect a new client; the first client of a process starts the robot's server."""
        self._open()
        return self.admit(SimulatedClient(self, self.robot.host, reads=reads))

    def admit(self, client: C) -> C:
        """Connect an existing client object to the server; return the client."""
        self._open()
        self.all.append(client)
        self._listener.add(client.end)
        return client

    def _open(self) -> None:
        """Start the server of the current process, unless it is already running."""
        robot = self.robot
        if robot.core is not self._core:
            self._core, self.all = robot.core, []
            self._listener = _Listener(robot.host)
            self._server = ApiServer(robot.core, cast("socket.socket", self._listener))
            self._server.observer = self.observer

    # -- kinds of clients

    def silent(self, count: int, for_ns: int | None) -> None:
        """Connect `count` clients that send nothing, for `for_ns` or forever."""
        for _ in range(count):
            self._leave_later(self.connect(reads=False), for_ns)

    def deaf(self, for_ns: int | None) -> None:
        """Connect a client that subscribes to everything and sends requests, but never reads."""
        client = self.connect(reads=False)
        client.ask(Subscribe(state_rate=_STATE_RATE, events=True, pdos=True, requests=True))
        self._leave_later(client, for_ns)
        self._ask_on(client, None)

    def ask(self, for_ns: int | None) -> None:
        """Connect a client that requests the status every 100 ms, each time after the last reply."""
        client = self.connect(reads=True)
        client.ask(GetStatus())
        until = None if for_ns is None else self.robot.now_ns + for_ns
        self._leave_later(client, for_ns)
        self._ask_on(client, until)

    def dead_man(self, controller: str, values: Sequence[float], for_ns: int, on_leave: Callable[[], object]) -> None:
        """Send one dead-man command; after `for_ns`, disconnect and call `on_leave`, unless the process has ended."""
        client = self.connect(reads=True)
        client.ask(CommandController(controller=controller, values=list(values), dead_man=True))
        self._leave_later(client, for_ns, on_leave)

    def _ask_on(self, client: SimulatedClient, until: int | None) -> None:
        now = self.robot.now_ns
        if not client.here or client.dropped or not self.serves(client) or (until is not None and now >= until):
            return
        if not client.reads or client.waits_since is None:
            client.ask(GetStatus())
        self.robot.time.later(EVERY_NS if client.reads else _DEAF_NS, lambda: self._ask_on(client, until))

    def _leave_later(
        self, client: SimulatedClient, for_ns: int | None, on_leave: Callable[[], object] = lambda: None
    ) -> None:
        def leave() -> None:
            if self.serves(client):
                client.leave()
                on_leave()

        if for_ns is not None:
            self.robot.time.later(for_ns, leave)

    def serves(self, client: SimulatedClient) -> bool:
        """Whether the process that a client is connected to still exists."""
        return self.robot.up and self.robot.core is self._core and client in self.all
