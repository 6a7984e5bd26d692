"""What uses python-can: a port for any of its adapters, including ``virtual:``, and a bounded reader of BLF recordings.

python-can's adapters may block in both directions and most have no descriptor. One thread therefore reads and another
one writes, except on ``virtual:``, which only uses queues. Received frames wait in memory behind a wake-up descriptor.

Any exception of an adapter is handled: `can.exceptions` documents CanError, but python-can-remote 0.3, pyserial and
pyusb raise others. A failing adapter is reported as DOWN once and used again; if it keeps failing it is closed and
reopened until that succeeds, and then reported as UP. Frames to be sent meanwhile are lost and counted, because old
commands must not arrive later. If a call of a driver never returns, its thread is abandoned and the port closes without
it.

python-can trusts every length in a BLF file: a header may claim gigabytes, an object may claim to be shorter than its
header (which would be read again for ever), and a container may unpack to a thousand times its size. `BlfReader` bounds
what is read and unpacked, and reports errors of the file.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import os
import struct
import threading
import time
import zlib
from typing import TYPE_CHECKING, Any, BinaryIO, Final

import can
from can.io import blf

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
    from collections.abc import Callable, Iterable, Iterator


_POLL_S: Final = 0.05  # maximum delay until the reader notices that the port was closed
_RETRY_S: Final = 0.1
_RECEIVE: Final = "receive"
_SEND: Final = "send"
# time of failures only (even on a bus without nodes) after which the adapter is reopened
_BROKEN_S: Final = {_RECEIVE: 1.0, _SEND: 5.0}
_REOPEN_S: Final = (0.5, 1.0, 2.0)  # pauses between attempts; the last one repeats
_SHUTDOWN_S: Final = 2.0  # time for a driver to close its device, or to return from a call
_QUEUE_LIMIT = 65536 * RECORD_SIZE
_CLOSED_HERE = "closed on this side"
_IDENTIFIER = 0x1FFFFFFF
_NS = 1_000_000_000
_DRIFT = 1e-4  # maximum drift of an adapter's clock


def message_of(frame: CanFrame, timestamp: float, channel: str | None = None) -> can.Message:
    """Return a received frame as a message; `timestamp` is Unix time in s."""
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
    """Return a message as a record; None for a CAN FD frame, which is not CANopen."""
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
    """Converter from an adapter's time stamps, whatever their origin, to monotonic time.

    Stamp 0 means an adapter without a clock; the result is the current time. Unix time is converted directly. The
    offset of any other clock is chosen so that no frame is later than its reading, and follows the drift; after a
    restart or a step of more than one second it is determined again.
    """

    def __init__(
        self, monotonic: Callable[[], int] = time.monotonic_ns, unix: Callable[[], int] = time.time_ns
    ) -> None:
        self._monotonic, self._unix = monotonic, UnixOffset(monotonic, unix)
        self._is_unix: bool | None = None
        self._lag = 0.0
        self._last_frame_ns: int | None = None

    def stamp(self, seconds: float) -> int:
        """Return the monotonic time in ns of a frame that is being read now; `seconds` is its time stamp."""
        now = self._monotonic()
        if not seconds:
            return now
        stamp_ns = round(seconds * _NS)
        by_unix = stamp_ns - self._unix.ns()
        if self._is_unix is not False:
            self._is_unix = 0 <= now - by_unix < _NS
            if self._is_unix:
                return by_unix
        return min(now, stamp_ns + self._lag_of(now - stamp_ns, now))

    def _lag_of(self, lag: int, now: int) -> int:
        """Return the minimum recent delay from time stamp to reading, in ns."""
        grown = self._lag + (0 if self._last_frame_ns is None else (now - self._last_frame_ns) * _DRIFT)
        restarted = self._last_frame_ns is None or lag - self._lag > _NS
        self._lag, self._last_frame_ns = (lag if restarted else min(lag, grown)), now
        return round(self._lag)


class PythonCanPort:
    """Port around a python-can bus, which it owns and shuts down; see `canopen_control.bus.port.Port`.

    `reopen` opens the adapter again; None if that is impossible. With `writer`, a separate thread sends.
    """

    def __init__(
        self, channel: str, bus: can.BusABC, *, writer: bool, reopen: Callable[[], can.BusABC] | None = None
    ) -> None:
        self.channel = channel
        self.stats = PortStats()
        self.wants_write = False  # the writer thread sends queued frames
        self._bus: can.BusABC | None = bus
        self._reopen = reopen
        self._lock = threading.Lock()  # protects all attributes below
        self._wake = WakeDescriptor()
        self._received = bytearray()
        self._stamps: list[int] = []
        self._taken_stamps: list[int] = []
        self._adapter_clock: AdapterClock | None = None  # set once stamps are requested
        self._events = BusEventLog()
        self._outgoing = SendQueue(SEND_LIMIT)
        self._lost = 0  # counted by the threads, not yet in `stats`
        self._down = False
        self._failing_since: dict[str, float] = {}  # verb: time of the first failure since it last succeeded
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
        return self._wake.fileno()

    def receive(self) -> bytes:
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
        """Enable time stamps of the adapter; a second call does nothing."""
        with self._lock:
            if self._adapter_clock is None:
                self._adapter_clock = AdapterClock()
                self._stamps = [0] * (len(self._received) // RECORD_SIZE)

    def receive_stamped(self) -> tuple[bytes, list[int]]:
        """Return the records of `receive` and the adapter's time of each, in monotonic ns; 0 if unknown."""
        records = self.receive()
        return records, self._taken_stamps

    def send(self, records: Records) -> None:
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
        """Do nothing; the writer thread sends as soon as the adapter accepts frames."""

    def events(self) -> list[BusEvent]:
        with self._lock:
            return self._events.drain()

    def close(self) -> None:
        """Shut the adapter down; a second call does nothing. A driver that does not return in time is abandoned."""
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

    # -- threads

    def _read_all(self) -> None:
        while not self._closing.is_set():
            bus = self._bus
            if bus is None or self._is_broken():
                self._reopen_adapter()
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
        """Send one frame, with retries for about a second; then drop this frame and all queued frames."""
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

    # -- failure and recovery

    def _fail(self, verb: str, error: Exception) -> None:
        """Record that receiving or sending failed; DOWN is reported once until the adapter works again."""
        with self._lock:
            self._failing_since.setdefault(verb, time.monotonic())
            if verb == _RECEIVE:
                self._lost += self._outgoing.clear()
                self.stats.queued = 0
            if not self._down and not self._closing.is_set():
                self._down = True
                self._events.add(BusEventKind.DOWN, f"bus {self.channel}: {_reason(error)}; retrying")
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
        """Whether the adapter has failed, without a success, for so long that it must be reopened."""
        if self._reopen is None or not self._failing_since:
            return False
        now = time.monotonic()
        return any(now - self._failing_since.get(verb, now) >= limit for verb, limit in _BROKEN_S.items())

    def _reopen_adapter(self) -> None:
        """Close the adapter and reopen it until that succeeds or the port is closed; runs on the reader's thread."""
        self._drop_bus()
        tries = 0
        while self._reopen is not None and not self._closing.is_set():
            try:
                bus = self._reopen()
            except Exception:  # noqa: BLE001 - drivers without a device raise any exception
                self._closing.wait(_REOPEN_S[min(tries, len(_REOPEN_S) - 1)])
                tries += 1
                continue
            if self._closing.is_set():
                _shut_down(bus)
                return
            self._take_bus(bus)
            return

    def _take_bus(self, bus: can.BusABC) -> None:
        """Use a reopened adapter; if sending failed before, it still counts as failing until a frame was sent."""
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
    return str(error).strip() or type(error).__name__


