"""A CAN bus in virtual time, bit-true: arbitration, the time of each frame, error frames, lost and doubled frames.

A frame is at every other port when its last bit has passed. A disturbed one is sent again; the error counters of a
sender count up to error passive and bus-off (ISO 11898-1, 12.1.4), from which it comes back by itself after 100 ms, as
an interface with `restart-ms` does. Times in ns.
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

    from canopen_control.bus.wire_faults import DropRule
    from canopen_control.simulation.virtual_time import Actor, VirtualTime

    Heard = Callable[[int, str, bytes], object]  # time, label of the sender, record
    Listeners = tuple[tuple[Heard, ...], tuple["SimulatedPort", ...]]


RESTART_NS: Final = 100_000_000
_PASSIVE, _BUS_OFF, _AT_ERROR = 128, 256, 8
_MOST_IDENTIFIERS: Final = 2048
_ID_SIZE: Final = 4  # bytes of a record's can_id


class WireObserver(Protocol):
    """What follows the frames on a wire."""

    def wants(self, can_id: int) -> bool:
        """Whether it takes frames with this identifier."""

    def hear(self, now: int, label: str, record: bytes) -> None:
        """Take a frame that has passed, of the sender `label`; `now` in ns."""


class SimulatedWire:
    """One bus; `members` says which process a label is of, `heard` gets all that passed on the wire.

    `lost`, `doubled` and `disturbed` are rules of what happens to frames; `cut` are labels whose cable is.
    """

    def __init__(self, time: VirtualTime, name: str, bitrate: int) -> None:
        self.name = name
        self.channel = f"memory:{name}"
        self.members: dict[str, Actor] = {}
        self.heard: list[Heard] = []
        self.lost: list[DropRule] = []
        self.doubled: list[DropRule] = []
        self.disturbed: list[DropRule] = []
        self.cut: set[str] = set()
        self.frames = 0
        self._off: set[str] = set()
        self._errors: dict[str, int] = {}  # transmit error counters
        self._time, self._wire = time, PacedWire(bitrate)
        self._wire.disturbed = self._is_disturbed
        self._ports: dict[int, SimulatedPort] = {}
        self._observers: list[WireObserver] = []
        self._listeners: dict[bytes, Listeners] = {}  # by identifier, as records have it
        self._opened = 0
        self._planned = False  # whether it is on the clock when the frame on the wire ends
        self._on_passed = self._passed

    @property
    def bits(self) -> int:
        """How many bits have passed since the start."""
        return self._wire.bits

    @property
    def tampered(self) -> bool:
        """Whether something happens to frames or cables now."""
        return bool(self.lost or self.doubled or self.disturbed or self.cut or self._off)

    def open(self, label: str) -> SimulatedPort:
        """Join the bus as the process of this label."""
        self._opened += 1
        port = self._ports[self._opened] = SimulatedPort(self, self._opened, label, self.members[label])
        self.refilter()
        return port

    def observe(self, observer: WireObserver) -> None:
        """Let an observer get what passes on the wire with the identifiers that it wants."""
        self._observers.append(observer)
        self._listeners.clear()

    def refilter(self) -> None:
        """Take that a filter has changed."""
        self._listeners.clear()

    def leave(self, port: SimulatedPort) -> None:
        """Forget a port, and what it has not sent yet."""
        if self._ports.pop(port.number, None) is not None:
            self._wire.forget(port.number)
            self.refilter()

    def silences(self, label: str) -> bool:
        """Whether nothing comes from this label and nothing gets there."""
        return label in self.cut or label in self._off

    def send(self, port: SimulatedPort, records: bytes) -> None:
        """Queue what a port sends; what there is no room for, or no bus, is lost and counted."""
        queue = self._wire.queues.get(port.number)
        if (queue is not None and len(queue) > SEND_LIMIT) or ((self.cut or self._off) and self.silences(port.label)):
            port.stats.lost += len(records) // RECORD_SIZE
            return
        self._wire.put(port.number, records, self._time.now_ns)
        if not self._planned:
            self._plan()

    def inject(self, frame: CanFrame, label: str = "stranger") -> None:
        """Put a frame of a node that nobody knows onto the wire, at once."""
        self._carry(label, pack_records([frame]), None)

    def bus_off(self, label: str, duration_ns: int = RESTART_NS) -> None:
        """Send the controller of a label off the bus, which it is told, and back onto it after a while."""
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
        """Be there when the frame on the wire ends."""
        due = self._wire.due_ns
        self._planned = due is not None
        if due is not None:
            self._time.at(due, self._on_passed)

    def _passed(self) -> None:
        """Give a frame that has passed to those who listen."""
        passed, self._planned = self._wire.finish() if self.disturbed else self._wire.end(), False
        if passed is not None:
            _, number, _, record = passed
            port = self._ports.get(number)
            if port is None or ((self.cut or self._off) and self.silences(port.label)):
                pass
            elif self.lost or self.doubled or self._errors:
                self._judge(port, record)
            else:
                self._carry(port.label, record, port)
        if not self._planned and (due := self._wire.due_ns) is not None:  # `_plan`, for each frame
            self._planned = True
            self._time.at(due, self._on_passed)

    def _judge(self, port: SimulatedPort, record: bytes) -> None:
        """Lose or double a frame where a rule says so, else carry it."""
        label = port.label
        can_id: int = RECORD.unpack(record)[0]
        if self._errors.get(label):
            self._errors[label] -= 1
        if _taken(self.lost, label, can_id):
            return
        self._carry(label, record, port)
        if _taken(self.doubled, label, can_id):
            self._carry(label, record, port)

    def _is_disturbed(self, number: int, record: bytes) -> bool:
        """Whether a rule disturbs a frame; counts the error of its sender."""
        port = self._ports.get(number)
        if port is None or self.silences(port.label):
            return False
        if not _taken(self.disturbed, port.label, RECORD.unpack(record)[0]):
            return False
        count = self._errors[port.label] = self._errors.get(port.label, 0) + _AT_ERROR
        if count >= _BUS_OFF:
            self.bus_off(port.label)
        elif _PASSIVE <= count < _PASSIVE + _AT_ERROR:
            self._report(port.label, error_frames.passive_frame())
        return True

    def _carry(self, label: str, record: bytes, sender: SimulatedPort | None) -> None:
        self.frames += 1
        now = self._time.now_ns
        for hear in self.heard:
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
        if len(self._listeners) >= _MOST_IDENTIFIERS:
            self._listeners.clear()
        can_id: int = RECORD.unpack(record)[0]
        observers = tuple(observer.hear for observer in self._observers if observer.wants(can_id))
        ports = tuple(port for port in self._ports.values() if port.wanted is None or can_id in port.wanted)
        found = self._listeners[record[:_ID_SIZE]] = observers, ports
        return found


def _taken(rules: list[DropRule], label: str, can_id: int) -> bool:
    """Whether a rule takes a frame; all of them count it."""
    return sum(rule.takes(label, can_id) for rule in rules) > 0


class SimulatedPort:
    """One end of a `SimulatedWire`, of one process; see `canopen_control.bus.port.Port`."""

    def __init__(self, wire: SimulatedWire, number: int, label: str, actor: Actor) -> None:
        self.number, self.label = number, label
        self.stats = PortStats()
        self.wants_write = False
        self.wanted: frozenset[int] | None = None
        self._wire, self._actor = wire, actor
        self._fileno = actor.selector.allocate()
        self._queue: list[bytes] = []
        self._events = BusEventLog()
        self._closed = self._errors_wait = False

    @property
    def channel(self) -> str:
        """The channel's name."""
        return self._wire.channel

    def events(self) -> list[BusEvent]:
        """Return what happened since the last call."""
        return self._events.drain()

    def fileno(self) -> int:
        """Return the number by which its reactor's selector knows it."""
        return self._fileno

    def set_filter(self, can_ids: Iterable[int]) -> None:
        """Give these identifiers only."""
        self.wanted = frozenset(can_ids)
        self._wire.refilter()

    def put(self, records: bytes) -> None:
        """Queue records for this reader (called by the wire)."""
        if not self._queue and self._actor.selector.set_ready(self._fileno):
            self._actor.arrived()
        self._queue.append(records)

    def report(self, frame: CanFrame) -> None:
        """Queue an error frame, which its own controller makes."""
        self._errors_wait = True
        self.put(pack_records([frame]))

    def receive(self) -> bytes:
        """Return the whole records that wait, or ``b""``; raise `BusClosed` when the port was closed."""
        if self._closed:
            raise self._no_bus()
        queue = self._queue
        if not queue:
            return b""
        records = queue[0] if len(queue) == 1 else b"".join(queue)
        queue.clear()
        self._actor.selector.clear_ready(self._fileno)
        self.stats.rx += len(records) // RECORD_SIZE
        if self._errors_wait:
            self._errors_wait = False
            self._events.extend(note_errors(records, self.stats))
        return records

    def send(self, records: Records) -> None:
        """Send whole records, in order; raise `BusClosed` when the port was closed."""
        if self._closed:
            raise self._no_bus()
        self.stats.tx += whole_records(records)
        self._wire.send(self, records if isinstance(records, bytes) else bytes(records))

    def flush(self) -> None:
        """Do nothing: the controller's queue takes everything."""

    def _no_bus(self) -> BusClosed:
        return BusClosed(self.channel, "closed on this side")

    def close(self) -> None:
        """Leave the bus; a second call does nothing."""
        self._closed = True
        self._actor.selector.clear_ready(self._fileno)
        self._wire.leave(self)
