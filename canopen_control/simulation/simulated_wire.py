"""CAN bus in virtual time, accurate to the bit: arbitration, frame durations, error, lost and doubled frames.

A frame reaches all other ports when its last bit has been sent. A disturbed frame is sent again; the error counters of
a sender lead to error passive and bus-off (ISO 11898-1, 12.1.4), from which it restarts after 100 ms, as an interface
with `restart-ms` does. Times are in ns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.bus import error_frames
from canopen_control.bus.arbitration import PacedWire
from canopen_control.bus.error_events import note_errors
from canopen_control.bus.port import SEND_LIMIT, BusEvent, BusEventLog, PortStats, Records, whole_records
from canopen_control.errors import BusClosed
from canopen_control.frame import RECORD, RECORD_SIZE, CanFrame, pack_records

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.bus.frame_router import DropRule
    from canopen_control.simulation.virtual_time import Actor, VirtualTime

    Listener = Callable[[int, str, bytes], object]  # time, label of the sender, record
    Listeners = tuple[tuple[Listener, ...], tuple["SimulatedPort", ...]]


RESTART_NS: Final = 100_000_000
_PASSIVE, _BUS_OFF, _AT_ERROR = 128, 256, 8
_MAX_IDENTIFIERS: Final = 2048
_ID_SIZE: Final = 4  # bytes of a record's can_id


class WireObserver(Protocol):
    """Interface of an observer of the frames on a simulated bus."""

    def wants(self, can_id: int) -> bool:
        """Whether `hear` should be called for frames with this identifier."""

    def hear(self, now: int, label: str, record: bytes) -> None:
        """Handle a frame of the sender `label`, received at `now` in ns."""


class SimulatedWire:
    """Simulated CAN bus; `members` are processes by label, `listeners` are called for every frame.

    `lost`, `doubled` and `disturbed` are rules that select frames; `cut` contains the labels whose cable is cut.
    """

    def __init__(self, time: VirtualTime, name: str, bitrate: int) -> None:
        self.name = name
        self.channel = f"memory:{name}"
        self.members: dict[str, Actor] = {}
        self.listeners: list[Listener] = []
        self.lost: list[DropRule] = []
        self.doubled: list[DropRule] = []
        self.disturbed: list[DropRule] = []
        self.cut: set[str] = set()
        self.frames = 0
        self._off: set[str] = set()
        self._errors: dict[str, int] = {}  # transmit error counters
        self._time, self._wire = time, PacedWire(bitrate)
        self._ports: dict[int, SimulatedPort] = {}
        self._observers: list[WireObserver] = []
        self._listeners: dict[bytes, Listeners] = {}  # by identifier, in the form of a record
        self._opened = 0
        self._planned = False  # whether the end of the frame on the wire is scheduled
        self._on_passed = self._passed

    @property
    def bits(self) -> int:
        return self._wire.bits

    @property
    def has_wire_faults(self) -> bool:
        """Whether a frame rule, a cut cable or a bus-off state is active."""
        return bool(self.lost or self.doubled or self.disturbed or self.cut or self._off)

    def open(self, label: str) -> SimulatedPort:
        """Open the bus for the process of the member `label`; return its port."""
        self._opened += 1
        port = self._ports[self._opened] = SimulatedPort(self, self._opened, label, self.members[label])
        self.refilter()
        return port

    def observe(self, observer: WireObserver) -> None:
        """Add an observer, which receives the frames whose identifiers it selects."""
        self._observers.append(observer)
        self._listeners.clear()

    def refilter(self) -> None:
        """Clear the cache of listeners after a filter change."""
        self._listeners.clear()

    def leave(self, port: SimulatedPort) -> None:
        """Remove a port and its unsent frames."""
        if self._ports.pop(port.number, None) is not None:
            self._wire.forget(port.number)
            self.refilter()

    def silences(self, label: str) -> bool:
        """Whether the member `label` is disconnected by a cut cable or bus-off."""
        return label in self.cut or label in self._off

    def send(self, port: SimulatedPort, records: bytes) -> None:
        """Queue frames of a port; the frames are lost and counted if the queue is full or the member disconnected."""
        queue = self._wire.queues.get(port.number)
        if (queue is not None and len(queue) > SEND_LIMIT) or ((self.cut or self._off) and self.silences(port.label)):
            port.stats.lost += len(records) // RECORD_SIZE
            return
        self._wire.put(port.number, records, self._time.now_ns)
        if not self._planned:
            self._plan()

    def inject(self, frame: CanFrame, label: str = "stranger") -> None:
        """Send a foreign frame at once, without arbitration."""
        self._carry(label, pack_records([frame]), None)

    def bus_off(self, label: str, duration_ns: int = RESTART_NS) -> None:
        """Put the CAN controller of the member `label` into bus-off for `duration_ns`."""
        if label not in self._off:
            self._off.add(label)
            self._report(label, error_frames.bus_off_frame())
            self._time.later(duration_ns, lambda: self._restart(label))

    def _restart(self, label: str) -> None:
        self._off.discard(label)
        self._errors[label] = 0
        self._report(label, error_frames.restarted_frame())

    def _report(self, label: str, frame: CanFrame) -> None:
        for port in self._ports.values():
            if port.label == label:
                port.report(frame)

    def _plan(self) -> None:
        """Schedule the end of the current frame."""
        arrival = self._wire.due_ns
        self._planned = arrival is not None
        if arrival is not None:
            self._time.at(arrival, self._on_passed)

    def _passed(self) -> None:
        """Deliver all frames that end before the next other event; schedule the end of the frame after them."""
        wire, jump = self._wire, self._time.jump
        self._planned = False
        while True:
            passed = None if self.disturbed and self._repeats() else wire.end()
            if passed is not None:
                _, number, _, record = passed
                port = self._ports.get(number)
                if port is None or ((self.cut or self._off) and self.silences(port.label)):
                    pass
                elif self.lost or self.doubled or self._errors:
                    self._judge(port, record)
                else:
                    self._carry(port.label, record, port)
            arrival = wire.due_ns
            if self._planned or arrival is None:
                return
            if not jump(arrival):
                self._planned = True
                self._time.at(arrival, self._on_passed)
                return

    def _judge(self, port: SimulatedPort, record: bytes) -> None:
        """Lose, double or deliver a frame according to the rules."""
        label = port.label
        can_id: int = RECORD.unpack(record)[0]
        if self._errors.get(label):
            self._errors[label] -= 1
        if _dropped(self.lost, label, can_id):
            return
        self._carry(label, record, port)
        if _dropped(self.doubled, label, can_id):
            self._carry(label, record, port)

    def _repeats(self) -> bool:
        """Whether a rule disturbs the frame on the wire; if so, repeat it and raise the sender's error counter."""
        if self._wire.on_wire is None:
            return False
        _, number, _, record = self._wire.on_wire
        port = self._ports.get(number)
        if port is None or self.silences(port.label):
            return False
        if not _dropped(self.disturbed, port.label, RECORD.unpack(record)[0]):
            return False
        count = self._errors[port.label] = self._errors.get(port.label, 0) + _AT_ERROR
        if count >= _BUS_OFF:
            self.bus_off(port.label)
        elif _PASSIVE <= count < _PASSIVE + _AT_ERROR:
            self._report(port.label, error_frames.passive_frame())
        self._wire.repeat()
        return True

    def _carry(self, label: str, record: bytes, sender: SimulatedPort | None) -> None:
        self.frames += 1
        now = self._time.now_ns
        for hear in self.listeners:
            hear(now, label, record)
        listeners = self._listeners.get(record[:_ID_SIZE])
        if listeners is None:
            listeners = self._find_listeners(record)
        observers, ports = listeners
        for observe in observers:
            observe(now, label, record)
        broken = self.cut or self._off
        for port in ports:
            if port is not sender and not (broken and self.silences(port.label)):
                port.put(record)

    def _find_listeners(self, record: bytes) -> Listeners:
        if len(self._listeners) >= _MAX_IDENTIFIERS:
            self._listeners.clear()
        can_id: int = RECORD.unpack(record)[0]
        observers = tuple(observer.hear for observer in self._observers if observer.wants(can_id))
        ports = tuple(port for port in self._ports.values() if port.identifiers is None or can_id in port.identifiers)
        listeners = self._listeners[record[:_ID_SIZE]] = observers, ports
        return listeners