def _shut_down(bus: can.BusABC) -> None:
    """Shut an adapter down; abandon it if that blocks, as in python-can-remote 0.3 when the server is gone.

    An abandoned adapter is marked as shut down, or its destructor would try again when the interpreter ends.
    """

    def work() -> None:
        with contextlib.suppress(Exception):
            bus.shutdown()

    thread = threading.Thread(target=work, name="shut down", daemon=True)
    thread.start()
    thread.join(_SHUTDOWN_S)
    bus._is_shutdown = True  # noqa: SLF001 - python-can has no public method to disable the warning of its destructor


def known_interfaces() -> list[str]:
    """Return the names of python-can's interfaces, sorted, without those that this package opens itself."""
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
    """Return the missing package that a python-can interface requires, or None."""
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
    """Open the channel `name` of a python-can interface; `options` are further keywords of the interface.

    `served` means that the adapter connects to a server instead of a local device. Raise `InterfaceNotFound`,
    `BusError` with the message of python-can, or `ConfigError` if a package is missing that the adapter needs.
    """
    if interface not in can.VALID_INTERFACES:
        raise InterfaceNotFound(
            channel, f"python-can has no interface {interface!r}; choose one of: {', '.join(known_interfaces())}"
        )
    if (package := missing_package(interface)) is not None:
        raise ConfigError(f"bus {channel}: {interface} needs {package}, which is not installed: pip install {package}")
    keywords: dict[str, Any] = {key: can.util.cast_from_string(value) for key, value in options}
    bus_of = functools.partial(can.Bus, channel=name, interface=interface, **keywords)
    if bitrate is not None:
        bus_of = functools.partial(bus_of, bitrate=bitrate)
    try:
        bus = bus_of()
    except Exception as error:  # drivers without their library or device raise exceptions of any class
        advice = "check that its server is running" if served else "check its driver and that the device is plugged in"
        raise BusError(f"bus {channel}: python-can cannot open it: {_reason(error)}; {advice}") from error
    virtual = interface == "virtual"
    return PythonCanPort(channel, bus, writer=not virtual, reopen=None if virtual else bus_of)


