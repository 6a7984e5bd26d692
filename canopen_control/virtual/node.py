"""The slave side of CiA 301 on one object dictionary: a node that any master can talk to.

The law of this file: it boots with the boot-up message into PRE-OPERATIONAL and goes on only when commanded (or by
itself where its dictionary says so, 0x1F80). Which service exists in which state is the table of `cia301.nmt`.
Frames reach the node by identifier through `routes`; `routes_version` tells when they changed. Reset node restores all
power-on values, reset communication those of 0x1000 to 0x1FFF. What happens between two events costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.emcy import EmcyProducer
from canopen_control.cia301.emcy_codes import ErrorRegister
from canopen_control.cia301.guarding import GuardingSlave
from canopen_control.cia301.heartbeat import HeartbeatConsumer, HeartbeatProducer
from canopen_control.cia301.lss import MASTER_COB_ID, UNCONFIGURED
from canopen_control.cia301.nmt import NmtCommand, NmtSlave, NmtState
from canopen_control.cia301.sdo_codec import ANSWER_BASE, REQUEST_BASE
from canopen_control.cia301.sdo_server import SdoServer
from canopen_control.cia301.sync import SyncConsumer, SyncEventKind
from canopen_control.cia402 import objects as o
from canopen_control.frame import REMOTE_FLAG, CanFrame
from canopen_control.virtual.communication import CommunicationObjects
from canopen_control.virtual.consequences import HEARTBEAT_ERROR, Consequences
from canopen_control.virtual.events import EmergencyRaised, NodeIdChanged
from canopen_control.virtual.lss import NodeLss
from canopen_control.virtual.pdos import ProcessData
from canopen_control.virtual.personality import GENERIC, Personality
from canopen_control.virtual.routing import merged
from canopen_control.virtual.store import ObjectStore

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.bus.port import BusEventKind
    from canopen_control.od.model import Entry, ObjectDictionary, Value
    from canopen_control.virtual.drive import VirtualDrive
    from canopen_control.virtual.routing import Receiver, Route
    from canopen_control.virtual.switchboard import FaultSwitches

__all__ = ["VirtualNode"]

_MOST_WAITING = 1000  # events, and frames of injected faults
SYNC_LENGTH_ERROR = 0x8240


class VirtualNode:
    """One node; `serial` (default: the node id) fills 0x1018:04 where the file has none.

    `reset_delay_ns` goes before the boot-up message; None: it never boots. `filter` is for injected faults.
    """

    def __init__(
        self, od: ObjectDictionary, node_id: int, *, serial: int | None = None, personality: Personality = GENERIC
    ) -> None:
        self.od, self.node_id, self.personality = od, node_id, personality
        self.now = 0
        self.store = ObjectStore(od)
        self.nmt = NmtSlave(node_id)
        self.heartbeat = HeartbeatProducer(node_id)
        self.consumer = HeartbeatConsumer()
        self.guarding = GuardingSlave(node_id)
        self.emcy = EmcyProducer(node_id, history_size=max(1, len(od.subindices(0x1003)) - 1))
        self.sync = SyncConsumer()
        self.sdo = SdoServer(node_id, self.store)
        self.drives: dict[int, VirtualDrive] = {}
        self.filter: FaultSwitches | None = None
        self.reset_delay_ns: int | None = 0
        self.clock_ppm = 0.0  # how much faster its clock is
        self.routes_version = 0
        self._routes: dict[int, Receiver] = {}
        self._boot_at: int | None = 0
        self._started = False
        self.events_lost = self.frames_lost = 0  # nobody fetched them
        self._sent: list[CanFrame] = []
        self.self_starting = False  # OPERATIONAL without a command, whatever the dictionary says
        self.clears_on_reset_communication: set[int] = set()  # causes of faults
        self.switches: FaultSwitches | None = None
        self._on_stored: Callable[[], bool] | None = None
        self._events: list[object] = []
        self.communication = CommunicationObjects(self)
        self.communication.identify(node_id if serial is None else serial)
        self.pdos = ProcessData(self)
        self.consequences = Consequences(self)
        self.lss = NodeLss(self) if od.device.lss_supported else None

    # -- the sans-IO verbs

    def receive(self, frame: CanFrame, now: int) -> None:
        """Take a frame; one that is not the node's is ignored."""
        self._advance(now)
        if self.filter is not None:
            heard = self.filter.incoming(frame, now)
            if heard is None:
                return
            frame = heard
        route = self._routes.get(frame.can_id)
        if route is not None:
            route(frame, now)
            self.consequences.settle(now)

    def receive_records(self, records: bytes, start: int, now: int) -> int:
        """Take a run of segments as `SdoServer.receive_records` does; 0 too where a frame is more than the server's."""
        alone = self.filter is None and self._routes.get(self.sdo.request_cob_id) == self._on_sdo
        return self.sdo.receive_records(records, start, now) if alone and self.nmt.state is not NmtState.STOPPED else 0

    def tick(self, now: int) -> None:
        """Let time pass; the first call is the power-on."""
        self._advance(now)
        if self.filter is not None:
            self.filter.tick(now)
        if self._boot_at is not None and now >= self._boot_at:
            self._boot(now)
        self.advance_drives(now)
        for core in (self.heartbeat, self.consumer, self.guarding, self.emcy, self.sync, self.sdo, self.pdos):
            core.tick(now)
        self.consequences.settle(now)

    def next_deadline(self) -> int | None:
        """Return when `tick` has something to do, None: nothing will happen by itself."""
        cores = (self.heartbeat, self.consumer, self.guarding, self.emcy, self.sync, self.sdo, self.pdos)
        deadlines = [core.next_deadline() for core in cores]
        deadlines += [drive.next_deadline() for drive in self.drives.values()]
        deadlines.append(self._boot_at)
        if self.filter is not None:
            deadlines.append(self.filter.next_deadline())
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def frames(self) -> list[CanFrame]:
        """Drain what to send."""
        frames = self.nmt.frames() + self.emcy.frames() + self.heartbeat.frames() + self.guarding.frames()
        frames += self.pdos.frames() + self.sdo.frames()
        if self.lss is not None:
            frames += self.lss.frames()
        if self._sent:
            frames += self._sent
            self._sent = []
        return frames if self.filter is None else self.filter.outgoing(frames, self.now)

    def events(self) -> list[object]:
        """Drain what happened, in order."""
        events, self._events = self._events, []
        return events

    def routes(self) -> Iterable[int]:
        """Return the identifiers, with linux/can.h's flags, that the node listens to."""
        return self._routes.keys()

    def send(self, frame: CanFrame) -> None:
        """Put a frame of somebody else's making on the wire."""
        if len(self._sent) < _MOST_WAITING:
            self._sent.append(frame)
        else:
            self.frames_lost += 1

    # -- what its parts ask and tell

    @property
    def name(self) -> str:
        """What kind of device it is, for people."""
        return self.personality.name or self.od.device.product_name or "node"

    @property
    def operational(self) -> bool:
        """Whether process data count."""
        return self.nmt.state is NmtState.OPERATIONAL

    @property
    def has_event_pdos(self) -> bool:
        """Whether a TPDO waits for values that change with a motion."""
        return self.pdos.has_event_pdos and self.operational

    def attach(self, drive: VirtualDrive) -> None:
        """Make `drive` the axis it says it is."""
        self.drives[drive.axis] = drive

    def get(self, index: int, subindex: int = 0) -> Value:
        """Return the present value of an object; KeyError where there is none."""
        return self.store.get(index, subindex)

    def set(self, index: int, subindex: int, value: Value) -> None:
        """Set an object past all rules, as the device's own firmware does."""
        self.store.set(index, subindex, value)

    def on_write(self, index: int, watcher: Callable[[Entry, Value], None]) -> None:
        """Let `watcher` hear of values written to `index` by SDO or RPDO."""
        self.store.on_write([index], watcher)

    def on_read(self, index: int, subindex: int, source: Callable[[], Value]) -> None:
        """Let `source` make the value of an object."""
        self.store.on_read(index, subindex, source)

    def on_stored(self, callback: Callable[[], bool]) -> None:
        """Let `callback` hear when 0x1010, 0x1011 or LSS changed what outlasts the power; it returns: it is kept."""
        self._on_stored = callback

    def stored(self) -> bool:
        """Say that what outlasts the power changed; return whether it is kept."""
        return self._on_stored is None or self._on_stored()

    def touch(self) -> None:
        """Say that values changed which nobody wrote; event-driven PDOs look at them when the event is over."""
        self.consequences.touched = True

    def tell(self, event: object) -> None:
        """Note an event for whoever shows them."""
        if len(self._events) < _MOST_WAITING:
            self._events.append(event)
        else:
            self.events_lost += 1

    def emergency(self, code: int, register: int, data: bytes = b"") -> None:
        """Raise an error that stays until it is cleared; one that is active already is not said again."""
        if self.emcy.raise_error(code, int(register), self.now, data):
            self.tell(EmergencyRaised(code, data))
        self.touch()

    def report(self, code: int, register: int, data: bytes = b"") -> None:
        """Say an error that does not stay."""
        self.emcy.report(code, self.now, data, register=int(register))
        self.tell(EmergencyRaised(code, data))

    def clear_errors(self) -> None:
        """Clear every error but that of a communication still lost (transition 15)."""
        for code in self.emcy.active:
            if code != HEARTBEAT_ERROR:
                self.clear_error(code)

    def clear_error(self, code: int) -> None:
        """Clear one error; no-op where it is not active."""
        if self.emcy.clear_error(code, self.now):
            self.tell(EmergencyRaised(0))
            self.touch()

    def rpdo_failed(self, code: int) -> None:
        """Report an RPDO of the wrong length, or too late."""
        self.report(code, ErrorRegister.COMMUNICATION)

    def rpdo_value_refused(self) -> None:
        """Report an RPDO whose value was not taken, where the device says so."""
        if self.personality.rpdo_error is not None:
            code, data = self.personality.rpdo_error
            self.report(code, ErrorRegister.GENERIC, data)

    def values_taken(self, taken: list[tuple[Entry, Value]], now: int) -> None:
        """Act on the values of one RPDO, which are all in place: each axis once, its controlword last."""
        axes: dict[int, bool] = {}
        for entry, value in taken:
            base, axis = o.axis_of(entry.index)
            if axis in self.drives and base >= 0x6000:
                axes[axis] = axes.get(axis, False) or base == o.CONTROLWORD
            else:
                self.store.notify(entry, value)
        for axis, controlword in axes.items():
            self.drives[axis].refresh(now, controlword=controlword)

    def stop_missing(self) -> None:
        """Forget the error of nodes that are silent when none is any more: heard again, or not watched."""
        if not any(self.consumer.is_missed(node_id) for node_id in self.consumer.watched()):
            self.clear_error(HEARTBEAT_ERROR)

    def follow(self, now: int) -> None:
        """Follow up what was done to the node from outside: send what changed, tick what is due."""
        if not self.consequences.settling:
            self.tick(now)

    def advance_drives(self, now: int) -> None:
        """Bring all axes to `now`."""
        for drive in self.drives.values():
            drive.advance(now)

    # -- life

    def reset(self, command: NmtCommand, now: int) -> None:
        """Restore power-on values as `command` says and boot again; the power-on itself is a reset node."""
        everything = command is NmtCommand.RESET_NODE
        if self.lss is not None:
            self._assign(self.lss.reset(power=False))
        self.store.defaults(0x1000 if not everything else 0, 0x1FFF if not everything else 0xFFFF)
        self.pdos.stop()
        for core in (self.sdo, self.sync, self.guarding):
            core.reset()
        for node_id in self.consumer.watched():
            self.consumer.unwatch(node_id)
        if everything:
            self.emcy.reset()
            for drive in self.drives.values():
                drive.power_on(now)
        else:
            self.clear_error(HEARTBEAT_ERROR)
            for drive in self.drives.values():
                drive.power.causes -= self.clears_on_reset_communication
        self.heartbeat.state = self.guarding.state = NmtState.INITIALISING
        self.emcy.allowed = False
        self._routes = self._lss_routes()
        self.routes_version += 1
        delay = self.personality.boot_ns if self.reset_delay_ns == 0 else self.reset_delay_ns
        self._boot_at = None if delay is None or self.node_id == UNCONFIGURED else now + delay

    def power_on(self, now: int) -> None:
        """Switch on, or off and on again (brown-out): everything not stored is gone."""
        self._advance(now)
        if self.lss is not None:
            self.lss.reset(power=True)
        self.nmt.state = NmtState.INITIALISING
        self.nmt.events()
        self.reset(NmtCommand.RESET_NODE, now)
        self.consequences.settle(now)

    def power_up_with(self, node_id: int, now: int) -> None:
        """Begin to live with a first node id, given by LSS."""
        self._assign(node_id)
        self.nmt.state = NmtState.INITIALISING
        self.reset(NmtCommand.RESET_NODE, now)

    def _assign(self, node_id: int) -> None:
        """Be another node from the next boot-up on; $NODEID of the dictionary follows."""
        if node_id == self.node_id:
            return
        self.node_id, self.od = node_id, self.od.for_node(node_id)
        self.store.rebase(self.od)
        for core in (self.nmt, self.heartbeat, self.guarding, self.emcy, self.sdo):
            core.node_id = node_id
        self.sdo.request_cob_id, self.sdo.answer_cob_id = REQUEST_BASE + node_id, ANSWER_BASE + node_id
        self.tell(NodeIdChanged(node_id))

    def bus_event(self, kind: BusEventKind, now: int) -> None:
        """React to what happened to the node's CAN controller."""
        self._advance(now)
        self.advance_drives(now)
        self.consequences.bus_event(kind, now)

    def command(self, command: NmtCommand, now: int) -> None:
        """Obey an NMT command of the node's own."""
        self._advance(now)
        self.nmt.command(command)
        self.consequences.settle(now)

    def set_reset_delay(self, delay_ns: int | None, now: int) -> None:
        """Change the time from a reset to the boot-up (None: never), also of a boot under way."""
        self.reset_delay_ns = delay_ns
        if self.nmt.state is NmtState.INITIALISING:
            self._boot_at = None if delay_ns is None else now + delay_ns

    def _advance(self, now: int) -> None:
        if not self._started:  # power-on: without a delay before the first boot-up
            self._started, self.now = True, now
            self.reset(NmtCommand.RESET_NODE, now)
            if self._boot_at is not None and self.reset_delay_ns == 0:
                self._boot_at = now
        self.now = max(now, self.now)

    def _boot(self, now: int) -> None:
        """End the initialisation: the boot-up message, PRE-OPERATIONAL."""
        self._boot_at = None
        self.emcy.allowed = True
        self.communication.apply()
        self.pdos.configure(now)
        by_dictionary = self.store.has(0x1F80) and not self.store.number(0x1F80) & 4
        self.nmt.self_starting = self.self_starting or by_dictionary
        self.nmt.boot()
        self.heartbeat.started(now)
        self.reroute()

    def reroute(self) -> None:
        """Make the routes anew: an identifier changed."""
        if self.nmt.state is NmtState.INITIALISING:
            return
        error_control = 0x700 + self.node_id
        routes: list[Route] = [
            *self._lss_routes().items(),
            (0x000, self.nmt.receive),
            (self.sdo.request_cob_id, self._on_sdo),
            (error_control | REMOTE_FLAG, self.guarding.receive),
            (self.sync.cob_id, self._on_sync),
            *((0x700 + node_id, self.consumer.receive) for node_id in self.consumer.watched()),
            *self.pdos.routes(),
        ]
        table = merged(routes)
        if table.keys() != self._routes.keys():
            self.routes_version += 1
        self._routes = table

    def _lss_routes(self) -> dict[int, Receiver]:
        return {} if self.lss is None else {MASTER_COB_ID: self.lss.receive}

    def _on_sdo(self, frame: CanFrame, now: int) -> None:
        if self.nmt.state is not NmtState.STOPPED:
            self.sdo.receive(frame, now)

    def _on_sync(self, frame: CanFrame, now: int) -> None:
        if self.nmt.state is NmtState.STOPPED:
            return
        self.advance_drives(now)
        self.sync.receive(frame, now)
        for event in self.sync.events():
            if event.kind is SyncEventKind.LENGTH_ERROR:
                self.report(SYNC_LENGTH_ERROR, ErrorRegister.COMMUNICATION)
            elif event.kind is SyncEventKind.SYNC and self.operational:
                self.pdos.sync(event.counter, now)
