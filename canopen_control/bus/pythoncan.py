"""The port of any python-can adapter, ``virtual:`` included.

python-can's adapters may block in both directions and most have no descriptor, so that a thread reads and, except on
``virtual:``, where sending is a matter of queues, another one writes. What they hand over waits in memory behind a
wake-up descriptor.

An adapter that fails is not given up, whatever it raises: python-can's own errors, those of the operating system and
of a driver's library come from the same calls (`can.exceptions` promises CanError, and python-can-remote 0.3, pyserial
and pyusb raise others). It is told as DOWN once and tried again; one that stays broken is closed and opened anew, until
that works; then it is told as UP. What was to be sent meanwhile is lost and counted: an old command must not arrive
later. A call of a driver that never returns keeps nobody: its thread is left behind, and the port closes without it.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import threading
import time
from typing import TYPE_CHECKING, Any, Final

import can

from canopen_control.bus.error_events import note_errors
from canopen_control.bus.error_frames import has_error_frames
from canopen_control.bus.port import (
    SEND_LIMIT,
    BusEvent,
    BusEventKind,
    BusEventLog,
    PortStats,
    Records,
    SendQueue,
    WakeDescriptor,
    whole_records,
)
from canopen_control.bus.port_abilities import UnixOffset
from canopen_control.errors import BusClosed, BusError, ConfigError, InterfaceNotFound
from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, RECORD, RECORD_SIZE, REMOTE_FLAG, CanFrame, frames_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable


_POLL_S: Final = 0.05  # how soon the reader notices that the port was closed
_RETRY_S: Final = 0.1
_RECEIVE: Final = "receive"
_SEND: Final = "send"
_BROKEN_S: Final = {_RECEIVE: 1.0, _SEND: 5.0}  # of nothing but failures (of a bus without nodes, too): opened anew
_REOPEN_S: Final = (0.5, 1.0, 2.0)  # from one try to the next; the last one goes on
_SHUTDOWN_S: Final = 2.0  # for a driver to close its device, or to return from a call
_QUEUE_LIMIT = 65536 * RECORD_SIZE
_CLOSED_HERE = "closed on this side"
_IDENTIFIER = 0x1FFFFFFF
_NS = 1_000_000_000
_DRIFT = 1e-4  # of an adapter's clock against ours, at most


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


class AdapterClock:
    """Makes our monotonic time of an adapter's time stamps, whatever they count from.

    One that has no clock says 0: that is now. Unix time is taken as it is. A clock of the adapter's own, or of another
    machine, is laid so that no frame comes later than it was read, and follows its drift; one that begins anew, or
    leaps by more than a second, is laid anew.
    """

    def __init__(
        self, monotonic: Callable[[], int] = time.monotonic_ns, unix: Callable[[], int] = time.time_ns
    ) -> None:
        self._monotonic, self._unix = monotonic, UnixOffset(monotonic, unix)
        self._is_unix: bool | None = None
        self._lag = 0.0
        self._seen: int | None = None

    def stamp(self, seconds: float) -> int:
        """Return when a frame came, which is handed over now."""
        now = self._monotonic()
        if not seconds:
            return now
        told = round(seconds * _NS)
        by_unix = told - self._unix.ns()
        if self._is_unix is not False:
            self._is_unix = 0 <= now - by_unix < _NS
            if self._is_unix:
                return by_unix
        return min(now, told + self._lag_of(now - told, now))

    def _lag_of(self, lag: int, now: int) -> int:
        """Return the least by which frames were read later than stamped, of late."""
        grown = self._lag + (0 if self._seen is None else (now - self._seen) * _DRIFT)
        begins_anew = self._seen is None or lag - self._lag > _NS
        self._lag, self._seen = (lag if begins_anew else min(lag, grown)), now
        return round(self._lag)


class PythonCanPort:
    """A python-can bus as a port; see `canopen_control.bus.port.Port`. It owns the bus and shuts it down.

    `reopen` opens the adapter once more, None for one that is not opened anew. With a `writer` a thread sends.
    """

    def __init__(
        self, channel: str, bus: can.BusABC, *, writer: bool, reopen: Callable[[], can.BusABC] | None = None
    ) -> None:
        self.channel = channel
        self.stats = PortStats()
        self.wants_write = False  # the writer thread sees to what waits
        self._bus: can.BusABC | None = bus
        self._reopen = reopen
        self._lock = threading.Lock()  # guards all that follows
        self._wake = WakeDescriptor()
        self._received = bytearray()
        self._stamps: list[int] = []
        self._taken_stamps: list[int] = []
        self._adapter_clock: AdapterClock | None = None  # once stamps are asked for
        self._events = BusEventLog()
        self._outgoing = SendQueue(SEND_LIMIT)
        self._lost = 0  # by the threads, not yet in stats
        self._down = False
        self._failing_since: dict[str, float] = {}  # verb -> when it first failed, since it last worked
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
            self._taken_stamps, self._stamps = self._stamps, []
            self.stats.lost += self._lost
            self._lost = 0
        if records:
            self.stats.rx += len(records) // RECORD_SIZE
            if has_error_frames(records):
                events = note_errors(records, self.stats)
                with self._lock:
                    self._events.extend(events)
        return records

    def ask_stamps(self) -> None:
        """Keep the adapter's time of each frame from now on; a second call does nothing."""
        with self._lock:
            if self._adapter_clock is None:
                self._adapter_clock = AdapterClock()
                self._stamps = [0] * (len(self._received) // RECORD_SIZE)

    def receive_stamped(self) -> tuple[bytes, list[int]]:
        """Return what `receive` does, and when each record came by the adapter, in monotonic ns; 0: not known."""
        records = self.receive()
        return records, self._taken_stamps

    def send(self, records: Records) -> None:
        """Send whole records, or queue them for the writer; raise `BusClosed` on a closed port."""
        count = whole_records(records)
        self._check_open()
        self.stats.tx += count
        bus = self._bus
        if bus is None or _RECEIVE in self._failing_since:
            self.stats.lost += count
        elif self._writes:
            with self._lock:
                self.stats.lost += self._outgoing.put(records)
                self.stats.queued = len(self._outgoing)
            self._work.set()
        else:
            for frame in frames_of(records):
                try:
                    bus.send(message_of(frame, 0.0), timeout=0)
                except Exception as error:  # noqa: BLE001 - a driver raises anything, see above
                    self._fail(_SEND, error)
                    self.stats.lost += 1

    def flush(self) -> None:
        """Do nothing: the writer thread sends as soon as the adapter takes it."""

    def events(self) -> list[BusEvent]:
        """Return what happened since the last call."""
        with self._lock:
            return self._events.drain()

    def close(self) -> None:
        """Shut the adapter down; a second call does nothing. A driver that hangs is left behind after a moment."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._work.set()
        end = time.monotonic() + _SHUTDOWN_S
        for thread in self._threads:
            thread.join(max(0.0, end - time.monotonic()))
        self._drop_bus()
        self._wake.close()

    def _check_open(self) -> None:
        if self._closing.is_set():
            raise BusClosed(self.channel, _CLOSED_HERE)

    # Threads -------------------------------------------------------------------------------------------------------

    def _read_all(self) -> None:
        while not self._closing.is_set():
            bus = self._bus
            if bus is None or self._is_broken():
                self._open_anew()
                continue
            try:
                message = bus.recv(_POLL_S)
            except Exception as error:  # noqa: BLE001 - a driver raises anything, see above
                self._fail(_RECEIVE, error)
                self._closing.wait(_RETRY_S)
                continue
            if message is not None:
                self._works_again(_RECEIVE, _SEND)
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
            if self._adapter_clock is not None:
                self._stamps.append(self._adapter_clock.stamp(message.timestamp))

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
        """Send one frame, and try again while the adapter refuses it, for a second at most: all is old by then."""
        (frame,) = frames_of(record)
        message = message_of(frame, 0.0)
        for _ in range(int(1 / _RETRY_S)):
            bus = self._bus
            if bus is None or _RECEIVE in self._failing_since:
                break
            try:
                bus.send(message, timeout=_POLL_S)
            except Exception as error:  # noqa: BLE001 - a driver raises anything, see above
                self._fail(_SEND, error)
                if self._closing.wait(_RETRY_S):
                    return
            else:
                self._works_again(_SEND)
                return
        with self._lock:
            self._lost += 1 + self._outgoing.clear()
            self.stats.queued = 0

    # Down and up ---------------------------------------------------------------------------------------------------

    def _fail(self, verb: str, error: Exception) -> None:
        """Note that receiving or sending failed: told once, until it works again."""
        with self._lock:
            self._failing_since.setdefault(verb, time.monotonic())
            if verb == _RECEIVE:
                self._lost += self._outgoing.clear()
                self.stats.queued = 0
            if not self._down and not self._closing.is_set():
                self._down = True
                self._events.add(BusEventKind.DOWN, f"bus {self.channel}: {_reason(error)}; it is tried again")
            self._wake.set()

    def _works_again(self, *verbs: str) -> None:
        if not self._failing_since and not self._down:
            return
        with self._lock:
            for verb in verbs:
                self._failing_since.pop(verb, None)
            if self._down and not self._failing_since:
                self._down = False
                self._events.add(BusEventKind.UP, f"bus {self.channel}: works again")
                self._wake.set()

    def _is_broken(self) -> bool:
        """Whether the adapter has done nothing but fail for so long that opening it anew is what may help."""
        if self._reopen is None or not self._failing_since:
            return False
        now = time.monotonic()
        return any(now - self._failing_since.get(verb, now) >= limit for verb, limit in _BROKEN_S.items())

    def _open_anew(self) -> None:
        """Close the adapter and open it until that works, or the port is closed; on the reader's thread."""
        self._drop_bus()
        tries = 0
        while self._reopen is not None and not self._closing.is_set():
            try:
                bus = self._reopen()
            except Exception:  # noqa: BLE001 - drivers that lack a device raise nearly anything, and DOWN is told
                self._closing.wait(_REOPEN_S[min(tries, len(_REOPEN_S) - 1)])
                tries += 1
                continue
            if self._closing.is_set():
                _shut_down(bus)
                return
            self._take_bus(bus)
            return

    def _take_bus(self, bus: can.BusABC) -> None:
        """Go on with an adapter that was opened anew: what could not send has to send before it counts as working."""
        with self._lock:
            self._bus = bus
            if _SEND in self._failing_since:
                self._failing_since[_SEND] = time.monotonic()
        try:
            message = bus.recv(_POLL_S)
        except Exception as error:  # noqa: BLE001 - a driver raises anything, see above
            with self._lock:
                self._failing_since[_RECEIVE] = time.monotonic()
            self._fail(_RECEIVE, error)
            self._closing.wait(_REOPEN_S[-1])
            return
        self._works_again(_RECEIVE, *((_SEND,) if message is not None else ()))
        if message is not None:
            self._take(message)

    def _drop_bus(self) -> None:
        with self._lock:
            bus, self._bus = self._bus, None
            self._lost += self._outgoing.clear()
            self.stats.queued = 0
        if bus is not None:
            _shut_down(bus)


def _reason(error: Exception) -> str:
    """Return what an exception says, which of some drivers is nothing but its class."""
    return str(error).strip() or type(error).__name__


def _shut_down(bus: can.BusABC) -> None:
    """Shut an adapter down, and go on without it if that hangs: python-can-remote 0.3 waits for a server that is gone.

    One that is left behind counts as shut down, or its destructor would begin once more as the interpreter ends.
    """

    def work() -> None:
        with contextlib.suppress(Exception):
            bus.shutdown()

    thread = threading.Thread(target=work, name="shut down", daemon=True)
    thread.start()
    thread.join(_SHUTDOWN_S)
    bus._is_shutdown = True  # noqa: SLF001 - python-can has no other way to say that its destructor is not needed


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


def open_python_can(
    channel: str,
    interface: str,
    name: str,
    bitrate: int | None,
    options: Iterable[tuple[str, str]] = (),
    *,
    served: bool = False,
) -> PythonCanPort:
    """Open `name` of a python-can `interface`, which is `channel` to us; `options` are its other keywords.

    One that is `served` has no device here but a server somewhere.

    Raise `InterfaceNotFound`, `BusError` with python-can's own reason, or `ConfigError` where a package is missing that
    the adapter needs.
    """
    if interface not in can.VALID_INTERFACES:
        raise InterfaceNotFound(channel, f"python-can knows no {interface!r}, but: {', '.join(known_interfaces())}")
    if (package := missing_package(interface)) is not None:
        raise ConfigError(f"bus {channel}: {interface} needs {package}, which is not installed: pip install {package}")
    keywords: dict[str, Any] = {key: can.util.cast_from_string(value) for key, value in options}
    bus_of = functools.partial(can.Bus, channel=name, interface=interface, **keywords)
    if bitrate is not None:
        bus_of = functools.partial(bus_of, bitrate=bitrate)
    try:
        bus = bus_of()
    except Exception as error:  # drivers that lack a library or a device raise nearly anything
        advice = "does its server run there?" if served else "is its driver installed, the device plugged in?"
        raise BusError(f"bus {channel}: python-can cannot open it: {_reason(error)}; {advice}") from error
    virtual = interface == "virtual"
    return PythonCanPort(channel, bus, writer=not virtual, reopen=None if virtual else bus_of)