LARGEST_CONTAINER: Final = 64 << 20  # bytes; common writers use 128 KiB
_SIZE_AT: Final = 8  # offset of the object length in its header
_SIZE: Final = struct.Struct("<L")
_SIGNATURE: Final = b"LOBJ"
_PADDING: Final = 8  # maximum padding in bytes before the next object


class BlfReader(can.BLFReader):
    """Reader of the messages in an open BLF file; raises EOFError if it is truncated, ValueError if it is damaged."""

    def __init__(self, file: BinaryIO) -> None:
        self._size = os.fstat(file.fileno()).st_size
        super().__init__(_Within(file, self._size))  # type: ignore[arg-type] # as much of a file as is needed

    def __iter__(self) -> Iterator[can.Message]:  # type: ignore[override] # a generator too
        header = blf.OBJ_HEADER_BASE_STRUCT
        while head := self.file.read(header.size):
            signature, _, _, length, kind = header.unpack(head)
            if signature != _SIGNATURE or length < header.size:
                raise ValueError("an object has no valid signature or length")
            if length - header.size > self._size - self.file.tell():
                self.file.read(self._size)  # all is read: the caller detects the truncation
                raise EOFError
            data = self.file.read(length - header.size)
            self.file.read(length % 4)  # padding
            if kind == blf.LOG_CONTAINER and (content := _unpacked(data)) is not None:
                yield from self._parse_container(content)
        self.stop()

    def _parse_container(self, data: bytes) -> Iterator[can.Message]:
        _refuse_standstill(self._tail + data)
        yield from super()._parse_container(data)


class _Within:
    """Wrapper of an open file whose `read` never allocates more than the file contains."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._size = file, size
        self.tell, self.close = file.tell, file.close

    def read(self, count: int) -> bytes:
        """Return up to `count` bytes, or b"" for a negative count."""
        return self._file.read(max(0, min(count, self._size - self._file.tell())))


def _unpacked(data: bytes) -> bytes | None:
    """Return the content of a container; None for an unknown compression. Raise ValueError if it is too large."""
    method, _ = blf.LOG_CONTAINER_STRUCT.unpack_from(data)
    packed = data[blf.LOG_CONTAINER_STRUCT.size :]
    if method == blf.NO_COMPRESSION:
        return packed
    if method != blf.ZLIB_DEFLATE:
        return None
    unpacker = zlib.decompressobj()
    content = unpacker.decompress(packed, LARGEST_CONTAINER)
    if unpacker.unconsumed_tail:
        raise ValueError(f"a container unpacks to more than {LARGEST_CONTAINER >> 20} MiB")
    return content


def _refuse_standstill(data: bytes) -> None:
    """Raise ValueError for an object shorter than its header, at which a reader would loop forever."""
    at = 0
    while (at := data.find(_SIGNATURE, at, at + _PADDING)) >= 0 and at + _SIZE_AT + _SIZE.size <= len(data):
        (length,) = _SIZE.unpack_from(data, at + _SIZE_AT)
        if length < blf.OBJ_HEADER_BASE_STRUCT.size:
            raise ValueError("an object is shorter than its header")
        at += length
