"""The port of any python-can adapter, ``virtual:`` included.

python-can's adapters may block in both directions and most have no descriptor, so that a thread reads and, except on
``virtual:``, where sending is a matter of queues, another one writes. What they hand over waits in memory behind a
wake-up descriptor. An adapter that fails is not given up: it is told as DOWN once, tried again, and told as UP.
"""

from __future__ import annotations

import functools
import importlib.util
import threading
from typing import TYPE_CHECKING

import can

from canopen_control.bus.error_events import note_errors
from canopen_control.bus.error_frames import has_error_frames
from canopen_control.bus.port import BusEvent, BusEventKind, PortStats, Records, whole_records
from canopen_control.bus.port_parts import SEND_LIMIT, EventLog, SendQueue, WakeDescriptor
from canopen_control.errors import BusClosed, BusError, ConfigError, InterfaceNotFound
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, RECORD, RECORD_SIZE, REMOTE_FLAG, CanFrame, frames_of

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["PythonCanPort", "known_interfaces", "message_of", "missing_package", "open_python_can", "record_of"]

_POLL_S = 0.05  # how soon the reader notices that the port was closed
_RETRY_S = 0.1
_QUEUE_LIMIT = 65536 * RECORD_SIZE
_CLOSED_HERE = "closed on this side"
_IDENTIFIER = 0x1FFFFFFF


def message_of(frame: CanFrame, timestamp: float, channel: str | None = None) -> can.Message:
    """Return a received frame as a message; `timestamp` is unix seconds."""
    remote = frame.is_remote
    return can.Message(
        timestamp=timestamp,
        arbitration_id=frame.can_id & _IDENTIFIER,
        is_extended_id=bool(frame.can_id & EXTENDED_FLAG),
        is_remote_frame=remote,
        is_error_frame=frame.is_error,
        channel=channel,
        dlc=len(frame.data),
        data=None if remote else frame.data,
    )


def record_of(message: can.Message) -> bytes | None:
    """Return a message as a record; None for a CAN FD frame, which CANopen does not know."""
    if message.is_fd:
        return None
    can_id = message.arbitration_id & _IDENTIFIER
    if message.is_error_frame:
        can_id |= ERROR_FLAG
    elif message.is_extended_id:
        can_id |= EXTENDED_FLAG
    if message.is_remote_frame:
        return RECORD.pack(can_id | REMOTE_FLAG, min(message.dlc, 8), b"")
    return RECORD.pack(can_id, min(message.dlc, 8), bytes(message.data))


class PythonCanPort:
    """A python-can bus as a port; see `canopen_control.bus.port.Port`. It owns the bus and shuts it down."""

    def __init__(self, channel: str, bus: can.BusABC, *, writer: bool) -> None:
        self.channel = channel
        self.stats = PortStats()
        self.wants_write = False  # the writer thread sees to what waits
        self._bus = bus
        self._lock = threading.Lock()  # guards all that follows
        self._wake = WakeDescriptor()
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


#: interface -> the module that its adapter imports, and the package that has it
_PACKAGES = {
    "canalystii": ("canalystii", "canalystii"),
    "cantact": ("cantact", "cantact"),
    "gs_usb": ("gs_usb", "gs-usb"),
    "neovi": ("ics", "python-ics"),
    "nixnet": ("nixnet", "nixnet"),
    "robotell": ("serial", "pyserial"),
    "seeedstudio": ("serial", "pyserial"),
    "serial": ("serial", "pyserial"),
    "slcan": ("serial", "pyserial"),
    "udp_multicast": ("msgpack", "msgpack"),
}


def missing_package(interface: str) -> str | None:
    """Return the package that an interface of python-can needs and that is not installed, None if there is none."""
    module, package = _PACKAGES.get(interface, ("can", "python-can"))
    return package if importlib.util.find_spec(module) is None else None


def open_python_can(channel: str, interface: str, name: str, bitrate: int | None) -> PythonCanPort:
    """Open `name` of a python-can `interface`, which is `channel` to us.

    Raise `InterfaceNotFound`, `BusError` with python-can's own reason, or `ConfigError` where a package is missing that
    the adapter needs.
    """
    if interface not in can.VALID_INTERFACES:
        raise InterfaceNotFound(channel, f"python-can knows no {interface!r}, but: {', '.join(known_interfaces())}")
    if (package := missing_package(interface)) is not None:
        raise ConfigError(f"bus {channel}: {interface} needs {package}, which is not installed: pip install {package}")
    bus_of = functools.partial(can.Bus, channel=name, interface=interface)
    try:
        bus = bus_of() if bitrate is None else bus_of(bitrate=bitrate)
    except Exception as error:  # drivers that lack a library or a device raise nearly anything
        raise BusError(
            f"bus {channel}: python-can cannot open it: {error}; is its driver installed, the device plugged in?"
        ) from error
    return PythonCanPort(channel, bus, writer=interface != "virtual")
