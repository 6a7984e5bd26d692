"""Device side of CiA 301 for one object dictionary: a virtual node for any master.

A node consists of services on an object store; each service gets only its dependencies: the store, the outbox and the
clock. This module creates the services, passes frames to the services and executes NMT state changes and resets. A node
sends the boot-up message, enters PRE-OPERATIONAL, and starts only on command, unless its dictionary makes it start by
itself (0x1F80). Reset node restores all power-on values, reset communication those of 0x1000 to 0x1FFF. Between two
events a node needs no CPU time.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

from canopen_control.cia301.emcy import EmcyProducer, ErrorRegister
from canopen_control.cia301.guarding import GuardingSlave
from canopen_control.cia301.heartbeat import HeartbeatConsumer, HeartbeatProducer
from canopen_control.cia301.lss import (
    BIT_TIMINGS,
    MASTER_COB_ID,
    UNCONFIGURED,
    LssActivateBitTiming,
    LssIdentity,
    LssNodeIdAssigned,
    LssSlave,
)
from canopen_control.cia301.nmt import NmtCommand, NmtResetRequested, NmtSlave, NmtState, NmtStateChanged
from canopen_control.cia301.sdo_codec import ANSWER_BASE, REQUEST_BASE
from canopen_control.cia301.sdo_server import SdoServer
from canopen_control.cia301.sync import SyncConsumer, SyncEventKind
from canopen_control.cia402 import objects as o
from canopen_control.cia402.motors import motors_of
from canopen_control.frame import EXTENDED_FLAG, REMOTE_FLAG, Service, cob_id, is_restricted
from canopen_control.od.indices import PROGRAM_CONTROL
from canopen_control.od.model import SIGNED_TYPES, DataType, Entry, profile_type
from canopen_control.virtual.communication_objects import CommunicationObjects, ErrorControl, ProgramArea, Services
from canopen_control.virtual.device_model import GENERIC, DeviceModel, make_function
from canopen_control.virtual.injection_point import InjectionPoint
from canopen_control.virtual.node_outbox import HEARTBEAT_ERROR, BitRateActivated, NodeClock, NodeIdChanged, NodeOutbox
from canopen_control.virtual.node_pdos import PdoExchange
from canopen_control.virtual.object_store import DeviceStore, VirtualStore
from canopen_control.virtual.virtual_drive import VirtualDrive

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.bus.port import BusEventKind
    from canopen_control.frame import CanFrame
    from canopen_control.od.model import ObjectDictionary, Value
    from canopen_control.virtual.device_model import DeviceFunction
    from canopen_control.virtual.injection_point import FaultFilter, NodeQuirks
    from canopen_control.virtual.plant import Plant

    Receiver = Callable[[CanFrame, int], None]
    SyncRpdoHandler = Callable[[CanFrame, int], bool]


# Routing of frames to the services of a virtual node: a table by identifier, rebuilt when an identifier changes.


SYNC_LENGTH_ERROR = 0x8240


class FrameRoutes:
    """Routing table of one node, from CAN IDs (with the flags of linux/can.h) to receivers.

    `version` increases when the set of identifiers changes. `sync_rpdo_handlers` receive the RPDOs that take effect
    only at SYNC and whose identifier has no other receiver.
    """

    def __init__(
        self,
        nmt: NmtSlave,
        sdo: SdoServer,
        consumer: HeartbeatConsumer,
        guarding: GuardingSlave,
        sync: SyncConsumer,
        pdos: PdoExchange,
        lss: NodeLss | None,
        outbox: NodeOutbox,
        advance_drives: Callable[[int], None],
    ) -> None:
        self.table: dict[int, Receiver] = {}
        self.sync_rpdo_handlers: dict[int, SyncRpdoHandler] = {}
        self.version = 0
        self._nmt, self._sdo, self._consumer, self._guarding, self._sync = nmt, sdo, consumer, guarding, sync
        self._pdos, self._lss, self._outbox, self._advance_drives = pdos, lss, outbox, advance_drives

    @property
    def sdo_alone(self) -> bool:
        """Whether the SDO server is the only receiver of its request COB-ID."""
        return self.table.get(self._sdo.request_cob_id) == self._on_sdo

    def route_lss_only(self) -> None:
        """Route only LSS frames while the node initialises."""
        self.table = self._lss_routes()
        self.sync_rpdo_handlers = {}
        self.version += 1

    def rebuild(self) -> None:
        """Rebuild the table after an identifier has changed; no effect while the node initialises."""
        if self._nmt.state is NmtState.INITIALISING:
            return
        error_control = cob_id(Service.HEARTBEAT, self._nmt.node_id)
        consumer = self._consumer
        routes: list[tuple[int, Receiver]] = [
            *self._lss_routes().items(),
            (0x000, self._nmt.receive),
            (self._sdo.request_cob_id, self._on_sdo),
            (error_control | REMOTE_FLAG, self._guarding.receive),
            *self._sync_routes(),
            *((cob_id(Service.HEARTBEAT, node_id), consumer.receive) for node_id in consumer.watched()),
            *self._pdos.routes(),
        ]
        identifiers = [can_id for can_id, _ in routes]
        handlers = self._pdos.sync_rpdo_handlers()
        self.sync_rpdo_handlers = {can_id: handler for can_id, handler in handlers if identifiers.count(can_id) == 1}
        table = merged(routes)
        if table.keys() != self.table.keys():
            self.version += 1
        self.table = table

    def _lss_routes(self) -> dict[int, Receiver]:
        return {} if self._lss is None else {MASTER_COB_ID: self._lss.receive}

    def _sync_routes(self) -> list[tuple[int, Receiver]]:
        """Return the route of SYNC, or an empty list if 0x1005 contains a restricted CAN ID."""
        can_id = self._sync.cob_id
        return [] if not can_id & EXTENDED_FLAG and is_restricted(can_id) else [(can_id, self._on_sync)]

    def _on_sdo(self, frame: CanFrame, now: int) -> None:
        if self._nmt.state is not NmtState.STOPPED:
            self._sdo.receive(frame, now)

    def _on_sync(self, frame: CanFrame, now: int) -> None:
        if self._nmt.state is NmtState.STOPPED:
            return
        self._advance_drives(now)
        sync = self._sync
        if not frame.data and frame.can_id == sync.cob_id and sync.receive_plain(now):
            self._outbox.clear_error(SYNC_LENGTH_ERROR)
            if self._nmt.state is NmtState.OPERATIONAL:
                self._pdos.sync(None, now)
            return
        sync.receive(frame, now)
        events = self._sync.events()
        if len(events) > 1 and any(event.kind is SyncEventKind.LENGTH_ERROR for event in events):
            self._outbox.emergency(SYNC_LENGTH_ERROR, ErrorRegister.COMMUNICATION)
        else:
            self._outbox.clear_error(SYNC_LENGTH_ERROR)
        for event in events:
            if event.kind is SyncEventKind.SYNC and self._nmt.state is NmtState.OPERATIONAL:
                self._pdos.sync(event.counter, now)


def merged(routes: Iterable[tuple[int, Receiver]]) -> dict[int, Receiver]:
    """Combine routes into a table; a frame with several receivers is passed to each of them in order."""
    table: dict[int, Receiver] = {}
    for can_id, receiver in routes:
        table[can_id] = _both(table[can_id], receiver) if can_id in table else receiver
    return table


def _both(first: Receiver, second: Receiver) -> Receiver:
    def receive(frame: CanFrame, now: int) -> None:
        first(frame, now)
        second(frame, now)

    return receive


# Layer setting services: a virtual node has an LSS slave (CiA 305) if its EDS sets LSS_Supported.
#
# A new node-ID is pending until a reset of communication activates it, and is lost at power-off unless it was stored. A
# node without a node-ID (255) supports nothing but LSS. A virtual bus has no bit rate: a new bit rate is reported and
# stored but has no other effect.


class NodeLss:
    """LSS slave of a node (CiA 305), with the stored node-ID and bit rate.

    `stored_node_id` and `stored_bitrate` (bit/s, None if none was stored) survive power-off. `assigned` is called with
    the first node-ID of a node that had none. `stored` is called when a stored value changes, and returns whether the
    value was saved.
    """

    def __init__(
        self,
        store: VirtualStore,
        node_id: int,
        outbox: NodeOutbox,
        *,
        assigned: Callable[[int, int], None],
        stored: Callable[[], bool],
    ) -> None:
        self._store, self._outbox, self._assigned, self._stored = store, outbox, assigned, stored
        self.stored_node_id = node_id
        self.stored_bitrate: int | None = None
        rates = store.od.device.bit_rates
        timings = frozenset(index for index, rate in BIT_TIMINGS.items() if not rates or rate in rates)
        self.slave = LssSlave(LssIdentity(0, 0, 0, 0), node_id, bit_timings=timings, store=self._keep)

    def receive(self, frame: CanFrame, now: int) -> None:
        """Handle a frame of the LSS master."""
        self.slave.identity = LssIdentity(*(self._store.number(0x1018, part) for part in range(1, 5)))
        self.slave.receive(frame, now)
        for event in self.slave.events():
            if isinstance(event, LssNodeIdAssigned):
                self._assigned(event.node_id, now)
            elif isinstance(event, LssActivateBitTiming):
                self._outbox.publish(BitRateActivated(event.bitrate))

    def reset(self, *, power: bool) -> int:
        """Activate and return the pending node-ID, or the stored node-ID if `power` is True."""
        if power:
            self.slave.pending_node_id, self.slave.pending_bitrate = self.stored_node_id, self.stored_bitrate
        self.slave.reset()
        return self.slave.node_id

    def _keep(self, node_id: int, bitrate: int | None) -> bool:
        before = self.stored_node_id, self.stored_bitrate
        self.stored_node_id = node_id
        self.stored_bitrate = self.stored_bitrate if bitrate is None else bitrate
        if self._stored():
            return True
        self.stored_node_id, self.stored_bitrate = before
        return False


PROTOCOL_ERRORS = 0x82  # high byte of the EMCY codes of PDO and SYNC errors


class Timed(Protocol):
    """Service of a node that has timers."""

    def next_deadline(self) -> int | None:
        """Return the time in ns at which `tick` is next due, or None if no timer runs."""

    def tick(self, now: int) -> None:
        """Run the timers that are due at `now`."""


class ParameterKeeper(Protocol):
    """Storage that preserves the parameters of a node while the node is powered off."""

    def keep(self, node: VirtualNode) -> bool:
        """Save parameters changed by 0x1010, 0x1011 or LSS; return False on failure."""
        ...


_FAULT_BIT = 1 << 3  # bit of a statusword
_SERVO_DRIVE = 0x0002_0192  # device type of a servo drive (CiA 402-2, object 0x1000)


def _with_device_type(od: ObjectDictionary) -> ObjectDictionary:
    """Return `od` with the mandatory object 0x1000 (CiA 301, 7.5.1) added if the file lacks it."""
    if (0x1000, 0) in od:
        return od
    complete = replace(od, entries=od.entries.copy(), objects=od.objects.copy())
    device_type = _SERVO_DRIVE if (o.CONTROLWORD, 0) in od else 0
    complete.add(Entry(0x1000, 0, "Device type", DataType.UNSIGNED32, "ro", default=device_type))
    return complete


def _with_signed_types(od: ObjectDictionary) -> ObjectDictionary:
    """Return `od` with signed types for a drive's objects that are signed in CiA 402 and unsigned in the file.

    One EDS of a CiA 402 drive in four has such a type, such as UNSIGNED32 for 0x60FF; the drives use signed numbers.
    """
    if (o.CONTROLWORD, 0) not in od:
        return od
    retyped = {}
    for entry in od:
        signed = SIGNED_TYPES.get(entry.data_type)
        types = () if signed is None else profile_type(*entry.address)
        if signed is not None and signed in types and entry.data_type not in types:
            retyped[entry.address] = _as_signed(entry, signed)
    return replace(od, entries=od.entries | retyped) if retyped else od


def _as_signed(entry: Entry, data_type: DataType) -> Entry:
    """Return an entry with the same bits as numbers of a signed type; limits beyond that type are dropped."""
    span = 1 << (data_type.bits or 0)

    def number(value: Value | None) -> Value | None:
        return value - span if isinstance(value, int) and value > data_type.maximum else value

    fits = all(limit is None or limit <= data_type.maximum for limit in (entry.low, entry.high))
    low, high = (entry.low, entry.high) if fits else (None, None)
    default, parameter = number(entry.default), number(entry.parameter_value)
    return replace(entry, data_type=data_type, default=default, parameter_value=parameter, low=low, high=high)


class VirtualNode:
    """Virtual CANopen node: the services of CiA 301, and either the axes of a drive or another device function.

    `serial` (default: the node-ID) fills an empty 0x1018:04; `plant` creates the plant of an axis. `filter` applies the
    active faults and quirks to frames; None if there are none. `fault_switches` and `quirks` switch them on and off.
    While the injection point `self_starting` is True, the node enters OPERATIONAL without a command, regardless of the
    dictionary. `routing` maps CAN IDs to receivers; its `version` increases when the result of `routes` changes.
    """

    def __init__(
        self,
        od: ObjectDictionary,
        node_id: int,
        *,
        serial: int | None = None,
        model: DeviceModel = GENERIC,
        plant: Callable[[int], Plant] | None = None,
    ) -> None:
        od = _with_signed_types(_with_device_type(od))
        self.motors = motors = motors_of(od)
        od = od if motors is None else motors.view
        # Declared, not inferred: quirk actions use these in lambdas, and mypyc checks those before this class.
        self.node_id: int = node_id
        self.nmt: NmtSlave = NmtSlave(node_id)
        self.emcy: EmcyProducer = EmcyProducer(node_id, history_size=max(1, len(od.subindices(0x1003)) - 1))
        self.store: VirtualStore = VirtualStore(od)
        store = self.store
        self.od, self.model = od, model
        self.filter: FaultFilter | None = None
        self.fault_switches: FaultFilter | None = None
        self.quirks: NodeQuirks | None = None
        self.self_starting: InjectionPoint[bool] = InjectionPoint(False)
        self._boot_at: int | None = 0
        self._reset_delay_ns: int | None = 0  # before the boot-up message, None: the node never boots
        self._started = self._settling = False
        self.keeper: ParameterKeeper | None = None
        self.clock = NodeClock()
        self.heartbeat = HeartbeatProducer(node_id)
        self.consumer = HeartbeatConsumer()
        self.guarding = GuardingSlave(node_id)
        self.sync = SyncConsumer()
        self.sdo = SdoServer(node_id, store if motors is None else DeviceStore(store, motors))
        self.outbox = outbox = NodeOutbox(self.emcy, self.clock)
        self.drives: dict[int, VirtualDrive] = {}
        self.error_control = ErrorControl(store, self.nmt, self.consumer, outbox, model, self.drives)
        self.communication = self._make_communication()
        self.communication.identify(node_id if serial is None else serial, model.identity)
        self.pdos: PdoExchange = PdoExchange(
            store, outbox, self.clock, model, self.drives, motors, rebuilt=self._reroute
        )
        self.program = ProgramArea(od, store, self.nmt, self.clock) if od.subindices(PROGRAM_CONTROL) else None
        self.lss = self._make_lss() if od.device.lss_supported else None
        self.routing = self._routes()
        self._add_drives(plant)
        self.function = make_function(od, store, outbox, self.clock)
        self.error_control.function = self.pdos.function = self.function
        self._cache_queues()

    def _make_communication(self) -> CommunicationObjects:
        services = Services(self.emcy, self.sync, self.heartbeat, self.guarding, self.error_control)
        return CommunicationObjects(self.store, services, self.clock, applied=self._reroute, stored=self._stored)

    def _make_lss(self) -> NodeLss:
        return NodeLss(self.store, self.node_id, self.outbox, assigned=self._start_with_node_id, stored=self._stored)

    def _common_statusword(self) -> int:
        """Return the statusword that all motors share: of the first one with a fault, else of the first one."""
        words = [drive.statusword() for drive in self.drives.values()]
        return next((word for word in words if word & _FAULT_BIT), words[0])

    def _routes(self) -> FrameRoutes:
        return FrameRoutes(
            self.nmt,
            self.sdo,
            self.consumer,
            self.guarding,
            self.sync,
            self.pdos,
            self.lss,
            self.outbox,
            self.advance_drives,
        )

    def _cache_queues(self) -> None:
        """Collect services, deadlines and queues in tuples, which speeds up the handling of frames."""
        outbox = self.outbox
        self._cores: tuple[Timed, ...] = (
            self.heartbeat,
            self.consumer,
            self.guarding,
            self.emcy,
            self.sync,
            self.sdo,
            self.pdos,
        )
        parts = [part for part in (self.function, self.program) if part is not None]
        movers = [drive.mover for drive in self.drives.values()]
        self._deadlines = tuple(part.next_deadline for part in (*self._cores, *movers, *parts))
        first = (self.nmt.outgoing, self.emcy.outgoing, self.heartbeat.outgoing, self.guarding.outgoing)
        last = (outbox.outgoing,) if self.lss is None else (self.lss.slave.outgoing, outbox.outgoing)
        # queues that are sent before process data and answers, and queues that are sent after them
        self._sent_first, self._sent_last = tuple(box.waiting for box in first), tuple(box.waiting for box in last)
        self._sent_before_answers, self._process_data = self._sent_first, self.pdos.outgoing
        self._event_queues = (
            self.nmt.event_queue.waiting,
            self.consumer.event_queue.waiting,
            self.guarding.event_queue.waiting,
        )

    def _add_drives(self, plant: Callable[[int], Plant] | None) -> None:
        for axis in range(o.axis_count({entry.index for entry in self.od})):
            self._add_drive(axis, None if plant is None else plant(axis))
        if self.motors is not None and (o.STATUSWORD, 0) in self.motors.shared:
            self.store.on_read(o.STATUSWORD, 0, self._common_statusword)

    def _add_drive(self, axis: int, plant: Plant | None) -> None:
        self.drives[axis] = VirtualDrive(
            axis,
            self.store,
            self.outbox,
            self.clock,
            self.nmt,
            plant=plant,
            model=self.model,
            shows_motion=self._shows_motion,
        )

    # -- sans-I/O interface

    def receive(self, frame: CanFrame, now: int) -> None:
        """Handle a received frame of any kind; a frame without a receiver is ignored.

        `receive_sync_rpdo` and `receive_records` are faster paths for two kinds of frames and decline frames that they
        cannot handle; callers need not use them.
        """
        self._advance(now)
        if self.filter is not None:
            delivered = self.filter.incoming(frame, now)
            if delivered is None:
                return
            frame = delivered
        take = self.routing.table.get(frame.can_id)
        if take is not None:
            take(frame, now)
            self._settle(now)

    def receive_sync_rpdo(self, frame: CanFrame, now: int) -> bool:
        """Store an RPDO that takes effect at the next SYNC; return False if `receive` must be used instead."""
        handler = self.routing.sync_rpdo_handlers.get(frame.can_id)
        if handler is None or self.filter is not None:
            return False
        self._advance(now)
        return handler(frame, now)

    def receive_records(self, records: bytes, start: int, now: int) -> int:
        """Handle SDO segments like `SdoServer.receive_records`; return 0 if `receive` must be used instead."""
        alone = self.filter is None and self.routing.sdo_alone
        return self.sdo.receive_records(records, start, now) if alone and self.nmt.state is not NmtState.STOPPED else 0

    def tick(self, now: int) -> None:
        """Advance all services to `now`; the first call is the power-on."""
        self._advance(now)
        if self.filter is not None:
            self.filter.tick(now)
        if self._boot_at is not None and now >= self._boot_at:
            self._boot(now)
        if self.program is not None and self.program.reset_at is not None and now >= self.program.reset_at:
            self.nmt.state = NmtState.INITIALISING
            self._reset(NmtCommand.RESET_NODE, now)
        self.advance_drives(now)
        if self.function is not None:
            self.function.tick(now)
        for core in self._cores:
            core.tick(now)
        self._settle(now)

    def next_deadline(self) -> int | None:
        """Return the time in ns at which `tick` is next due, or None if no timer runs."""
        first = self._boot_at
        for next_deadline in self._deadlines:
            deadline = next_deadline()
            if deadline is not None and (first is None or deadline < first):
                first = deadline
        if self.filter is not None:
            deadline = self.filter.next_deadline()
            if deadline is not None and (first is None or deadline < first):
                first = deadline
        return first

    def frames(self) -> list[CanFrame]:
        """Return and clear the frames to send, in order."""
        if self.pdos.outgoing is not self._process_data:
            self._process_data = self.pdos.outgoing
            self._sent_before_answers = self._sent_first + self._process_data
        frames: list[CanFrame] = []
        for waiting in self._sent_before_answers:
            if waiting:
                frames += waiting
                waiting.clear()
        frames += self.sdo.frames()
        for waiting in self._sent_last:
            if waiting:
                frames += waiting
                waiting.clear()
        return frames if self.filter is None else self.filter.outgoing(frames, self.clock.now)

    def events(self) -> list[object]:
        return self.outbox.events()

    def routes(self) -> Iterable[int]:
        """Return the CAN IDs that the node receives, with the flags of linux/can.h."""
        return self.routing.table.keys()

    # -- queries

    @property
    def name(self) -> str:
        """Name of the device for messages, from the device model or the EDS, else "node"."""
        return self.model.name or self.od.device.product_name or "node"

    @property
    def operational(self) -> bool:
        """Whether the node is OPERATIONAL, the only state in which PDOs are exchanged."""
        return self.nmt.state is NmtState.OPERATIONAL

    def _shows_motion(self) -> bool:
        """Whether an event-driven TPDO must be sent when a motion changes its values."""
        return self.pdos.has_event_pdos and self.operational

    def get(self, index: int, subindex: int = 0) -> Value:
        """Return the current value of an object; raise KeyError if the dictionary lacks the object."""
        if self.motors is not None and len(parts := self.motors.parts(index, subindex)) == 1:
            return self.store.get(*parts[0])
        return self.store.get(index, subindex)

    def _stored(self) -> bool:
        return self.keeper is None or self.keeper.keep(self)

    # -- actions from outside

    def advance_drives(self, now: int) -> None:
        for drive in self.drives.values():
            drive.mover.advance(now)

    def _parts(self) -> Iterable[VirtualDrive | DeviceFunction]:
        """Return the parts that start and stop with the node: the axes of a drive, or the device function."""
        return self.drives.values() if self.function is None else (self.function,)

    def send_changes(self, now: int) -> None:
        """Send the objects that a client has changed, and run due timers; no effect while a frame is being handled."""
        if not self._settling:
            self.tick(now)

    def bus_event(self, kind: BusEventKind, now: int) -> None:
        """Handle an event of the node's CAN controller, such as bus-off."""
        self._advance(now)
        self.advance_drives(now)
        self.error_control.bus_event(kind, now)
        self._settle(now)

    def command(self, command: NmtCommand, now: int) -> None:
        """Execute an NMT command that does not come from the bus."""
        self._advance(now)
        self.nmt.command(command)
        self._settle(now)

    def power_on(self, now: int) -> None:
        """Switch the node on, or off and on again (brown-out); values that were not stored are lost."""
        self._advance(now)
        if self.lss is not None:
            self.lss.reset(power=True)
        self.nmt.state = NmtState.INITIALISING
        self.nmt.events()
        self._reset(NmtCommand.RESET_NODE, now)
        self._settle(now)

    def set_reset_delay(self, delay_ns: int | None, now: int) -> None:
        """Set the time in ns from a reset to the boot-up message (None: no boot-up); restart a boot in progress."""
        self._reset_delay_ns = delay_ns
        if self.nmt.state is NmtState.INITIALISING:
            self._boot_at = None if delay_ns is None else now + delay_ns

    def set_clock_drift(self, ppm: float) -> None:
        """Set the drift of the node's clock in ppm; negative values make it slow."""
        self.clock.drift_ppm.inject(ppm)
        self.communication.apply()

    # -- life cycle

    def _advance(self, now: int) -> None:
        clock = self.clock
        if not self._started:  # power-on: without a delay before the first boot-up
            self._started, clock.now = True, now
            self._reset(NmtCommand.RESET_NODE, now)
            if self._boot_at is not None and self._reset_delay_ns == 0:
                self._boot_at = now
        if now > clock.now:
            clock.now = now

    def _settle(self, now: int) -> None:
        """Handle all events of the services, and the events that result from them, then send changed TPDOs."""
        if self._settling:
            return
        self._settling = True
        while any(self._event_queues):
            events = [event for waiting in self._event_queues for event in waiting]
            for waiting in self._event_queues:
                waiting.clear()
            for event in events:
                if isinstance(event, NmtStateChanged):
                    self._state_changed(event, now)
                elif isinstance(event, NmtResetRequested):
                    self._reset(event.command, now)
                else:
                    self.error_control.follow(event, now)
        if self.sync.event_queue.waiting:
            self.sync.event_queue.clear()
        if self.outbox.changed:
            self.outbox.changed = False
            self.pdos.send_changed(now)
        self._settling = False

    def _state_changed(self, event: NmtStateChanged, now: int) -> None:
        state = event.state
        self.outbox.publish(event)
        self.heartbeat.state = self.guarding.state = state
        self.emcy.allowed = state in (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL)
        if state is NmtState.OPERATIONAL and (self.program is None or self.program.runs):
            self.pdos.start(now)
        else:
            self.pdos.stop()
        if state is NmtState.STOPPED:
            self.sdo.reset()
            self.sync.reset()
        if state in (NmtState.STOPPED, NmtState.INITIALISING):
            for part in self._parts():
                part.communication_stopped(now)
        self.outbox.values_changed()

    def _reset(self, command: NmtCommand, now: int) -> None:
        """Restore the power-on values covered by `command` and boot again; a power-on counts as reset node."""
        everything = command is NmtCommand.RESET_NODE
        if self.lss is not None:
            self._assign(self.lss.reset(power=False))
        if self.program is not None and everything:
            self.program.reset()
        first, last = (0, 0xFFFF) if everything else (0x1000, 0x1FFF)
        self.store.defaults(first, last)
        self.pdos.stop()
        for core in (self.sdo, self.sync, self.guarding):
            core.reset()
        for node_id in self.consumer.watched():
            self.consumer.unwatch(node_id)
        if everything:
            self.emcy.reset()
            for part in self._parts():
                part.power_on(now)
        else:
            for code in self.emcy.active:
                if code == HEARTBEAT_ERROR or code >> 8 == PROTOCOL_ERRORS:
                    self.outbox.clear_error(code)
            for drive in self.drives.values():
                drive.power.communication_reset()
        self.heartbeat.state = self.guarding.state = NmtState.INITIALISING
        self.emcy.allowed = False
        self.routing.route_lss_only()
        delay = self.model.boot_ns if self._reset_delay_ns == 0 else self._reset_delay_ns
        self._boot_at = None if delay is None or self.node_id == UNCONFIGURED else now + delay

    def _boot(self, now: int) -> None:
        """Send the boot-up message and enter PRE-OPERATIONAL, which ends the initialisation."""
        self._boot_at = None
        self.emcy.allowed = True
        self.communication.apply()
        self.pdos.configure(now)
        by_dictionary = self.store.has(0x1F80) and not self.store.number(0x1F80) & 4
        self.nmt.self_starting = self.self_starting.value or by_dictionary
        self.nmt.boot()
        self.heartbeat.restart(now)
        self.routing.rebuild()

    def _start_with_node_id(self, node_id: int, now: int) -> None:
        """Initialise the node with the first node-ID assigned by LSS."""
        self._assign(node_id)
        self.nmt.state = NmtState.INITIALISING
        self._reset(NmtCommand.RESET_NODE, now)

    def _assign(self, node_id: int) -> None:
        """Change the node-ID, and the dictionary values that depend on $NODEID."""
        if node_id == self.node_id:
            return
        self.node_id, self.od = node_id, self.od.for_node(node_id)
        self.store.rebase(self.od)
        for core in (self.nmt, self.heartbeat, self.guarding, self.emcy, self.sdo):
            core.node_id = node_id
        self.sdo.request_cob_id, self.sdo.answer_cob_id = REQUEST_BASE + node_id, ANSWER_BASE + node_id
        self.outbox.publish(NodeIdChanged(node_id))

    def _reroute(self) -> None:  # for services that are created before `routing`
        self.routing.rebuild()
