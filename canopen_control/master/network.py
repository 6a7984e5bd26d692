"""NMT master of a bus, without I/O: processes received frames and supervises all nodes.

A received frame is routed by one look-up of its identifier and never raises an error, whatever its content; unexpected
frames are counted in `unknown`. TPDOs go straight to the process image, other frames to the `RemoteNode` of the sender.
`take` returns the frames to send, and `cycle` the RPDOs and SYNC.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.guarding import GuardingMaster
from canopen_control.cia301.heartbeat import HeartbeatConsumer, HeartbeatProducer
from canopen_control.cia301.nmt import NmtCommand, NmtState, nmt_frame, state_of_byte
from canopen_control.cia301.sync import SyncProducer
from canopen_control.frame import BROADCAST, RECORD, CanFrame, Service, cob_id, pack_records
from canopen_control.master.boot_config import value_of
from canopen_control.master.cycle import ProcessImage, share_objects
from canopen_control.master.event_log import Event, Level
from canopen_control.master.remote_node import RemoteNode
from canopen_control.master.supervision import BusReader, PdoWatch
from canopen_control.rpc.messages.fault import FaultEvent

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from canopen_control.master.boot import BootResult
    from canopen_control.master.config import BusConfig
    from canopen_control.master.cycle import ReceivedPdo, SentPdo


# Detection of other masters on the bus by frames that only a master sends.
#
# A port never receives the frames that were sent through it, so each of these frames is from another program. The
# frames of half a second are reported in one event with the identifiers, and again only after a minute without such
# frames. An SDO request or an NMT command may be from a tool; SYNC, RPDOs, and heartbeats with this master's node-ID or
# another customary node-ID of masters are from another master.


_GATHER_NS: Final = 500_000_000
_FORGET_NS: Final = 60_000_000_000
_EXAMPLES: Final = 4
_SYNCS: Final = 20  # SYNCs of the kernel; half as many more in that time are from another producer
_CUSTOMARY: Final = (1, 127)  # customary node-IDs of masters
_COMMANDS: Final = {int(command): command.name.lower().replace("_", " ") for command in NmtCommand}


class Evidence(enum.IntEnum):
    """Kinds of evidence of a second master, in ascending order of strength."""

    SDO = 1
    NMT = 2
    MASTER = 3


class _Sighting:
    """Frames with one identifier; `examples` describe their contents."""

    __slots__ = ("count", "evidence", "examples", "what")

    def __init__(self, evidence: Evidence, title: str) -> None:
        self.evidence, self.what, self.count = evidence, title, 0
        self.examples: list[str] = []

    def __str__(self) -> str:
        return f"{self.what} ({', '.join(self.examples) if self.examples else _times(self.count)})"


class SecondMasterDetector:
    """Detector of frames of a second master on the bus `name`; `wake` is called when `deadline` is set."""

    def __init__(self, name: str, report: Callable[[Event], None], wake: Callable[[], None]) -> None:
        self.deadline: int | None = None
        """Time of the next report by `tick`, or None if nothing is to be reported."""
        self._name, self._report, self._wake = name, report, wake
        self._sightings: dict[int, _Sighting] = {}
        self._reported = 0
        self._sync_since = self._syncs = 0
        self._last = -_FORGET_NS

    def record(self, can_id: int, evidence: Evidence, title: str, now: int, example: str = "") -> None:
        """Record a frame of another master or tool; `title` and `example` describe it."""
        if now - self._last >= _FORGET_NS:
            self._reported = 0
            self._sightings.clear()
        self._last = now
        sighting = self._sightings.get(can_id)
        if sighting is None:
            sighting = self._sightings[can_id] = _Sighting(evidence, title)
        sighting.count += 1
        if example and example not in sighting.examples and len(sighting.examples) < _EXAMPLES:
            sighting.examples.append(example)
        if evidence > self._reported and self.deadline is None:
            self.deadline = now + _GATHER_NS
            self._wake()

    def tick(self, now: int) -> None:
        """Report the recorded frames once the deadline has passed."""
        if self.deadline is None or now < self.deadline:
            return
        self.deadline = None
        clearest = max(identifiers.evidence for identifiers in self._sightings.values())
        self._reported = clearest
        identifiers = ", ".join(str(self._sightings[can_id]) for can_id in sorted(self._sightings))
        kind, level, text = _REPORTS[clearest]
        details = FaultEvent(identifiers=tuple(f"0x{can_id:03X}" for can_id in sorted(self._sightings)))
        self._report(Event(now, kind, "", text.format(bus=self._name, seen=identifiers), level, details))

    def handlers(
        self, own_id: int, sync: int, nodes: dict[int, RemoteNode]
    ) -> Iterator[tuple[int, Callable[[bytes, int, int], None]]]:
        """Yield identifiers and handlers of frames that only a master sends, except RPDOs."""
        yield 0, self._on_nmt
        yield sync, self._handler(sync, Evidence.MASTER, f"SYNC 0x{sync:03X}")
        for node_id in {own_id, *_CUSTOMARY} - nodes.keys():
            can_id = cob_id(Service.HEARTBEAT, node_id)
            owner = "this master's own node-ID" if node_id == own_id else f"node {node_id}"
            yield can_id, self._handler(can_id, Evidence.MASTER, f"heartbeat 0x{can_id:03X} of {owner}")
        for node in nodes.values():
            can_id = cob_id(Service.SDO_CLIENT, node.node_id)
            yield can_id, self._on_sdo(can_id, node)

    def on_rpdo(self, can_id: int, node: RemoteNode) -> Callable[[bytes, int, int], None]:
        """Return the handler for a node's RPDO; such a frame can only come from another master."""
        return self._handler(can_id, Evidence.MASTER, f"RPDO 0x{can_id:03X} of {node.label}")

    def on_expected_sync(self, can_id: int, period_ns: int, now: int, late: bool) -> None:
        """Count a SYNC of the kernel or of a node; surplus SYNCs are evidence of another producer."""
        if late or now - self._sync_since >= _SYNCS * period_ns:  # frames that were read together show no rate
            self._sync_since, self._syncs = now, 0
        self._syncs += 1
        if self._syncs > _SYNCS + _SYNCS // 2:
            self.record(can_id, Evidence.MASTER, f"SYNC 0x{can_id:03X} in addition to the kernel's", now)

    def _handler(self, can_id: int, evidence: Evidence, title: str) -> Callable[[bytes, int, int], None]:
        return lambda _data, _length, now: self.record(can_id, evidence, title, now)

    def _on_sdo(self, can_id: int, node: RemoteNode) -> Callable[[bytes, int, int], None]:
        """Return the handler for SDO requests by other programs to a node; they count only while the node is ready."""
        title = f"SDO 0x{can_id:03X} to {node.label}"
        return lambda _data, _length, now: self.record(can_id, Evidence.SDO, title, now) if node.ready else None

    def _on_nmt(self, data: bytes, length: int, now: int) -> None:
        example = data[:length].hex() or "empty"
        if length == 2:
            name = _COMMANDS.get(data[0], f"0x{data[0]:02X}")
            example = f"{name}, {f'node {data[1]}' if data[1] else 'all nodes'}"
        self.record(0, Evidence.NMT, "NMT 0x000", now, example)


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


