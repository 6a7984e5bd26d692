"""CAN bus inside one process, for tests; faults are switched on and off by calls.

Nothing happens by itself: when `send` returns, the frame is in the queues of all other ports, in the order of sending.
A delay has no duration but ends by a call (`hold`, `release`), so that tests with a manual clock are exact.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from typing import TYPE_CHECKING, ClassVar, Protocol
from weakref import WeakValueDictionary

from canopen_control.bus import error_frames
from canopen_control.bus.error_events import note_errors
from canopen_control.bus.port import (
    BusEvent,
    BusEventKind,
    BusEventLog,
    PortStats,
    Records,
    WakeDescriptor,
    whole_records,
)
from canopen_control.errors import BusClosed
from canopen_control.frame import RECORD_SIZE, CanFrame, frames_of, pack_records

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.bus.port import Port

    Predicate = Callable[[str, CanFrame], bool]
    """Function of a sender's label and a frame; returns whether a fault applies to the frame."""


QUEUE_LIMIT = 65536 * RECORD_SIZE  # bytes that wait for one reader
HISTORY_LIMIT = 65536  # number of recorded calls of send


class InProcessBus(Protocol):
    """Bus inside this process that can open ports."""

    def open(self, label: str) -> Port:
        """Open a port with this label."""


_PROVIDED: dict[str, InProcessBus] = {}


@contextlib.contextmanager
def provide(name: str, bus: InProcessBus) -> Iterator[None]:
    """Context in which ``memory:NAME`` opens ports of `bus`, for example of a simulated wire."""
    _PROVIDED[name] = bus
    try:
        yield
    finally:
        del _PROVIDED[name]


def bus_of_channel(name: str) -> InProcessBus:
    """Return the bus of ``memory:NAME``: the provided bus, else the `MemoryBus` of this name."""
    return _PROVIDED.get(name) or MemoryBus.get(name)


