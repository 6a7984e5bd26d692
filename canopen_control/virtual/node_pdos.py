"""Process data of a node: RPDOs and TPDOs, created from the records 0x1400 to 0x1BFF.

The records are authoritative: an accepted write to a record rebuilds its PDO at once. All values of an RPDO are written
before any of them is used, and the controlword of an axis is used last. At SYNC the TPDOs are sampled before the
waiting RPDOs are applied, so that the reaction to a set-point shows at the next SYNC. A value that a limit or a guard
refuses leaves its object unchanged and is reported. An invalid RPDO is an error of the node until that RPDO arrives
correctly.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, Protocol

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.emcy import ErrorRegister
from canopen_control.cia301.pdo import (
    ACYCLIC_SYNCHRONOUS,
    DUMMY_TYPES,
    EMCY_OF,
    INVALID_BIT,
    LAST_CYCLIC,
    MappedObject,
    PdoCodec,
    PdoParameters,
    RpdoConsumer,
    RpdoEventKind,
    TpdoProducer,
    dummy,
    is_event_driven,
    parse_mapping_entry,
)
from canopen_control.cia301.remap import MappingTarget, PdoRules
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cia402 import objects as o
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import EXTENDED_FLAG, REMOTE_FLAG
from canopen_control.od.indices import COB_ID_EMCY, COB_ID_SYNC, RPDO, TPDO
from canopen_control.virtual.injection_point import InjectionPoint
from canopen_control.virtual.node_outbox import PdoLeftOff
from canopen_control.virtual.object_store import refuse

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from canopen_control.cia402.motors import MotorMap
    from canopen_control.frame import CanFrame
    from canopen_control.od.model import Address, Entry, Value
    from canopen_control.virtual.device_model import DeviceFunction, DeviceModel
    from canopen_control.virtual.node_outbox import NodeClock, NodeOutbox
    from canopen_control.virtual.object_store import Guard, Source, VirtualStore

    Receive = Callable[[CanFrame, int], None]


# One PDO of a node as mapped by its records: the targets of an RPDO's values, and the sources of a TPDO's values.


class AxisPorts(Protocol):
    """Axis as seen by the PDOs."""

    def advance(self, now: int) -> None:
        """Advance the axis to `now`."""

    def refresh(self, now: int, *, controlword: bool = False, set_point: bool = False) -> None:
        """Apply written objects; `controlword` and `set_point` are True if that object is among them."""

    @property
    def set_point(self) -> int:
        """Index of the object whose values in RPDOs are set-points of the active mode; 0 if none."""

    def set_point_received(self, now: int, *, overwrites: bool) -> None:
        """Count an RPDO with a set-point; `overwrites` is True if another RPDO was waiting for SYNC."""

    def set_point_missed(self) -> None:
        """Count a SYNC before which no set-point arrived."""


class AxisWrite(NamedTuple):
    """Axis to which an RPDO writes; `objects` are the written indices, converted to axis 0."""

    axis: AxisPorts
    controlword: bool
    objects: frozenset[int]


class MappedRpdo:
    """RPDO with its mapped entries and the axes to which it writes."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.codec = PdoCodec(())
        self.entries: tuple[Entry | None, ...] = ()  # None: a gap
        self.shared: tuple[int, ...] = ()  # positions of the values that the last entries, on further axes, copy
        self.consumer = RpdoConsumer(PdoParameters(0, enabled=False), 0)
        self.wrong: set[RpdoEventKind] = set()  # errors of the last RPDO
        self.set_points: tuple[tuple[int, int], ...] = ()  # axis, and object of axis 0
        self.cyclic = False  # expected at every SYNC
        self.axis_writes: tuple[AxisWrite, ...] = ()  # the axes, if all objects belong to axes
        self.by_values = False  # whether the values alone decide what is accepted
        self.applied = b""  # last data accepted completely, and the version of the values since then
        self.version = -1