_REPORTS: Final = {
    Evidence.SDO: (
        "other_sdo_client",
        Level.INFO,
        "bus {bus}: another program reads or writes objects: {seen}; the answers to both can be confused",
    ),
    Evidence.NMT: (
        "other_master",
        Level.WARNING,
        "bus {bus}: another program commands nodes: {seen}; unless it is your tool, another master is active",
    ),
    Evidence.MASTER: (
        "other_master",
        Level.WARNING,
        "bus {bus}: another master is active: {seen}; two masters contend for the drives; end one of them",
    ),
}


_OPERATIONAL: Final = NmtState.OPERATIONAL  # a constant, for speed, see `hardware.interfaces.OK`
_DEFAULT_TPDOS: Final = {number: Service[f"TPDO{number}"] for number in range(1, 5)}
REFRESH_NS = 100_000_000  # period in which an unchanged RPDO is repeated
TIMERS_MISSED = 3  # event timer periods without the TPDO after which its values are stale


class Network:
    """NMT master with all nodes of a bus.yml; `report` receives the events."""

    def __init__(self, name: str, config: BusConfig, report: Callable[[Event], None], cycle_ns: int) -> None:
        self.name, self.config, self._cycle_ns = name, config, cycle_ns
        self.unknown = 0
        self.reader: BusReader | None = None
        self.sync = SyncProducer(overflow=config.master.sync_overflow)
        self.image = ProcessImage(refresh=max(1, REFRESH_NS // cycle_ns))
        self.outgoing: list[CanFrame] = []
        """Frames waiting for `take`."""
        self._watch_ns = config.master.sync_period * 1000 or cycle_ns  # a bus without SYNC: timed TPDOs alone
        self.pdo_watch = PdoWatch(self._watch_ns)
        self._since: int | None = None  # time at which no frame waited to be read, if the process is late
        self._pdo_owner: dict[ReceivedPdo, RemoteNode] = {}
        self._last_records = b""  # last received records; drives at standstill repeat the same
        self._repeated: list[ReceivedPdo] | None = None  # TPDOs in `_last_records`, after a repetition
        self._to_boot: list[RemoteNode] = []
        self._guarding: GuardingMaster | None = None
        self._sync_elsewhere = False
        self._sync_record = b""
        if not config.master.sync_overflow:
            frame = self.sync.frame()
            self._sync_record = RECORD.pack(frame.can_id, len(frame.data), frame.data)
        self._consumer = HeartbeatConsumer()
        self._producer = HeartbeatProducer(config.master.node_id, config.master.heartbeat_ms * 1_000_000)
        self.report = report
        self._deadline: int | None = None
        self._stale = True  # whether `_deadline` must be computed again
        self.nodes = {name: self._node(name) for name in config.nodes}
        self._by_id = {node.node_id: node for node in self.nodes.values()}
        self._handlers: dict[int, Callable[[bytes, int, int], None]] = {}
        self._pdos: dict[int, ReceivedPdo] = {}
        self._foreign = SecondMasterDetector(name, report, self.wake)
        for node in self.nodes.values():
            self._connect(node)
        for node in self.nodes.values():
            self._watch_defaults(node)
        for can_id, handler in self._foreign.handlers(config.master.node_id, self.sync.cob_id, self._by_id):
            self._handlers.setdefault(can_id, handler)

    def start(self, now: int) -> None:
        """Send the master's boot-up message and start the boot of every node with `boot: true`."""
        self._producer.boot_up(now)
        self._producer.state = NmtState.OPERATIONAL
        self.outgoing.extend(self._producer.frames())
        for node in self.nodes.values():
            if node.config.boot.enabled:
                node.begin_boot(now)
        self._collect()

    @property
    def waits(self) -> bool:
        """Whether received frames must be processed at once: with guarding, a pending response or a node not ready."""
        return self._guarding is not None or any(not node.ready or node.sdo.busy for node in self._by_id.values())

    @property
    def identifiers(self) -> Collection[int]:
        """CAN identifiers that `receive` processes."""
        return self._handlers.keys()

    def receive(self, records: bytes, now: int, since: int | None = None) -> None:
        """Process received records; `since` is given after a delay: the frames arrived between `since` and `now`."""
        self._since, stamp = since, now if since is None else since
        if records == self._last_records:
            if self._repeated is None:
                self._repeated = self._pdos_of(records)
            if self._repeated:
                for received in self._repeated:
                    received.stamp = stamp
                    received.count += 1
                return
        else:
            self._last_records, self._repeated = records, None
        handlers, pdos = self._handlers, self._pdos
        for can_id, length, data in RECORD.iter_unpack(records):
            pdo = pdos.get(can_id)
            if pdo is not None and length == pdo.length:
                pdo.values, pdo.stamp = pdo.unpack(data), stamp  # as `ReceivedPdo.receive` does, without the calls
                pdo.count += 1
            elif (handler := handlers.get(can_id)) is None:
                self.unknown += 1
            else:
                handler(data, length, now)

    def _pdos_of(self, records: bytes) -> list[ReceivedPdo]:
        """Return the TPDOs of the records in order; [] if any record is another frame or has an unexpected length."""
        received = []
        for can_id, length, _ in RECORD.iter_unpack(records):
            pdo = self._pdos.get(can_id)
            if pdo is None or length != pdo.length:
                return []
            received.append(pdo)
        return received

    def tick(self, now: int) -> None:
        """Process the timeouts up to `now`, in monotonic ns; fast if none is due."""
        if self._stale:
            self._deadline, self._stale = self._earliest(), False
        if self._deadline is None or now < self._deadline:
            return
        self._producer.tick(now)
        self._consumer.tick(now)
        if self._guarding is not None:
            self._guarding.tick(now)
        self._supervise(now)
        self._foreign.tick(now)
        for node in self.nodes.values():
            node.tick(now)
        self._collect()

    def was_away(self, nanoseconds: int) -> None:
        """Postpone the guarding deadlines after this process was suspended for `nanoseconds`."""
        if self._guarding is not None:
            self._guarding.postpone(nanoseconds)
            self._stale = True

    def without_master(self, now: int, since: int) -> list[RemoteNode]:
        """Return the ready nodes that have missed this master for their timeout, because it sent nothing from `since`.

        They have reacted to that (0x6007, 0x1029) before they show it: without SYNCs they send no statusword.
        """
        silences = {node: self._silence_ns(node, now, since) for node in self.nodes.values() if node.ready}
        return [node for node, silence in silences.items() if 0 < node.plan.master_timeout_ns <= silence]

    def _silence_ns(self, node: RemoteNode, now: int, since: int) -> int:
        guard = node.plan.guard
        return self._producer.silence_ns(now) if guard is None else now - since + guard[0]

    def next_deadline(self) -> int | None:
        """Return the time of the next `tick`, or None if not needed."""
        if self._stale:
            self._deadline, self._stale = self._earliest(), False
        return self._deadline

    def take(self) -> bytes:
        """Return and clear the records of the waiting frames, without process data."""
        if not self.outgoing:
            return b""
        records = pack_records(self.outgoing)
        self.outgoing.clear()
        return records

    def cycle(self, *, sync: bool) -> bytes:
        """Return the records of one cycle: the RPDOs that are due, then SYNC if requested and produced here."""
        return self.image.collect(self.sync_record() if sync else b"")

    def sync_record(self) -> bytes:
        """Return the record of the next SYNC, or b"" if the kernel or a node produces SYNC."""
        if self._sync_elsewhere:
            return b""
        if self._sync_record:
            return self._sync_record
        frame = self.sync.frame()
        return RECORD.pack(frame.can_id, len(frame.data), frame.data)

    def synced(self, now: int) -> None:
        """Check, after a SYNC (or a cycle of a bus without SYNC), whether the TPDOs due before have arrived."""
        if changed := self.pdo_watch.sync(now):
            for pdo in changed:
                self._pdo_owner[pdo].on_pdo(pdo, now)

    def hear_sync(self, on_sync: Callable[[int], None]) -> None:
        """Stop producing SYNC, and call `on_sync(now)` for every SYNC of another producer."""
        self._sync_elsewhere = True
        can_id, period = self.sync.cob_id, self.config.master.sync_period * 1000

        def receive(_data: bytes, _length: int, now: int) -> None:
            on_sync(now)
            self._foreign.on_expected_sync(can_id, period, now, self._since is not None)

        self._handlers[can_id] = receive

    def bus_failed(self, text: str, now: int) -> None:
        """Mark all ready and booting nodes as lost because the bus has failed; `bus_back` boots them again."""
        for node in self.nodes.values():
            if node.ready or node.boot_step:
                node.lost(now, text)
                self._to_boot.append(node)

    def bus_back(self, now: int) -> None:
        """Boot the nodes that were lost with the bus."""
        nodes, self._to_boot = self._to_boot, []
        for node in nodes:
            node.begin_boot(now)
        self._collect()

    def send_nmt(self, command: NmtCommand, node_id: int = BROADCAST) -> None:
        """Queue an NMT command for a node, or for all nodes."""
        self.outgoing.append(nmt_frame(command, node_id))

    def changed(self) -> None:
        """Collect the frames to send after a call outside the cycle, such as an SDO request or a command."""
        self._collect()

    def _node(self, name: str) -> RemoteNode:
        config = self.config
        node = RemoteNode(config.nodes[name], config.plans[name], config.dictionaries[name], self)
        for layout in node.plan.tpdos:
            pdo = self.image.add_tpdo(node.node_id, layout.cob_id, layout.objects, layout.transmission_type)
            pdo.allow(node.config.supervision.missed_syncs)
            pdo.age_limit_ns = 0 if pdo.every else TIMERS_MISSED * layout.event_ms * 1_000_000
            node.received.append(pdo)
            settings = node.config.boot.tpdo.get(layout.number)
            if node.plan.axes and settings is not None and settings.event_timer:
                pdo.supervise_timer(self._watch_ns)
            if config.master.sync_period or not pdo.every:
                self.pdo_watch.add(pdo)
            self._pdo_owner[pdo] = node
        for layout in node.plan.rpdos:
            deadline = layout.event_ms * 1_000_000 // self._cycle_ns
            if layout.event_ms:
                deadline = max(1, deadline)
            sent = self.image.add_rpdo(
                node.node_id, layout.cob_id, layout.objects, layout.transmission_type, deadline=deadline
            )
            node.sent.append(sent)
        if node.plan.motors is not None:
            share_objects(self.image, node.node_id, node.plan.motors)
        return node

    def _connect(self, node: RemoteNode) -> None:
        handlers, node_id = self._handlers, node.node_id
        sdo, emcy = cob_id(Service.SDO_SERVER, node_id), cob_id(Service.EMCY, node_id)
        error_control = cob_id(Service.HEARTBEAT, node_id)

        def on_sdo(data: bytes, length: int, now: int) -> None:
            node.sdo.receive(CanFrame(sdo, data[:length]), now)
            node.pump(now)
            self._collect_from(node)

        def on_emcy(data: bytes, length: int, now: int) -> None:
            node.on_emcy(CanFrame(emcy, data[:length]), now)
            self._stale = True

        def on_heartbeat(data: bytes, length: int, now: int) -> None:
            usual = length == 1 and data[0] == _OPERATIONAL and node.ready and self._guarding is None
            if usual and self._consumer.record_unchanged(node_id, _OPERATIONAL, now, self._since):
                node.nmt_state, node.last_seen = _OPERATIONAL, now  # as `on_state` does while it is ready
                node.log.heartbeat(now, self._since)
                return
            node.log.check_heartbeat(length, now)
            frame = CanFrame(error_control, data[:length])
            self._consumer.receive(frame, now, self._since)
            if self._guarding is not None:
                self._guarding.receive(frame, now, self._since)
            changed = self._supervise(now, self._since)
            if length == 1 and data[0] & 0x7F:
                node.on_state(state_of_byte(data[0] & 0x7F), now, self._since)
            if changed or not node.ready:  # else only the heartbeat deadline is later, which `tick` detects
                self._collect_from(node)

        handlers[sdo], handlers[emcy], handlers[error_control] = on_sdo, on_emcy, on_heartbeat
        for pdo in node.received:
            handlers[pdo.cob_id] = self._checked(node, pdo)
            self._pdos[pdo.cob_id] = pdo
        for sent in node.sent:
            handlers.setdefault(sent.cob_id, self._on_foreign_rpdo(sent, node))

    def _on_foreign_rpdo(self, sent: SentPdo, node: RemoteNode) -> Callable[[bytes, int, int], None]:
        """Return the handler for an RPDO that another program sends."""
        report = self._foreign.on_rpdo(sent.cob_id, node)

        def on_rpdo(data: bytes, length: int, now: int) -> None:
            report(data, length, now)
            if node.ready and sent.enabled and sent.repeated and not sent.was_sent(data[:length]):
                sent.changed = True  # sent again, even if its values are unchanged
                node.contradicted += 1

        return on_rpdo

    def lay_out(self, node: RemoteNode, result: BootResult) -> None:
        """Set up a node's process data as configured by the boot, with the initial values read from the node."""
        self._last_records, self._repeated = b"", None  # the handlers and values change
        adopted = {(kind, layout.number): layout for kind, layout in result.adopted}
        for planned, received in zip(node.plan.tpdos, node.received, strict=True):
            layout = adopted.get(("tpdo", planned.number), planned)
            if (received.cob_id, received.codec.objects) != (layout.cob_id, layout.objects):
                self._handlers.pop(received.cob_id, None)
                self._pdos.pop(received.cob_id, None)
                received.use(layout, planned.objects)
                self._handlers[received.cob_id] = self._checked(node, received)
                self._pdos[received.cob_id] = received
                self._reroute()
        for planned, sent in zip(node.plan.rpdos, node.sent, strict=True):
            layout = adopted.get(("rpdo", planned.number), planned)
            if (sent.cob_id, sent.codec.objects) != (layout.cob_id, layout.objects):
                if sent.cob_id not in self._pdos:
                    self._handlers.pop(sent.cob_id, None)
                sent.use(layout, self.image.outputs_of(node.node_id, layout.objects))
                self._handlers.setdefault(sent.cob_id, self._on_foreign_rpdo(sent, node))
                self._reroute()
        self.image.preset(node.node_id, result.presets)

    def _reroute(self) -> None:
        if self.reader is not None:
            self.reader.follow_identifiers()

    def written(self, node: RemoteNode, index: int, subindex: int, data: bytes) -> None:
        """Copy a value written by SDO into the RPDOs that map the object, so that the next RPDO does not revert it."""
        output = self.image.output(node.node_id, index, subindex)
        if output is None or output.driven:
            return
        mapped = next(entry for sent in node.sent for entry in sent.codec.objects if entry[:2] == (index, subindex))
        if (value := value_of(mapped, data)) is not None:
            output.record(value)

    def _watch_defaults(self, node: RemoteNode) -> None:
        """Detect nodes that send a TPDO with its default COB-ID instead of the configured one.

        durand 0.5.0 (PyPI) returns to the default at NMT start, although it accepts every write before that.
        """
        for layout, pdo in zip(node.plan.tpdos, node.received, strict=True):
            service = _DEFAULT_TPDOS.get(layout.number)
            default = None if service is None else cob_id(service, node.node_id)
            if default is None or default == pdo.cob_id or default in self._handlers:
                continue

            def on_default_identifier(
                _data: bytes, _length: int, _now: int, pdo: ReceivedPdo = pdo, default: int = default
            ) -> None:
                if pdo.expected:
                    node.log.astray[pdo] = default

            self._handlers[default] = on_default_identifier

    def _checked(self, node: RemoteNode, pdo: ReceivedPdo) -> Callable[[bytes, int, int], None]:
        """Return a TPDO handler that also reports frames of the wrong length."""
        right, receive = pdo.codec.length, pdo.receive

        def on_pdo(data: bytes, length: int, now: int) -> None:
            receive(data, length, now)
            if length != right and pdo.expected:
                node.log.malformed(pdo, length, now)

        return on_pdo

    def wake(self) -> None:
        """Recalculate the time of the next `tick` after a deadline has changed."""
        self._stale = True

    def watch_heartbeat(self, node_id: int, timeout_ns: int) -> None:
        """Monitor a node's heartbeat from the next heartbeat on; 0 ends monitoring."""
        self._consumer.watch(node_id, timeout_ns)

    def guard(self, node: RemoteNode, on: bool, now: int) -> None:
        """Start or stop node guarding if the node's plan has guarding."""
        if node.plan.guard is None:
            return
        if self._guarding is None:
            self._guarding = GuardingMaster()
        if on:
            self._guarding.watch(node.node_id, *node.plan.guard, now)
        else:
            self._guarding.unwatch(node.node_id)
        self._stale = True

    def _supervise(self, now: int, since: int | None = None) -> bool:
        """Pass events of heartbeat and guarding supervision to the nodes; return whether any occurred."""
        events = self._consumer.events()
        changed = bool(events)
        for guarded in self._guarding.events() if self._guarding is not None else ():
            changed = True
            if (node := self._by_id.get(guarded.node_id)) is not None:
                node.on_guarding(guarded, now)
        for event in events:
            if (node := self._by_id.get(event.node_id)) is not None:
                node.on_heartbeat(event, now, since)
        return changed

    def _collect(self) -> None:
        self.outgoing.extend(self._producer.frames())
        if self._guarding is not None:
            self.outgoing.extend(self._guarding.frames())
        for node in self.nodes.values():
            self._collect_from(node)

    def _collect_from(self, node: RemoteNode) -> None:
        self.outgoing.extend(node.sdo.frames())
        self._stale = True

    def _earliest(self) -> int | None:
        deadlines = [self._producer.next_deadline(), self._consumer.next_deadline(), self._foreign.deadline]
        if self._guarding is not None:
            deadlines.append(self._guarding.next_deadline())
        deadlines.extend(node.next_deadline() for node in self.nodes.values())
        return min((deadline for deadline in deadlines if deadline is not None), default=None)
