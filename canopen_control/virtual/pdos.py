"""The process data of a node: its RPDOs and TPDOs, made from the records 0x1400 to 0x1BFF.

The law of this file: the records are the truth; a write to one that the rules accept rebuilds its PDO at once. An RPDO
is applied whole before anybody looks at its values, and of an axis the controlword last. At SYNC the TPDOs are
sampled before the held RPDOs are applied, so that the reaction to a set-point shows at the next SYNC. A value that a
limit or a guard refuses leaves its object as it was and is told.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.pdo import (
    ACYCLIC_SYNCHRONOUS,
    DUMMY_TYPES,
    INVALID_BIT,
    NO_RTR_BIT,
    MappedObject,
    PdoCodec,
    PdoParameters,
    dummy,
    is_event_driven,
    parse_mapping_entry,
)
from canopen_control.cia301.remap import MappingTarget, PdoRules
from canopen_control.cia301.rpdo import EMCY_OF, RpdoConsumer, RpdoEventKind
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cia301.tpdo import TpdoProducer
from canopen_control.cia402 import objects as o
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import EXTENDED_FLAG, REMOTE_FLAG
from canopen_control.virtual.store import refuse

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.frame import CanFrame
    from canopen_control.od.model import Entry, Value
    from canopen_control.virtual.node import VirtualNode

__all__ = ["ProcessData"]

_RPDO, _TPDO = 0x1400, 0x1800
_MAPPING = 0x200
_NO_EVENTS = frozenset((o.STATUSWORD, o.MODES_OF_OPERATION_DISPLAY, o.ERROR_CODE))  # change without motion


class _Rpdo:
    """One RPDO: what its bytes are, and whom they concern."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.codec = PdoCodec(())
        self.entries: tuple[Entry | None, ...] = ()  # None: a gap
        self.consumer = RpdoConsumer(PdoParameters(0, enabled=False), 0)