class MemoryBus:
    """Bus inside one process; frames go directly into the queues of the ports.

    `get` finds a bus by name; a bus exists while a reference to it or to one of its ports exists.
    """

    _registry: ClassVar[WeakValueDictionary[str, MemoryBus]] = WeakValueDictionary()
    _registry_lock: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self, name: str = "test") -> None:
        self.name = name
        self.ports: list[MemoryPort] = []
        self.lock = threading.RLock()
        self._log: deque[tuple[str, bytes]] = deque(maxlen=HISTORY_LIMIT)
        self._drop: Predicate | None = None
        self._duplicate: Predicate | None = None
        self._hold: Predicate | None = None
        self._held: list[tuple[str, CanFrame]] = []
        self._silent: set[str] = set()
        self._opened = 0
        self.dropped = 0

    @classmethod
    def get(cls, name: str) -> MemoryBus:
        """Return the bus with this name, which is the same for all callers in this process."""
        with cls._registry_lock:
            bus = cls._registry.get(name)
            if bus is None:
                cls._registry[name] = bus = cls(name)
            return bus

    @property
    def channel(self) -> str:
        return f"memory:{self.name}"

    @property
    def history(self) -> list[tuple[str, CanFrame]]:
        """Sender's label and frame of everything delivered, oldest first; only the newest calls of `send` are kept."""
        with self.lock:
            log = list(self._log)
        return [(label, frame) for label, records in log for frame in frames_of(records)]

    def clear_history(self) -> None:
        with self.lock:
            self._log.clear()

    def open(self, label: str = "") -> MemoryPort:
        """Open a port; an empty label becomes ``port-N``."""
        with self.lock:
            self._opened += 1
            port = MemoryPort(self, label or f"port-{self._opened}")
            self.ports.append(port)
            return port

    # -- faults

    def drop(self, predicate: Predicate | None) -> None:
        """Drop each frame selected by `predicate`, for all readers; None ends the fault.

        Lost frames are counted in `dropped`.
        """
        self._drop = predicate

    def duplicate(self, predicate: Predicate | None) -> None:
        """Deliver each frame selected by `predicate` twice, as after a lost acknowledge; None ends the fault."""
        self._duplicate = predicate

    def hold(self, predicate: Predicate | None) -> None:
        """Hold back each frame selected by `predicate` until `release`; None ends the fault, but releases nothing."""
        self._hold = predicate

    def release(self) -> int:
        """Deliver the held frames in order and return their number."""
        with self.lock:
            records, self._held = self._held, []
            for label, frame in records:
                self._deliver(label, pack_records([frame]))
            return len(records)

    def cut(self, label: str) -> None:
        """Cut the cable of the ports with this label: no frame passes in either direction, and no error is reported."""
        self._silent.add(label)

    def uncut(self, label: str) -> None:
        """Repair the cable of the ports with this label."""
        self._silent.discard(label)

    def bus_off(self, label: str) -> None:
        """Set the controllers with this label to bus-off; their ports receive an error frame."""
        self._silent.add(label)
        self.report(label, error_frames.bus_off_frame())

    def restart(self, label: str) -> None:
        """Restart the controllers with this label after bus-off."""
        self._silent.discard(label)
        self.report(label, error_frames.restarted_frame())

    def report(self, label: str, frame: CanFrame) -> None:
        """Deliver an error frame to the ports with this label."""
        with self.lock:
            for port in self.ports:
                if port.label == label:
                    port.put(pack_records([frame]))

    def inject(self, frame: CanFrame, label: str = "injected") -> None:
        """Deliver a frame as if sent by `label` to all other ports; drop, duplicate and hold do not apply."""
        with self.lock:
            self._deliver(label, pack_records([frame]))

    def close(self) -> None:
        """Close the bus; its ports then raise `BusClosed` in `send`, and in `receive` once no records wait."""
        with self.lock:
            for port in list(self.ports):
                port.lose("the bus was closed")

    # -- wire

    def transmit(self, sender: MemoryPort, records: bytes) -> None:
        """Deliver the records of a port (called by the port, under the lock)."""
        if self._silent and sender.label in self._silent:
            self._count(sender, len(records) // RECORD_SIZE)
            return
        if self._drop or self._duplicate or self._hold:
            records = self._tamper(sender.label, records)
        if records:
            self._deliver(sender.label, records, sender)

    def _count(self, sender: MemoryPort, frames: int) -> None:
        sender.stats.lost += frames
        self.dropped += frames

    def _tamper(self, label: str, records: bytes) -> bytes:
        out: list[CanFrame] = []
        for frame in frames_of(records):
            if self._drop is not None and self._drop(label, frame):
                self.dropped += 1
            elif self._hold is not None and self._hold(label, frame):
                self._held.append((label, frame))
            else:
                out += [frame, frame] if self._duplicate is not None and self._duplicate(label, frame) else [frame]
        return pack_records(out)

    def _deliver(self, label: str, records: bytes, sender: MemoryPort | None = None) -> None:
        self._log.append((label, records))
        silent = self._silent
        for port in self.ports:
            if port is not sender and (sender or port.label != label) and not (silent and port.label in silent):
                port.put(records)

    def leave(self, port: MemoryPort) -> None:
        """Remove a port (called by the port)."""
        with self.lock:
            if port in self.ports:
                self.ports.remove(port)


class MemoryPort:
    """Port of a `MemoryBus`; see `canopen_control.bus.port.Port`."""

    def __init__(self, bus: MemoryBus, label: str) -> None:
        self.bus = bus
        self.label = label
        self.stats = PortStats()
        self.wants_write = False
        self._queue = bytearray()
        self._lost = 0
        self._events = BusEventLog()
        self._wake: WakeDescriptor | None = None
        self._closed_reason = ""

    @property
    def channel(self) -> str:
        return self.bus.channel

    def fileno(self) -> int:
        """Return a descriptor, created on the first call, that is readable while records wait."""
        with self.bus.lock:
            if self._wake is None:
                self._wake = WakeDescriptor()
                if self._queue or self._closed_reason:
                    self._wake.set()
            return self._wake.fileno()

    def put(self, records: bytes) -> None:
        """Queue records for the reader of this port (called by the bus, under its lock).

        If the queue is full they are lost and counted.
        """
        if len(self._queue) + len(records) > QUEUE_LIMIT:
            self._lost += len(records) // RECORD_SIZE
            return
        if self._wake is not None and not self._queue:
            self._wake.set()
        self._queue += records

    def receive(self) -> bytes:
        with self.bus.lock:
            queue = self._queue
            if not queue:
                self._check_open()
                return b""
            records = bytes(queue)
            queue.clear()
            if self._wake is not None:
                self._wake.clear()
            if self._lost:
                records += self._take_overrun()
        self.stats.rx += len(records) // RECORD_SIZE
        if error_frames.has_error_frames(records):
            self._events.extend(note_errors(records, self.stats))
        return records

    def _take_overrun(self) -> bytes:
        lost, self._lost = self._lost, 0
        return pack_records([error_frames.overrun_frame(lost)])

    def send(self, records: Records) -> None:
        count = whole_records(records)
        with self.bus.lock:
            if self._closed_reason:
                self._check_open()
            self.stats.tx += count
            self.bus.transmit(self, bytes(records))

    def flush(self) -> None:
        """Do nothing, since all records are delivered at once."""

    def events(self) -> list[BusEvent]:
        return self._events.drain()

    def lose(self, reason: str) -> None:
        """Close this port because its bus was closed; `send`, and `receive` once no records wait, raise `BusClosed`."""
        if not self._closed_reason:
            self._closed_reason = reason
            self._events.add(BusEventKind.CLOSED, f"bus {self.channel}: {reason}")
            self.bus.leave(self)
            if self._wake is not None:
                self._wake.set()

    def _check_open(self) -> None:
        if self._closed_reason:
            raise BusClosed(self.channel, self._closed_reason)

    def close(self) -> None:
        self._closed_reason = self._closed_reason or "closed on this side"
        self.bus.leave(self)
        if self._wake is not None:
            self._wake.close()