def _dropped(rules: list[DropRule], label: str, can_id: int) -> bool:
    """Whether a rule selects a frame; all rules count the frame."""
    return sum(rule.takes(label, can_id) for rule in rules) > 0


class SimulatedPort:
    """Port of a `SimulatedWire` for one process; implements `canopen_control.bus.port.Port`."""

    def __init__(self, wire: SimulatedWire, number: int, label: str, actor: Actor) -> None:
        self.number, self.label = number, label
        self.stats = PortStats()
        self.wants_write = False
        self.identifiers: frozenset[int] | None = None
        self._wire, self._actor = wire, actor
        self._fileno = actor.selector.allocate()
        self._queue: list[bytes] = []
        self._events = BusEventLog()
        self._closed = self._errors_wait = False

    @property
    def channel(self) -> str:
        return self._wire.channel

    def events(self) -> list[BusEvent]:
        return self._events.drain()

    def fileno(self) -> int:
        return self._fileno

    def set_filter(self, can_ids: Iterable[int]) -> None:
        self.identifiers = frozenset(can_ids)
        self._wire.refilter()

    def put(self, records: bytes) -> None:
        """Queue received records for the process and wake it up."""
        if not self._queue and self._actor.selector.set_ready(self._fileno):
            self._actor.arrived()
        self._queue.append(records)

    def report(self, frame: CanFrame) -> None:
        """Queue an error frame of this port's CAN controller."""
        self._errors_wait = True
        self.put(pack_records([frame]))

    def receive(self) -> bytes:
        if self._closed:
            raise self._no_bus()
        queue = self._queue
        if not queue:
            return b""
        records = queue[0] if len(queue) == 1 else b"".join(queue)
        self.stats.rx += len(queue)  # one record each
        queue.clear()
        self._actor.selector.clear_ready(self._fileno)
        if self._errors_wait:
            self._errors_wait = False
            self._events.extend(note_errors(records, self.stats))
        return records

    def send(self, records: Records) -> None:
        if self._closed:
            raise self._no_bus()
        self.stats.tx += whole_records(records)
        self._wire.send(self, records if isinstance(records, bytes) else bytes(records))

    def flush(self) -> None:
        pass  # the wire accepts all records at once

    def _no_bus(self) -> BusClosed:
        return BusClosed(self.channel, "closed on this side")

    def close(self) -> None:
        self._closed = True
        self._actor.selector.clear_ready(self._fileno)
        self._wire.leave(self)