class _Tpdo:
    """One TPDO: where its values come from, and the bytes last sampled."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.codec = PdoCodec(())
        self.sources: tuple[Callable[[], Value], ...] = ()
        self.moving = False
        self.last = b""
        self.producer = TpdoProducer(PdoParameters(0, enabled=False), self.sample)

    def sample(self) -> bytes:
        """Return the packed present values."""
        try:
            self.last = self.codec.pack([source() for source in self.sources])
        except LocalProtocolError:  # a file that maps an object narrower than its type
            self.last = bytes(self.codec.length)
        return self.last


class ProcessData:
    """All PDOs of `node`. `refused` counts values that an RPDO brought and the node did not take."""

    def __init__(self, node: VirtualNode) -> None:
        self._node, self._store = node, node.store
        self.refused = 0
        indices = {entry.index for entry in node.store.od}
        self.rpdos = {i - _RPDO: _Rpdo(i - _RPDO) for i in sorted(indices) if _RPDO <= i < _RPDO + 512}
        self.tpdos = {i - _TPDO: _Tpdo(i - _TPDO) for i in sorted(indices) if _TPDO <= i < _TPDO + 512}
        self.has_event_pdos = False
        self._event_tpdos: list[_Tpdo] = []
        for base, numbers in ((_RPDO, self.rpdos), (_TPDO, self.tpdos)):
            self._guard(base, list(numbers))

    # -- the rules

    def _guard(self, base: int, numbers: list[int]) -> None:
        for number in numbers:
            communication, mapping = base + number, base + _MAPPING + number
            rules = self._rules(base, communication, mapping)
            self._store.guard([communication], self._communication_guard(rules))
            self._store.guard([mapping], self._mapping_guard(rules, communication))
            self._store.on_write([communication, mapping], partial(self._rebuilt, base, number))

    def _rules(self, base: int, communication: int, mapping: int) -> PdoRules:
        od = self._store.od
        default = self._store.number(communication, 1)
        return PdoRules(
            is_tpdo=base == _TPDO,
            lookup=self._lookup,
            max_entries=max([sub for sub in od.subindices(mapping) if sub], default=0),
            rtr_supported=not default & NO_RTR_BIT,
            dummy_usage=od.dummy_usage,
            partial=od.device.granularity not in (0, 8),
        )

    def _lookup(self, index: int, subindex: int) -> MappingTarget | AbortCode:
        entry = self._store.od.get(index, subindex)
        if entry is None:
            known = self._store.od.subindices(index)
            return AbortCode.NO_SUBINDEX if known else AbortCode.NO_OBJECT
        return MappingTarget(entry.data_type.bits or 0, entry.rpdo_mappable, entry.tpdo_mappable)

    def _communication_guard(self, rules: PdoRules) -> Callable[[Entry, Value], Value]:
        def judge(entry: Entry, value: Value) -> Value:
            present = self._parameters(entry.index)
            refuse(rules.check_communication(entry.subindex, int(value), present))
            return value

        return judge

    def _mapping_guard(self, rules: PdoRules, communication: int) -> Callable[[Entry, Value], Value]:
        def judge(entry: Entry, value: Value) -> Value:
            present, count = self._parameters(communication), self._store.number(entry.index)
            if entry.subindex:
                refuse(rules.check_mapping_entry(entry.subindex, int(value), present, count))
            else:
                entries = [self._store.number(entry.index, sub) for sub in range(1, rules.max_entries + 1)]
                refuse(rules.check_mapping_count(int(value), entries, present))
            return value

        return judge

    # -- from the records to the PDOs

    def _parameters(self, communication: int) -> PdoParameters:
        number = self._store.number
        return PdoParameters.from_value(
            number(communication, 1, INVALID_BIT),
            transmission_type=number(communication, 2, 255),
            inhibit_time_100us=number(communication, 3),
            event_timer_ms=number(communication, 5),
            sync_start=number(communication, 6),
        )

    def _mapping(self, record: int) -> list[tuple[MappedObject, Entry | None]]:
        """Return the mapped objects; a record that names what does not exist maps nothing."""
        objects: list[tuple[MappedObject, Entry | None]] = []
        for sub in range(1, min(64, self._store.number(record)) + 1):
            index, subindex, bits = parse_mapping_entry(self._store.number(record, sub))
            entry = self._store.od.get(index, subindex)
            if index in DUMMY_TYPES:
                objects.append((dummy(DUMMY_TYPES[index]), None))
            elif entry is not None:
                objects.append((MappedObject(index, subindex, bits, entry.data_type), entry))
            else:
                return []
        return objects

    def _codec(self, record: int) -> tuple[PdoCodec, tuple[Entry | None, ...]]:
        objects = self._mapping(record)
        try:
            return PdoCodec([mapped for mapped, _ in objects]), tuple(entry for _, entry in objects)
        except LocalProtocolError:  # a default mapping that cannot be
            return PdoCodec(()), ()

    def configure(self, now: int) -> None:
        """Make all PDOs from their records."""
        for number in self.rpdos:
            self._make_rpdo(number)
        for number in self.tpdos:
            self._make_tpdo(number, now)
        self._survey()

    def _rebuilt(self, base: int, number: int, _entry: Entry, _value: Value) -> None:
        if base == _RPDO:
            self._make_rpdo(number)
        else:
            self._make_tpdo(number, self._node.now)
        self._survey()
        self._node.reroute()

    def _make_rpdo(self, number: int) -> None:
        rpdo = self.rpdos[number]
        rpdo.codec, rpdo.entries = self._codec(_RPDO + _MAPPING + number)
        rpdo.consumer.window_ns = self._store.number(0x1007) * 1000
        rpdo.consumer.configure(self._parameters(_RPDO + number), rpdo.codec.length)

    def _make_tpdo(self, number: int, now: int) -> None:
        tpdo = self.tpdos[number]
        tpdo.codec, entries = self._codec(_TPDO + _MAPPING + number)
        tpdo.sources = tuple(self._source(entry) for entry in entries if entry is not None)
        tpdo.moving = any(entry is not None and o.axis_of(entry.index)[0] not in _NO_EVENTS for entry in entries)
        tpdo.producer.configure(self._parameters(_TPDO + number), now)

    def _source(self, entry: Entry) -> Callable[[], Value]:
        source = self._store.source_of(entry.index, entry.subindex)
        if source is not None:
            return source
        values, address = self._store.values, entry.address
        return lambda: values[address]

    def _survey(self) -> None:
        enabled = [tpdo for tpdo in self.tpdos.values() if tpdo.producer.parameters.enabled]
        kinds = [(tpdo, tpdo.producer.parameters.transmission_type) for tpdo in enabled]
        self._event_tpdos = [tpdo for tpdo, kind in kinds if is_event_driven(kind) or kind == ACYCLIC_SYNCHRONOUS]
        self.has_event_pdos = any(tpdo.moving for tpdo in self._event_tpdos)

    # -- in operation

    def start(self, now: int) -> None:
        """Begin: the node became OPERATIONAL."""
        for rpdo in self.rpdos.values():
            rpdo.consumer.start()
        for tpdo in self.tpdos.values():
            tpdo.producer.start(now)

    def stop(self) -> None:
        """End: the node left OPERATIONAL."""
        for rpdo in self.rpdos.values():
            rpdo.consumer.stop()
        for tpdo in self.tpdos.values():
            tpdo.producer.stop()

    def routes(self) -> list[tuple[int, Callable[[CanFrame, int], None]]]:
        """Return the identifiers, with linux/can.h's flags, that the valid PDOs listen to."""
        receivers = [(rpdo.consumer.parameters, self._receiver(rpdo)) for rpdo in self.rpdos.values()]
        found = [(_can_id(parameters), receive) for parameters, receive in receivers if parameters.enabled]
        for producer in (tpdo.producer for tpdo in self.tpdos.values()):
            if producer.parameters.enabled:
                found += [(_can_id(producer.parameters) | REMOTE_FLAG, producer.receive)]
        return found

    def _receiver(self, rpdo: _Rpdo) -> Callable[[CanFrame, int], None]:
        def receive(frame: CanFrame, now: int) -> None:
            rpdo.consumer.receive(frame, now)
            self._serve(rpdo, now)

        return receive

    def _serve(self, rpdo: _Rpdo, now: int) -> None:
        for event in rpdo.consumer.events():
            if event.kind is RpdoEventKind.APPLY:
                self._apply(rpdo, event.data, now)
            elif (code := EMCY_OF.get(event.kind)) is not None:
                self._node.rpdo_failed(code)

    def _apply(self, rpdo: _Rpdo, data: bytes, now: int) -> None:
        """Take all values, then let each axis and each watcher act on them."""
        self._node.advance_drives(now)
        taken: list[tuple[Entry, Value]] = []
        for entry, value in zip(rpdo.entries, rpdo.codec.unpack(data), strict=True):
            if entry is None:
                continue
            try:
                taken.append((entry, self._store.place(entry, value)))
            except SdoServerAbort:
                self.refused += 1
                self._node.rpdo_value_refused()
        self._node.values_taken(taken, now)

    def sync(self, counter: int | None, now: int) -> None:
        """Take a SYNC."""
        for tpdo in self.tpdos.values():
            tpdo.producer.sync(now, counter)
        for rpdo in self.rpdos.values():
            rpdo.consumer.sync(now)
            self._serve(rpdo, now)

    def touched(self, now: int) -> None:
        """Send the event-driven TPDOs whose values changed."""
        for tpdo in self._event_tpdos:
            before = tpdo.last
            if tpdo.producer.running and tpdo.sample() != before:
                tpdo.producer.changed(now)

    def tick(self, now: int) -> None:
        """Serve event timers, inhibit times and deadlines."""
        for tpdo in self.tpdos.values():
            tpdo.producer.tick(now)
        for rpdo in self.rpdos.values():
            rpdo.consumer.tick(now)
            self._serve(rpdo, now)

    def next_deadline(self) -> int | None:
        """Return when `tick` has something to do."""
        deadlines = [tpdo.producer.next_deadline() for tpdo in self._event_tpdos]
        deadlines += [rpdo.consumer.next_deadline() for rpdo in self.rpdos.values()]
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def frames(self) -> list[CanFrame]:
        """Drain the TPDOs to send."""
        return [frame for tpdo in self.tpdos.values() for frame in tpdo.producer.frames()]


def _can_id(parameters: PdoParameters) -> int:
    return parameters.cob_id | (EXTENDED_FLAG if parameters.extended else 0)
