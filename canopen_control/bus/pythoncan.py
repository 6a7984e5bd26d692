"""The port of any python-can adapter, ``virtual:`` included.

python-can's adapters may block in both directions and most have no descriptor, so that a thread reads and, except on
``virtual:``, where sending is a matter of queues, another one writes. What they hand over waits in memory behind a
wake-up descriptor. An adapter that fails is not given up: it is told as DOWN once, tried again, and told as UP.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import can

from canopen_control.bus.error_events import note_errors
from canopen_control.bus.error_frames import has_error_frames
from canopen_control.bus.messages import message_of, record_of
from canopen_control.bus.port import BusEvent, BusEventKind, EventLog, PortStats, Records, whole_records
from canopen_control.bus.sendqueue import SEND_LIMIT, SendQueue
from canopen_control.bus.wake import Wake
from canopen_control.errors import BusClosed, BusError, InterfaceNotFound
from canopen_control.frame import RECORD_SIZE, frames_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.bus.channel import ChannelSpec

__all__ = ["PythonCanPort", "known_interfaces", "open_python_can"]

_POLL_S = 0.05  # how soon the reader notices that the port was closed
_RETRY_S = 0.1
_QUEUE_LIMIT = 65536 * RECORD_SIZE
_CLOSED_HERE = "closed on this side"


class PythonCanPort:
    """A python-can bus as a port; see `canopen_control.bus.port.Port`. It owns the bus and shuts it down."""

    def __init__(self, channel: str, bus: can.BusABC, *, writer: bool) -> None:
        self.channel = channel
        self.stats = PortStats()
        self.wants_write = False  # the writer thread sees to what waits
        self._bus = bus
        self._lock = threading.Lock()  # guards all that follows
        self._wake = Wake()
        self._received = bytearray()
        self._events = EventLog()
        self._outgoing = SendQueue(SEND_LIMIT)
        self._lost = 0  # by the threads, not yet in stats
        self._down = False
        self._closing = threading.Event()
        self._work = threading.Event()
        self._writes = writer
        threads: list[Callable[[], None]] = [self._read_all, self._write_all] if writer else [self._read_all]
        self._threads = [
            threading.Thread(target=work, name=f"{channel} {work.__name__}", daemon=True) for work in threads
        ]
        for thread in self._threads:
            thread.start()

    def fileno(self) -> int:
        """Return the descriptor that is readable while frames or events wait, -1 once closed."""
        return self._wake.fileno()

    def receive(self) -> bytes:
        """Return the whole records that wait, or ``b""``; raise `BusClosed` on a closed port."""
        self._check_open()
        with self._lock:
            self._wake.clear()
            records = bytes(self._received)
            self._received.clear()
            self.stats.lost += self._lost
            self._lost = 0
        if records:
            self.stats.rx += len(records) // RECORD_SIZE
            if has_error_frames(records):
                events = note_errors(records, self.stats)
                with self._lock:
                    self._events.extend(events)
        return records

    def send(self, records: Records) -> None:
        """Send whole records, or queue them for the writer; raise `BusClosed` on a closed port."""
        count = whole_records(records)
        self._check_open()
        self.stats.tx += count
        if self._writes:
            with self._lock:
                self.stats.lost += self._outgoing.put(records)
                self.stats.queued = len(self._outgoing)
            self._work.set()
            return
        for frame in frames_of(records):
            try:
                self._bus.send(message_of(frame, 0.0), timeout=0)
            except can.CanError as error:
                self._fail(error)
                self.stats.lost += 1

    def flush(self) -> None:
        """Do nothing: the writer thread sends as soon as the adapter takes it."""

    def events(self) -> list[BusEvent]:
        """Return what happened since the last call."""
        with self._lock:
            return self._events.drain()

    def close(self) -> None:
        """Shut the adapter down; a second call does nothing."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._work.set()
        for thread in self._threads:
            thread.join()
        self._bus.shutdown()
        self._wake.close()

    def _check_open(self) -> None:
        if self._closing.is_set():
            raise BusClosed(self.channel, _CLOSED_HERE)

    # Threads -------------------------------------------------------------------------------------------------------

    def _read_all(self) -> None:
        while not self._closing.is_set():
            try:
                message = self._bus.recv(_POLL_S)
            except (can.CanError, OSError) as error:
                self._fail(error)
                self._closing.wait(_RETRY_S)
                continue
            if message is not None:
                self._works_again()
                self._take(message)

    def _take(self, message: can.Message) -> None:
        record = record_of(message)
        with self._lock:
            if record is None or len(self._received) >= _QUEUE_LIMIT:
                self._lost += 1
                return
            if not self._received:
                self._wake.set()
            self._received += record

    def _write_all(self) -> None:
        while not self._closing.is_set():
            self._work.wait()
            self._work.clear()
            while not self._closing.is_set() and (record := self._next_record()):
                self._write(record)

    def _next_record(self) -> bytes:
        with self._lock:
            record = bytes(self._outgoing.data[:RECORD_SIZE])
            self._outgoing.taken(len(record))
            self.stats.queued = len(self._outgoing)
        return record

    def _write(self, record: bytes) -> None:
        """Send one frame, and try again while the adapter refuses it, for a second at most: it is old by then."""
        (frame,) = frames_of(record)
        message = message_of(frame, 0.0)
        for _ in range(int(1 / _RETRY_S)):
            try:
                self._bus.send(message, timeout=_POLL_S)
            except (can.CanError, OSError) as error:
                self._fail(error)
                if self._closing.wait(_RETRY_S):
                    return
            else:
                self._works_again()
                return
        with self._lock:
            self._lost += 1

    def _fail(self, error: Exception) -> None:
        with self._lock:
            if self._down:
                return
            self._down = True
            self._events.add(BusEventKind.DOWN, f"bus {self.channel}: {error}")
            self._wake.set()

    def _works_again(self) -> None:
        if not self._down:
            return
        with self._lock:
            self._down = False
            self._events.add(BusEventKind.UP, f"bus {self.channel}: works again")
            self._wake.set()


def known_interfaces() -> list[str]:
    """Return the names of python-can's interfaces, sorted, without those that have a better way in here."""
    return sorted(set(can.VALID_INTERFACES) - {"canopen_control", "socketcan"})


def open_python_can(spec: ChannelSpec) -> PythonCanPort:
    """Open a python-can adapter; raise `InterfaceNotFound` or `BusError` with python-can's own reason."""
    interface = "virtual" if spec.kind.in_process else spec.interface
    if interface not in can.VALID_INTERFACES:
        raise InterfaceNotFound(str(spec), f"python-can knows no {interface!r}, but: {', '.join(known_interfaces())}")
    options: dict[str, Any] = {} if spec.bitrate is None else {"bitrate": spec.bitrate}
    try:
        bus = can.Bus(channel=spec.name, interface=interface, **options)
    except Exception as error:  # drivers that lack a library or a device raise nearly anything
        raise BusError(
            f"bus {spec}: python-can cannot open it: {error}; is its driver installed, the device plugged in?"
        ) from error
    return PythonCanPort(str(spec), bus, writer=not spec.kind.in_process)
