"""The port of a ``local:`` bus: a Unix stream to the hub, one system call for a whole cycle's frames each way.

The first opener starts the hub and is not its parent; who opens first is decided under a lock. When the hub is gone,
`receive` and `send` raise `BusClosed`, and the next opening starts a new one.
"""

from __future__ import annotations

import contextlib
import os
import socket
import sys
from pathlib import Path
from typing import Final, NoReturn

from canopen_control.bus.error_events import note_errors
from canopen_control.bus.error_frames import has_error_frames
from canopen_control.bus.hello import HELLO_SIZE, VERSION, Hello, pack_hello, parse_hello
from canopen_control.bus.port import BusEventKind, EventLog, PortStats, Records, whole_records
from canopen_control.bus.sendqueue import SendQueue
from canopen_control.errors import BusClosed, BusError, CanopenError, ConfigError
from canopen_control.frame import RECORD_SIZE
from canopen_control.host.sockets import connect, lock, peer_pid, socket_path

__all__ = ["LocalPort", "greet", "open_local"]

_RECEIVE_SIZE: Final = 65536
_BUFFER_SIZE: Final = 1 << 20
_GREETING_TIMEOUT_S: Final = 5.0
_CLOSED_HERE: Final = "closed on this side"
_HUB_GONE: Final = "the hub process is gone; open the channel again, which starts a new one"


class LocalPort:
    """One end of a ``local:`` bus; see `canopen_control.bus.port.Port`. `label` is the one that the hub gave."""

    def __init__(self, name: str, sock: socket.socket, label: str) -> None:
        self.channel = f"local:{name}"
        self.label = label
        self.stats = PortStats()
        self._socket = sock
        self._partial = b""
        self._queue = SendQueue()
        self._events = EventLog()
        self.events = self._events.drain
        """Return what happened since the last call."""
        self._dropping = False
        self._gone = ""
        sock.setblocking(False)
        for option in (socket.SO_RCVBUF, socket.SO_SNDBUF):
            sock.setsockopt(socket.SOL_SOCKET, option, _BUFFER_SIZE)  # the kernel takes what it allows

    @property
    def wants_write(self) -> bool:
        """Whether frames wait for the kernel."""
        return bool(self._queue.data)

    def fileno(self) -> int:
        """Return the socket's descriptor, -1 once closed."""
        return self._socket.fileno()

    def receive(self) -> bytes:
        """Return the whole records that wait, or ``b""``; raise `BusClosed` when the hub is gone."""
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
        self.stats.rx += len(data) // RECORD_SIZE
        if has_error_frames(data):
            self._events.extend(note_errors(data, self.stats))
        return data

    def _reassemble(self, data: bytes) -> bytes:
        data = self._partial + data
        whole = len(data) - len(data) % RECORD_SIZE
        self._partial = data[whole:]
        return data[:whole]

    def send(self, records: Records) -> None:
        """Send whole records; what the kernel does not take is queued. Raise `BusClosed` when the hub is gone."""
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

    def flush(self) -> None:
        """Hand queued records to the kernel as far as it takes them; raise `BusClosed` when the hub is gone."""
        if self._queue.data:
            self._queue.taken(self._write(self._queue.data))
            self.stats.queued = len(self._queue)

    def _lose(self) -> NoReturn:
        if not self._gone:
            self._gone = _HUB_GONE
            self.stats.lost += self._queue.clear()
            self.stats.queued = 0
            self._events.add(BusEventKind.CLOSED, f"bus {self.channel}: {_HUB_GONE}")
        raise BusClosed(self.channel, self._gone)

    def close(self) -> None:
        """Leave the bus; a second call does nothing. What the kernel takes of the queue still goes out."""
        if self._gone == _CLOSED_HERE:
            return
        if not self._gone:
            with contextlib.suppress(BusClosed):
                self.flush()
        self._gone = _CLOSED_HERE
        self._socket.close()


def greet(sock: socket.socket, name: str, label: str) -> LocalPort | None:
    """Greet the hub at the other end of a fresh connection; None if it went away instead of answering.

    Raise `BusError` if it answers with another version or not at all. The socket is closed unless a port is returned.
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
        return LocalPort(name, sock, answer.label)
    sock.close()
    if answer is None:
        return None
    raise BusError(
        f"bus local:{name}: its hub (process {answer.pid}) speaks version {answer.version}, this program {VERSION}; "
        "close everything that uses the bus, then open it again"
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
    """Open a ``local:`` bus, and start its hub if there is none; raise `BusError` if that fails."""
    path = socket_path("bus", name)
    port = _join(path, name, label)
    if port is not None:
        return port
    with lock(path):  # held by one opener at a time, and by a hub that is about to end
        port = _join(path, name, label)
        if port is None:
            _start_hub(name)
            port = _join(path, name, label)
    if port is None:
        raise BusError(f"bus local:{name}: its hub ended as soon as it was started; is the machine out of memory?")
    return port


def _start_hub(name: str) -> None:
    """Start the hub as nobody's child and wait until it listens.

    Isolated and without site it starts in a third of the time; the package's own folder is all that it needs.
    """
    from canopen_control.host.spawn import spawn_detached

    folder = str(Path(__file__).parents[2])
    code = f"import sys; sys.path.insert(0, {folder!r}); from canopen_control.bus.hub import main; sys.exit(main())"
    try:
        spawn_detached([sys.executable, "-I", "-S", "-c", code, name], name=f"hub-{name}")
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