class MappedTpdo:
    """TPDO with the sources of its values and the last sampled data."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.codec = PdoCodec(())
        self.sources: tuple[Source, ...] = ()
        self.mapped: tuple[Address, ...] = ()
        self.moving = False
        self.last = b""
        self.producer = TpdoProducer(PdoParameters(0, enabled=False), self.sample)

    def sample(self) -> bytes:
        """Sample the mapped objects and return the PDO data."""
        try:
            self.last = self.codec.pack([source() for source in self.sources])
        except LocalProtocolError:  # a file that maps an object narrower than its type
            self.last = bytes(self.codec.length)
        return self.last

    def changed_since(self, before: bytes) -> list[Address]:
        """Return the addresses of the mapped objects that differ from the sample `before`."""
        if len(before) != len(self.last) or len(self.mapped) != len(self.codec.objects):
            return list(self.mapped)
        pairs = zip(self.codec.unpack(before), self.codec.unpack(self.last), strict=True)
        return [address for address, (old, new) in zip(self.mapped, pairs, strict=True) if old != new]


def axis_writes_of(entries: Iterable[Entry | None], axes: Mapping[int, AxisPorts]) -> tuple[AxisWrite, ...]:
    """Return the axes to which an RPDO writes, in order; empty if an object belongs to no axis."""
    bases: dict[int, set[int]] = {}
    for entry in entries:
        if entry is None:  # a gap
            continue
        base, axis = o.axis_of(entry.index)
        if axis not in axes or base < 0x6000:
            return ()
        bases.setdefault(axis, set()).add(base)
    return tuple(AxisWrite(axes[axis], o.CONTROLWORD in base, frozenset(base)) for axis, base in bases.items())


# PDO records of a node, 0x1400 to 0x1BFF: rules for writing, and interpretation.
#
# A forbidden write is aborted (CiA 301, 7.5.2.35 to 7.5.2.38); a record with a missing object or an
# impossible mapping maps nothing. A CAN identifier has one user in the node: SYNC and EMCY come first, then the RPDOs
# and the TPDOs by their number; a record whose identifier is in use is disabled.


def mapping_of(communication: int) -> int:
    """Return the index of the mapping record of a communication record."""
    return communication + 0x200


class PdoRecords:
    """PDO communication and mapping records in `store`, and the checks of write accesses.

    Without `rtr_supported` the COB-IDs of TPDOs must keep bit 30. With `remaps_valid` a PDO may be remapped while it is
    valid.
    """

    def __init__(self, store: VirtualStore, motors: MotorMap | None = None, *, rtr_supported: bool) -> None:
        self._store, self._rtr_supported = store, rtr_supported
        self._motors, self._od = motors, store.od if motors is None else motors.device
        self.remaps_valid = False
        self._communication = [base + number for base in (RPDO, TPDO) for number in self.numbers(base)]

    def numbers(self, base: int) -> list[int]:
        """Return the numbers, from 0, of the existing RPDOs (`base` 0x1400) or TPDOs (0x1800)."""
        return sorted({entry.index - base for entry in self._store.od if base <= entry.index < base + 512})

    def guard(self, base: int, communication: int) -> None:
        """Check all later writes to a communication record and to its mapping record."""
        mapping = mapping_of(communication)
        rules = self._rules(base, mapping)
        self._store.guard([communication], self._communication_guard(rules))
        self._store.guard([mapping], self._mapping_guard(rules, communication))

    def _rules(self, base: int, mapping: int) -> PdoRules:
        od, communication = self._store.od, mapping - 0x200
        return PdoRules(
            is_tpdo=base == TPDO,
            lookup=self._lookup,
            max_entries=max([sub for sub in od.subindices(mapping) if sub], default=0),
            rtr_supported=self._rtr_supported,
            dummy_usage=od.dummy_usage,
            partial=od.device.granularity not in (0, 8),
            in_use=lambda cob_id: self._users().get(cob_id, communication) != communication,
        )

    def _lookup(self, index: int, subindex: int) -> MappingTarget | AbortCode:
        entry = self._od.get(index, subindex)
        if entry is None:
            subindices = self._od.subindices(index)
            return AbortCode.NO_SUBINDEX if subindices else AbortCode.NO_OBJECT
        return MappingTarget(entry.data_type.bits or 0, entry.rpdo_mappable, entry.tpdo_mappable)

    def _communication_guard(self, rules: PdoRules) -> Guard:
        def check(entry: Entry, value: Value) -> Value:
            present = self.parameters(entry.index)
            refuse(rules.check_communication(entry.subindex, int(value), present))
            return value

        return check

    def _mapping_guard(self, rules: PdoRules, communication: int) -> Guard:
        cob_id = self._store.od.get(communication, 1)
        fixed = cob_id is not None and not cob_id.writable  # the mapping is writable while the PDO is valid (Elmo)

        def check(entry: Entry, value: Value) -> Value:
            present, count = self.parameters(communication), self._store.number(entry.index)
            if fixed or self.remaps_valid:
                present = replace(present, enabled=False)
            if entry.subindex:
                refuse(rules.check_mapping_entry(entry.subindex, int(value), present, count))
            else:
                entries = [self._store.number(entry.index, sub) for sub in range(1, rules.max_entries + 1)]
                refuse(rules.check_mapping_count(int(value), entries, present))
            return value

        return check

    def _users(self) -> dict[int, int]:
        """Return, by 11-bit identifier, the index of the record that uses it; SYNC and EMCY have priority over PDOs."""
        store = self._store
        users: dict[int, int] = {}
        for index, default in ((COB_ID_SYNC, 0x80), (COB_ID_EMCY, INVALID_BIT)):
            value = store.number(index, 0, default)
            if index == COB_ID_SYNC or not value & INVALID_BIT:
                users.setdefault(value & 0x7FF, index)
        for index in self._communication:
            parameters = PdoParameters.from_value(store.number(index, 1, INVALID_BIT))
            if parameters.enabled and not parameters.extended:
                users.setdefault(parameters.cob_id, index)
        return users

    def is_valid(self, communication: int) -> bool:
        """Whether the PDO of a communication record is valid (bit 31 of the COB-ID clear)."""
        return not self._store.number(communication, 1, INVALID_BIT) & INVALID_BIT

    def parameters(self, communication: int) -> PdoParameters:
        """Return the parameters in a communication record; disabled if another record uses the identifier."""
        number = self._store.number
        params = PdoParameters.from_value(
            number(communication, 1, INVALID_BIT),
            transmission_type=number(communication, 2, 255),
            inhibit_time_100us=number(communication, 3),
            event_timer_ms=number(communication, 5),
            sync_start=number(communication, 6),
        )
        is_free = params.enabled and not params.extended and self._users().get(params.cob_id) != communication
        return replace(params, enabled=False) if is_free else params

    def _mapping(self, record: int) -> list[tuple[MappedObject, Entry | None]]:
        """Return the mapped objects with their entries; empty if a mapped object does not exist."""
        objects: list[tuple[MappedObject, Entry | None]] = []
        for sub in range(1, min(64, self._store.number(record)) + 1):
            index, subindex, bits = parse_mapping_entry(self._store.number(record, sub))
            entry = self._od.get(index, subindex)
            if index in DUMMY_TYPES:
                objects.append((dummy(DUMMY_TYPES[index]), None))
            elif entry is not None:
                objects.append((MappedObject(index, subindex, bits, entry.data_type), entry))
            else:
                return []
        if self._motors is not None:
            split = self._motors.split(mapped for mapped, _ in objects)
            return [(mapped, self._store.od.get(mapped.index, mapped.subindex)) for mapped in split]
        return objects

    def shared(self, entries: Sequence[Entry | None]) -> tuple[tuple[int, Entry], ...]:
        """Return the copies of shared objects on further axes, each with the position of its value in the RPDO."""
        copies = {} if self._motors is None else self._motors.shared
        return tuple(
            (position, self._store.od[copy])
            for position, entry in enumerate(entries)
            for copy in (() if entry is None else copies.get(entry.address, ()))
        )

    def codec(self, record: int) -> tuple[PdoCodec, tuple[Entry | None, ...]]:
        """Return the codec and the entries (None: a gap) of a mapping record; both empty if the mapping is invalid."""
        objects = self._mapping(record)
        try:
            return PdoCodec([mapped for mapped, _ in objects]), tuple(entry for _, entry in objects)
        except LocalProtocolError:  # an impossible default mapping
            return PdoCodec(()), ()


class RpdoInput:
    """Injected delay and loss of the RPDOs that a node receives.

    Injection points: `delay_ns`, and `lost` = n, which drops every n-th RPDO (0: none). `delayed` are the delayed
    frames with the times at which they are passed on; `received` counts the received RPDOs.
    """

    def __init__(self) -> None:
        self.delay_ns: InjectionPoint[int] = InjectionPoint(0)
        self.lost: InjectionPoint[int] = InjectionPoint(0)
        self.received = 0
        self.delayed: deque[tuple[int, Receive, CanFrame]] = deque()

    def receiver(self, receive: Receive) -> Receive:
        """Return a handler that passes frames to `receive`, with the injected delay and loss."""

        def take(frame: CanFrame, now: int) -> None:
            self.received += 1
            lost, delay = self.lost.value, self.delay_ns.value
            if lost and self.received % lost == 0:
                return
            if delay:
                self.delayed.append((now + delay, receive, frame))
            else:
                receive(frame, now)

        return take

    def tick(self, now: int) -> None:
        delayed = self.delayed
        while delayed and delayed[0][0] <= now:
            _, receive, frame = delayed.popleft()
            receive(frame, now)

    def next_deadline(self) -> int | None:
        """Return the time in ns at which the next delayed frame is due, or None if none is delayed."""
        return self.delayed[0][0] if self.delayed else None


_SET_POINTS = frozenset((o.TARGET_POSITION, o.TARGET_VELOCITY, o.TARGET_TORQUE, o.INTERPOLATION_DATA))
_CONTROLWORD, _SET_POINT = 1, 2  # flags: what an RPDO wrote to an axis
_NO_EVENTS = frozenset((o.STATUSWORD, o.MODES_OF_OPERATION_DISPLAY, o.ERROR_CODE))  # change without motion


class PdoExchange:
    """RPDOs and TPDOs of a node.

    `rebuilt` is called after a PDO was rebuilt, because the identifiers may have changed. `input` injects faults into
    RPDOs, `refused` counts refused RPDO values. `outgoing` are the queues of TPDOs to send, which the sender empties.
    """

    def __init__(
        self,
        store: VirtualStore,
        outbox: NodeOutbox,
        clock: NodeClock,
        model: DeviceModel,
        axes: Mapping[int, AxisPorts],
        motors: MotorMap | None = None,
        *,
        rebuilt: Callable[[], None],
    ) -> None:
        self._store, self._outbox, self._clock, self._model = store, outbox, clock, model
        self._axes, self._on_rebuilt = axes, rebuilt
        self.refused = 0
        self._refusing: set[int] = set()  # RPDOs
        self.input: RpdoInput = RpdoInput()  # annotated, as `tpdos`, for the modules of quirks that are compiled before
        self.records = PdoRecords(store, motors, rtr_supported=model.rtr_supported)
        self.rpdos = {number: MappedRpdo(number) for number in self.records.numbers(RPDO)}
        self.tpdos: dict[int, MappedTpdo] = {number: MappedTpdo(number) for number in self.records.numbers(TPDO)}
        self.has_event_pdos = False
        self.function: DeviceFunction | None = None  # decides which changes trigger TPDOs
        self.outgoing: tuple[deque[CanFrame], ...] = ()
        self._event_tpdos: list[MappedTpdo] = []
        self._valid_tpdos: list[MappedTpdo] = []
        self._valid_rpdos: list[MappedRpdo] = []
        self._timed_rpdos: list[MappedRpdo] = []  # RPDOs with a deadline
        self._timed: list[TpdoProducer | RpdoConsumer] = []
        for base, numbers in ((RPDO, [*self.rpdos]), (TPDO, [*self.tpdos])):
            for number in numbers:
                self.records.guard(base, base + number)
                watched = [base + number, mapping_of(base + number)]
                store.on_write(watched, partial(self._rebuilt, base, number))

    # -- from the records to the PDOs

    def configure(self, now: int) -> None:
        for number in self.rpdos:
            self._make_rpdo(number)
        for number in self.tpdos:
            self._make_tpdo(number, now)
        self._survey()
        for base, kind, numbers in ((RPDO, "RPDO", self.rpdos), (TPDO, "TPDO", self.tpdos)):
            for number in numbers:
                if self.records.is_valid(base + number) and not self._is_valid(base, number):
                    cob_id = self.records.parameters(base + number).cob_id
                    self._outbox.publish(PdoLeftOff(kind, number + 1, cob_id))

    def _rebuilt(self, base: int, number: int, _entry: Entry, _value: Value) -> None:
        before = self._is_valid(base, number)
        if not (before or self.records.is_valid(base + number)):
            return  # a PDO is created from its whole record when it becomes valid
        self._make(base, number)
        self._make_waiting()
        self._survey()
        self._on_rebuilt()

    def _make_waiting(self) -> None:
        """Create the valid PDOs whose identifier has just become free."""
        for base, numbers in ((RPDO, self.rpdos), (TPDO, self.tpdos)):
            for number in numbers:
                if self.records.is_valid(base + number) and not self._is_valid(base, number):
                    self._make(base, number)

    def _make(self, base: int, number: int) -> None:
        if base == RPDO:
            self._make_rpdo(number)
        else:
            self._make_tpdo(number, self._clock.now)

    def _is_valid(self, base: int, number: int) -> bool:
        core = self.rpdos[number].consumer if base == RPDO else self.tpdos[number].producer
        return core.parameters.enabled

    def _make_rpdo(self, number: int) -> None:
        rpdo = self.rpdos[number]
        rpdo.codec, entries = self.records.codec(mapping_of(RPDO + number))
        shared = self.records.shared(entries)
        rpdo.entries = (*entries, *(entry for _, entry in shared))
        rpdo.shared = tuple(position for position, _ in shared)
        rpdo.consumer.window_ns = self._store.number(0x1007) * 1000
        parameters = self.records.parameters(RPDO + number)
        rpdo.consumer.configure(parameters, rpdo.codec.length)
        addresses = (o.axis_of(entry.index) for entry in rpdo.entries if entry is not None and entry.index >= 0x6000)
        rpdo.set_points = tuple((axis, base) for base, axis in addresses if base in _SET_POINTS and axis in self._axes)
        rpdo.cyclic = ACYCLIC_SYNCHRONOUS < parameters.transmission_type <= LAST_CYCLIC
        rpdo.axis_writes, rpdo.version = axis_writes_of(rpdo.entries, self._axes), -1
        indices = [entry.index for entry in rpdo.entries if entry is not None]
        rpdo.by_values = all(self._store.guarded_by_values(index) for index in indices)
        self._check(rpdo, set())

    def _make_tpdo(self, number: int, now: int) -> None:
        tpdo = self.tpdos[number]
        tpdo.codec, entries = self.records.codec(mapping_of(TPDO + number))
        tpdo.sources = tuple(self._source(entry) for entry in entries if entry is not None)
        tpdo.mapped = tuple(entry.address for entry in entries if entry is not None)
        tpdo.moving = any(entry is not None and o.axis_of(entry.index)[0] not in _NO_EVENTS for entry in entries)
        tpdo.producer.configure(self.records.parameters(TPDO + number), now)

    def _source(self, entry: Entry) -> Source:
        source = self._store.source_of(entry.index, entry.subindex)
        if source is not None:
            return source
        values, address = self._store.values, entry.address
        return lambda: values[address]

    def rules_changed(self) -> None:
        """Update the value sources and write checks of the mapped objects after quirks changed."""
        for number, tpdo in self.tpdos.items():
            entries = self.records.codec(mapping_of(TPDO + number))[1]
            tpdo.sources = tuple(self._source(entry) for entry in entries if entry is not None)
        for rpdo in self.rpdos.values():
            rpdo.version = -1
            rpdo.by_values = all(self._store.guarded_by_values(entry.index) for entry in rpdo.entries if entry)

    def _survey(self) -> None:
        self._valid_rpdos = [rpdo for rpdo in self.rpdos.values() if rpdo.consumer.parameters.enabled]
        self._timed_rpdos = [rpdo for rpdo in self._valid_rpdos if rpdo.consumer.parameters.event_ns]
        self._valid_tpdos = [tpdo for tpdo in self.tpdos.values() if tpdo.producer.parameters.enabled]
        self.outgoing = tuple(tpdo.producer.outgoing.waiting for tpdo in self._valid_tpdos)
        kinds = [(tpdo, tpdo.producer.parameters.transmission_type) for tpdo in self._valid_tpdos]
        self._event_tpdos = [tpdo for tpdo, kind in kinds if is_event_driven(kind) or kind == ACYCLIC_SYNCHRONOUS]
        self.has_event_pdos = any(tpdo.moving for tpdo in self._event_tpdos)
        producers = (tpdo.producer for tpdo in self._event_tpdos)
        self._timed = [*producers, *(rpdo.consumer for rpdo in self._timed_rpdos)]

    # -- in operation

    def start(self, now: int) -> None:
        """Start all PDOs when the node becomes OPERATIONAL."""
        for rpdo in self.rpdos.values():
            rpdo.consumer.start()
        function = self.function
        for tpdo in self.tpdos.values():
            tpdo.producer.start(now, shows=function is None or function.starts(tpdo.mapped))

    def stop(self) -> None:
        """Stop all PDOs when the node leaves OPERATIONAL."""
        for rpdo in self.rpdos.values():
            rpdo.consumer.stop()
        for tpdo in self.tpdos.values():
            tpdo.producer.stop()

    def routes(self) -> list[tuple[int, Receive]]:
        """Return the CAN IDs that the valid PDOs receive (with the flags of linux/can.h), each with its receiver."""
        receivers = [(rpdo.consumer.parameters, self._receiver(rpdo)) for rpdo in self.rpdos.values()]
        handlers = [(_can_id(parameters), receive) for parameters, receive in receivers if parameters.enabled]
        for producer in (tpdo.producer for tpdo in self.tpdos.values()):
            if producer.parameters.enabled:
                handlers += [(_can_id(producer.parameters) | REMOTE_FLAG, producer.receive)]
        return handlers

    def sync_rpdo_handlers(self) -> list[tuple[int, Callable[[CanFrame, int], bool]]]:
        """Return CAN IDs and handlers of RPDOs to store until SYNC; a handler returns False if it declines a frame."""
        parameters = [(rpdo, rpdo.consumer.parameters) for rpdo in self.rpdos.values()]
        return [(_can_id(params), self._holder(rpdo)) for rpdo, params in parameters if params.enabled]

    def _holder(self, rpdo: MappedRpdo) -> Callable[[CanFrame, int], bool]:
        consumer, source = rpdo.consumer, self.input

        def hold(frame: CanFrame, now: int) -> bool:
            if rpdo.wrong or source.lost.value or source.delay_ns.value:
                return False
            waiting = consumer.holds
            if not consumer.hold(frame.data):
                return False
            source.received += 1
            if rpdo.set_points:
                self._count_set_points(rpdo, now, overwrites=waiting)
            return True

        return hold

    def _receiver(self, rpdo: MappedRpdo) -> Receive:
        consumer = rpdo.consumer

        def receive(frame: CanFrame, now: int) -> None:
            waiting, before = consumer.holds, consumer.received
            consumer.receive(frame, now)
            if rpdo.set_points and consumer.received != before:
                self._count_set_points(rpdo, now, overwrites=waiting)
            self._serve(rpdo, now)
            length_error = consumer.length_error
            if length_error is not None or rpdo.wrong:
                self._check(rpdo, rpdo.wrong & {RpdoEventKind.TIMEOUT} | ({length_error} if length_error else set()))

        return self.input.receiver(receive)

    def _count_set_points(self, rpdo: MappedRpdo, now: int, *, overwrites: bool) -> None:
        for axis, base in rpdo.set_points:
            if self._axes[axis].set_point == base:
                self._axes[axis].set_point_received(now, overwrites=overwrites)

    def _serve(self, rpdo: MappedRpdo, now: int) -> None:
        if not rpdo.consumer.event_queue.waiting:
            return
        for event in rpdo.consumer.events():
            if event.kind is RpdoEventKind.APPLY:
                self._apply(rpdo, event.data, now)
            elif event.kind is RpdoEventKind.TIMEOUT:
                self._check(rpdo, rpdo.wrong | {event.kind})
            elif event.kind is RpdoEventKind.RESOLVED:
                self._check(rpdo, rpdo.wrong - {RpdoEventKind.TIMEOUT})

    def _check(self, rpdo: MappedRpdo, wrong: set[RpdoEventKind]) -> None:
        """Send EMCYs for the errors of an RPDO, and clear the errors that no RPDO has any longer."""
        cleared, rpdo.wrong = rpdo.wrong - wrong, wrong
        for kind in wrong:
            self._outbox.emergency(EMCY_OF[kind], ErrorRegister.COMMUNICATION)
        for kind in cleared:
            if not any(kind in other_rpdo.wrong for other_rpdo in self.rpdos.values()):
                self._outbox.clear_error(EMCY_OF[kind])

    def _apply(self, rpdo: MappedRpdo, data: bytes, now: int) -> None:
        """Write all values of an RPDO to the objects, then update the axes and notify the watchers."""
        for axis in self._axes.values():
            axis.advance(now)
        store = self._store
        if rpdo.version == store.version and rpdo.applied == data and not store.ceilings.value:
            self._act_again(rpdo, now)  # the values are in place
            return
        applied: list[tuple[Entry, Value]] = []
        refused = self.refused
        values = rpdo.codec.unpack(data)
        if rpdo.shared:
            values = (*values, *[values[position] for position in rpdo.shared])
        for entry, value in zip(rpdo.entries, values, strict=True):
            if entry is None:
                continue
            try:
                applied.append((entry, self._store.place(entry, value)))
            except SdoServerAbort:
                self.refused += 1
        is_unchanged = self.refused == refused
        self._report_refusal(rpdo, not is_unchanged)
        if is_unchanged and rpdo.by_values and rpdo.axis_writes:
            rpdo.applied, rpdo.version = data, store.version
            self._act_again(rpdo, now)
        else:
            self._act_on(applied, now)

    def _act_again(self, rpdo: MappedRpdo, now: int) -> None:
        """Update the axes of an RPDO whose values are already in the objects."""
        for axis, controlword, objects in rpdo.axis_writes:
            axis.refresh(now, controlword=controlword, set_point=axis.set_point in objects)

    def _act_on(self, applied: list[tuple[Entry, Value]], now: int) -> None:
        """Update each axis once for the written values of an RPDO, and notify the watchers of non-axis objects."""
        axes: dict[int, int] = {}
        for entry, value in applied:
            base, axis = o.axis_of(entry.index)
            if axis in self._axes and base >= 0x6000:
                written = _CONTROLWORD if base == o.CONTROLWORD else 0
                written |= _SET_POINT if base == self._axes[axis].set_point else 0
                axes[axis] = axes.get(axis, 0) | written
            else:
                self._store.notify(entry, value)
        for axis, written in axes.items():
            self._axes[axis].refresh(
                now, controlword=bool(written & _CONTROLWORD), set_point=bool(written & _SET_POINT)
            )

    def _report_refusal(self, rpdo: MappedRpdo, refused: bool) -> None:
        """Report the device model's error, if any, while values of RPDOs are refused."""
        error = self._model.rpdo_error
        if refused:
            self._refusing.add(rpdo.number)
            if error is not None:
                self._outbox.emergency(error[0], ErrorRegister.GENERIC, error[1])
        elif rpdo.number in self._refusing:
            self._refusing.remove(rpdo.number)
            if error is not None and not self._refusing:
                self._outbox.clear_error(error[0])

    def sync(self, counter: int | None, now: int) -> None:
        """Send the TPDOs and apply the RPDOs that a SYNC triggers, and count missing set-points."""
        self._clock.sync_ns = now
        self._clock.rhythm.receive_sync(now)
        for tpdo in self._valid_tpdos:
            tpdo.producer.sync(now, counter)
        for rpdo in self._valid_rpdos:
            consumer = rpdo.consumer
            if rpdo.cyclic and rpdo.set_points and consumer.running and not consumer.holds:
                self._count_missed(rpdo)
            consumer.sync(now)
            self._serve(rpdo, now)

    def _count_missed(self, rpdo: MappedRpdo) -> None:
        for axis, base in rpdo.set_points:
            if self._axes[axis].set_point == base:
                self._axes[axis].set_point_missed()

    def send_changed(self, now: int) -> None:
        """Send the event-driven TPDOs with changed values, unless the device function suppresses them."""
        function = self.function
        for tpdo in self._event_tpdos:
            before = tpdo.last
            differs = tpdo.producer.running and tpdo.sample() != before
            if differs and (function is None or function.passes(tpdo.changed_since(before))):
                tpdo.producer.changed(now)
        if function is not None:
            function.tpdos_checked()

    def tick(self, now: int) -> None:
        self.input.tick(now)
        for tpdo in self._event_tpdos:
            tpdo.producer.tick(now)
        for rpdo in self._timed_rpdos:
            rpdo.consumer.tick(now)
            self._serve(rpdo, now)

    def next_deadline(self) -> int | None:
        first = self.input.next_deadline() if self.input.delayed else None
        for part in self._timed:
            deadline = part.next_deadline()
            if deadline is not None and (first is None or deadline < first):
                first = deadline
        return first


def _can_id(parameters: PdoParameters) -> int:
    return parameters.cob_id | (EXTENDED_FLAG if parameters.extended else 0)
