"""Node from the NMT master's point of view: presence, boot, supervision and events.

A node is READY from the end of a successful boot until it is lost (no heartbeat, an unexpected boot-up or NMT state).
The end of READY invalidates the process data and restarts the boot; the owner of the axes (`hardware.system`) reacts to
`ready`.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Protocol

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.guarding import GuardingEventKind
from canopen_control.cia301.heartbeat import HeartbeatEvent, HeartbeatEventKind
from canopen_control.cia301.nmt import RESETS, NmtCommand, NmtState
from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.cia402.objects import CONTROLWORD
from canopen_control.errors import BootError, HeartbeatLost, SdoAbort, SdoStopped, SdoTimeout, without_node
from canopen_control.master.boot import BootTask
from canopen_control.master.event_log import Event, Level
from canopen_control.master.node_log import NodeLog
from canopen_control.od.indices import GUARD_TIME, HEARTBEAT_PRODUCER, LIFE_FACTOR, SYNC_OVERFLOW
from canopen_control.rpc.messages.fault import FaultEvent

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.cia301.guarding import GuardingEvent
    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.cia402.motors import ObjectPlace
    from canopen_control.errors import CanopenError
    from canopen_control.frame import CanFrame
    from canopen_control.master.boot import BootResult, FinishedStep
    from canopen_control.master.cycle import ReceivedPdo, SentPdo
    from canopen_control.master.keys import NodeConfig
    from canopen_control.master.plan import NodePlan
    from canopen_control.od.model import ObjectDictionary


STOPPING_NS = 2_000_000_000  # time in which stop commands are still sent to a silent node
_QUICK_STOP = b"\x02\x00"
RETRY_NS = 1_000_000_000  # CiA 302-2: a request without an answer is repeated after a second


class NodeState(enum.Enum):
    """State of a node from the master's point of view."""

    WAITING = "waiting"  # for the next boot
    BOOTING = "booting"
    READY = "ready"


class NodeOwner(Protocol):
    """Network that a node belongs to, with the methods that the node calls."""

    def send_nmt(self, command: NmtCommand, node_id: int) -> None: ...
    def report(self, event: Event, /) -> None: ...
    def wake(self) -> None:
        """Recalculate the time of the next `tick`."""

    def watch_heartbeat(self, node_id: int, timeout_ns: int) -> None:
        """Monitor a node's heartbeat from the next heartbeat on; 0 ends monitoring."""

    def guard(self, node: RemoteNode, on: bool, now: int) -> None:
        """Start or stop node guarding if the node's plan has guarding."""

    def lay_out(self, node: RemoteNode, result: BootResult) -> None:
        """Set up a node's process data as configured by the boot."""

    def written(self, node: RemoteNode, index: int, subindex: int, data: bytes) -> None:
        """Handle an SDO download that the node has accepted."""


class AxisUse(Protocol):
    """Whether an axis is enabled or being enabled (`enable_requested`), or performs a controlled stop (`falling`)."""

    @property
    def enable_requested(self) -> bool: ...
    @property
    def falling(self) -> bool: ...


class RemoteNode:
    """Configured node, with its SDO client, boot, supervision and PDOs."""

    holds_load = False
    """Whether an axis of the node holds a load that would fall without power."""
    disobeys = False
    """Whether `stop_as_last_resort` was called since the last boot."""
    disabled: bool | None = None
    """Whether the node confirmed after `disable` that no axis has power; None before, and without any answer."""
    _ending = False

    def __init__(
        self,
        config: NodeConfig,
        plan: NodePlan,
        od: ObjectDictionary,
        owner: NodeOwner,
    ) -> None:
        self.config, self.plan, self.od = config, plan, od
        self.name, self.node_id = config.name, config.node_id
        motors = plan.motors
        self._places: Mapping[tuple[int, int], ObjectPlace] = {} if motors is None else motors.places
        device_od = od if motors is None else motors.device
        timeout_ns = config.boot.sdo_timeout_ms * 1_000_000
        self.sdo = SdoClient(config.node_id, timeout_ns=timeout_ns, name=config.name, od=device_od)
        self.state = NodeState.WAITING
        self.ready = False
        """Whether the node has booted and is not lost, so that its process data is valid."""
        self.stale = False
        """Whether a TPDO of the node is overdue."""
        self.nmt_state: NmtState | None = None
        """Last known NMT state; None before the first message and while the node is silent."""
        self.last_seen: int | None = None
        self.error: str | None = None
        self.identity: BootResult | None = None
        self.boot_steps: list[FinishedStep] = []
        self.boots = 0
        self.received: list[ReceivedPdo] = []
        self.sent: list[SentPdo] = []
        self.contradicted = 0
        """Number of RPDOs of other programs that moved an axis of the ready node by other values."""
        self.fault: FaultEvent | None = None
        """Fault in the last EMCY message of the node, which may be an error reset."""
        self.expected_state: NmtState | None = None  # state requested by the last NMT command of a user
        self.restart_command = ""
        """Shell command that starts the node's virtual drive again, after its process has ended; else ""."""
        self.log = NodeLog(config, owner.report, round(plan.heartbeat_timeout_ns / config.supervision.multiplier))
        self.label = self.log.label
        """Node-ID and name, as in every message."""
        self.is_managed = config.boot.enabled
        """Whether this master boots the node; with `boot: false` only after a user has started it."""
        self.uses: list[AxisUse] = []  # of the axes that joints have, added by these joints
        self._owner = owner
        self._guarding_boot = False
        self.sdo_reads = self.sdo_writes = self.sdo_failed = 0
        self._stopping_until: int | None = None
        self._task: BootTask | None = None
        self._retry_at: int | None = None

    @property
    def boot_step(self) -> str:
        """Current step of the boot, or "" if no boot is in progress."""
        return self._task.step if self._task is not None else ""

    @property
    def is_taken_out(self) -> bool:
        """Whether a user's NMT command has taken the node out of use until it is started again."""
        return self.expected_state is not None

    @property
    def absence(self) -> str:
        """Sentence that says why the node is not operational, with the command that starts it again, if any."""
        command = f"canopen-control nmt start {self.name}" if self.is_taken_out else self.restart_command
        again = f"; start it again: {command}" if command else ""
        return f"{self.label} is not operational: {self.reason or 'it has not booted yet'}{again}"

    def begin_boot(self, now: int, *, reset: bool = True) -> None:
        """Start a boot of the node, and abort a boot in progress; `reset` is passed to `boot`."""
        self._retry_at = None
        if self._ending:
            return
        self.is_managed = True
        self._abandon()
        self._owner.guard(self, False, now)
        self._owner.watch_heartbeat(self.node_id, 0)
        if self.ready:  # a drive that is kept alive would move on during its boot
            self._stopping_until = now + STOPPING_NS
        if self._stopping_until is None:
            self._stop_sending()
        else:
            self._send_controlwords()
        self.state, self.ready = NodeState.BOOTING, False
        self.expected_state = None
        self._task = BootTask(
            self.plan,
            self.sdo,
            self._send_command,
            reset=reset,
            now=now,
            count_tpdos=lambda: sum(pdo.count for pdo in self.received),
        )
        self._guarding_boot = False
        self.log.heartbeat_changed(round(self.plan.heartbeat_timeout_ns / self.config.supervision.multiplier))
        self._settle(now)

    @property
    def can_be_disabled(self) -> bool:
        """Whether the node is not ready, one of its axes may have power, and it can be reached by SDO.

        False with `boot: false`: another master may be in charge of the node, and move it.
        """
        heard = self.nmt_state is not None or (bool(self.boot_step) and not (self.last_seen is None and self.error))
        # CiA 301, 7.3.2.2.5: no SDO in STOPPED, which a node leaves by its boot-up, for example after a power cycle
        commanded = self.expected_state is NmtState.STOPPED and self.nmt_state is not NmtState.PRE_OPERATIONAL
        stopped = commanded or self.nmt_state is NmtState.STOPPED
        return self.is_managed and bool(self.plan.axes) and not self.ready and heard and not stopped

    @property
    def is_disabling(self) -> bool:
        """Whether `disable` has not ended yet."""
        return self._ending and self._task is not None

    def disable(self, now: int) -> None:
        """End the boot and disable the axes by SDO, because the run ends; a second call does nothing.

        `disabled` is the result. The node is not booted again.
        """
        if self._ending:
            return
        restarting = self._task is not None and self._task.awaits_boot_up
        self._abandon()
        self._ending, self._retry_at, self.disabled = True, None, False
        self._task = BootTask(self.plan, self.sdo, self._send_command, reset=restarting, now=now, disabling=True)
        self._settle(now)

    def read(self, index: int, subindex: int, done: Callable[[SdoRequest], None]) -> None:
        """Upload an object of an axis by SDO; `done` is called with the completed request, successful or not."""
        place = self._places.get((index, subindex))
        if place is None:
            self.sdo.read(index, subindex).context = done
        else:
            self.sdo.read(place.index, place.subindex).context = _with_part(place, done)
        self._owner.wake()

    def write(self, index: int, subindex: int, data: bytes, done: Callable[[SdoRequest], None] | None = None) -> None:
        """Download an object of an axis by SDO; `done` is called with the completed request, successful or not."""
        self.sdo.write(*self.plan.address(index, subindex), data).context = done
        self._owner.wake()

    def lost(self, now: int, text: str, *, kind: str = "bus_lost") -> None:
        """Mark the node as lost because the bus has failed; the network boots it when the bus has recovered."""
        self.nmt_state = None
        self._drop(now, f"{self.label}: {text}", Level.ERROR, kind=kind)
        self._retry_at = None

    def command(self, command: NmtCommand, now: int, *, boot: bool = False) -> None:
        """Send a user's NMT command, which takes the node out of use, except NMT start or a reset with `boot`."""
        self._send_command(command)
        if command is NmtCommand.START:
            self.begin_boot(now)
            return
        self._drop(now, f"NMT {command.name.lower().replace('_', ' ')} was commanded", Level.WARNING, kind="nmt")
        if not self.plan.supervision_ns:
            self.nmt_state = _COMMANDED.get(command)  # no later message shows the state
        self.expected_state = None if boot else _COMMANDED.get(command)
        self._retry_at = now + 2 * RETRY_NS if boot else None
        # CiA 301, 7.2.8.3.2.1: life guarding counts from the first remote frame on
        if command not in RESETS:  # without remote frames the node would consider the master lost
            self._owner.guard(self, True, now)

    @property
    def moves_axes(self) -> bool:
        """Whether an axis of the node is enabled or performs a controlled stop, which NMT stop would end abruptly."""
        return any(use.enable_requested or use.falling for use in self.uses)

    def stop_as_last_resort(self, now: int) -> None:
        """Send NMT stop to a drive that obeys no controlword; the node is out of use until `nmt start`.

        A reset would end the drive's monitoring of the master, so that it would not stop at the end of the run either.
        """
        self.disobeys = True
        self.command(NmtCommand.STOP, now)

    def _send_command(self, command: NmtCommand) -> None:
        if command in RESETS:
            self.log.reset()
        self._owner.send_nmt(command, self.node_id)

    def on_heartbeat(self, event: HeartbeatEvent, now: int, since: int | None = None) -> None:
        """Handle an event of the heartbeat consumer; the frame was received between `since` and `now`."""
        kind = event.kind
        # CiA 301, 7.2.8.3: boot-up, heartbeat event and its resolution
        if kind is HeartbeatEventKind.BOOT_UP:
            self._on_boot_up(now, since)
        elif kind is HeartbeatEventKind.MISSED:
            self._on_silence(event.age_ns, now)
        elif kind is HeartbeatEventKind.RESOLVED:
            self._on_return(now)
        elif self.ready and event.state is not NmtState.OPERATIONAL:
            self._left_operational(event.state, now)

    def _on_silence(self, age_ns: int, now: int) -> None:
        """Drop a node whose heartbeat is missing; only report the loss if a user has taken the node out of use."""
        self.nmt_state = None
        lost = HeartbeatLost(self.node_id, age_ns / 1e9, self.name)
        if self.is_taken_out:
            text = f"{lost}; it was taken out of use"
            self._owner.report(Event(now, "heartbeat_lost", self.name, text, Level.WARNING))
            return
        self._drop(now, str(lost), Level.ERROR, kind="heartbeat_lost", error=lost)

    def _on_return(self, now: int) -> None:
        """Boot a node whose heartbeat has returned, unless a user has taken it out of use."""
        if self.is_taken_out:
            text = "its heartbeat is back; it was taken out of use, and nmt start boots it"
            self.log.report(now, "heartbeat_back", text)
            return
        self.log.report(now, "heartbeat_back", "its heartbeat is back; booting it again")
        self.begin_boot(now)

    def on_state(self, state: NmtState | None, now: int, since: int | None = None) -> None:
        """Handle the NMT state in a heartbeat or guarding response; None is an unknown state."""
        self.nmt_state, self.last_seen = state, now
        self.log.heartbeat(now, since)
        # CiA 301, 7.3.2: PDOs exist only in OPERATIONAL
        if self.ready and state is not NmtState.OPERATIONAL:  # a state change of a node without heartbeat supervision
            self._left_operational(state, now)
        elif self._task is not None:
            self._task.heartbeat(state, now)
            self._settle(now)

    def on_guarding(self, event: GuardingEvent, now: int) -> None:
        """Handle an event of node guarding."""
        kind = event.kind
        if self.is_taken_out:
            self._guarded_outside(kind, now)
        elif kind is GuardingEventKind.MISSED:
            # CiA 301, 7.2.8.3.2.1: node guarding event after the node life time
            self.nmt_state = None
            silence = f"no answer to node guarding for {self.plan.supervision_ns / 1e9:g} s"
            lost = f"{self.label}: {silence}; is it powered and connected?"
            self._drop(now, lost, Level.ERROR, kind="guarding_lost")
            self._retry_at = now + RETRY_NS
        elif kind is GuardingEventKind.TOGGLE_ERROR:
            # CiA 301, 7.2.8.3.2.1: the toggle bit alternates, and is 0 after a reset communication
            self._toggled(now)
        elif kind is GuardingEventKind.CHANGED and self.ready and event.state is not NmtState.OPERATIONAL:
            self._left_operational(event.state, now)

    def _guarded_outside(self, kind: GuardingEventKind, now: int) -> None:
        """Report a guarding event of a node that is out of use, without further action."""
        if kind is GuardingEventKind.MISSED:
            self.nmt_state = None
            self.log.report(now, "guarding_lost", "no answer to node guarding; it was taken out of use", Level.WARNING)
        elif kind is GuardingEventKind.RESOLVED:
            text = "it answers node guarding again; it was taken out of use, and nmt start boots it"
            self.log.report(now, "guarding_back", text)

    def on_emcy(self, frame: CanFrame, now: int) -> None:
        """Record and report an EMCY message, and update the active errors."""
        malformed = self.log.errors.malformed
        self.log.errors.receive(frame, now)
        if self.log.errors.malformed > malformed:
            self.log.short_emcy(frame.data, now)
        for message in self.log.errors.events():
            self.fault, self.last_seen = FaultEvent.of_emcy(message), now
            text = self.log.emcy(self.fault, now, self._hints)
            if text is not None:
                self.error = text
            elif self.ready and not self.log.errors.active:
                self.error = None

    @property
    def reason(self) -> str:
        """Current error without the name of the node, or "" if there is none."""
        return without_node(self.error or "", self.node_id, self.name)

    @property
    def active_fault(self) -> FaultEvent | None:
        """Fault of the last EMCY message, or None after an error reset or if no error is active."""
        return self.fault if self.fault is not None and not self.fault.is_over and self.log.errors.active else None

    @property
    def _hints(self) -> dict[int, str]:
        """Advice, by EMCY code, for errors whose cause the boot in progress removes."""
        if self._task is None or not any(write.index == SYNC_OVERFLOW for write in self.plan.writes):
            return {}
        return {_SYNC_LENGTH: "; the SYNC counter is not yet set, the boot under way writes its 0x1019"}

    def on_pdo(self, pdo: ReceivedPdo, now: int) -> None:
        """Update `stale`, and report a TPDO that became overdue or is received again."""
        self.stale = any(tpdo.overdue for tpdo in self.received)
        self.log.pdo(pdo, now)

    def pump(self, now: int) -> None:
        """Pass completed SDO transfers to the boot and to their callers, and handle the end of the boot."""
        for request in self.sdo.events():
            if isinstance(request.error, SdoTimeout) and self.nmt_state is NmtState.STOPPED:
                request.error = SdoStopped(request.error)
            self.sdo_failed += request.error is not None and not _is_absence(request)
            self.sdo_reads += not request.is_write
            self.sdo_writes += request.is_write
            if request.is_write and request.error is None:
                self._owner.written(self, request.index, request.subindex, request.data)
                self._guard_at_once(request, now)
                self._follow_heartbeat(request, now)
            if self._task is not None:
                self._task.transfer_ended(request, now)
            if callable(request.context):
                request.context(request)
        self._settle(now)

    def tick(self, now: int) -> None:
        """Process the timeouts of the SDO client and the boot, start the next boot, and report delayed events."""
        self.sdo.tick(now)
        if self._task is not None:
            self._task.tick(now)
        self.pump(now)
        if self._retry_at is not None and now >= self._retry_at:
            # A node that may just be starting is not reset, since it would then restart forever.
            self.begin_boot(now, reset=self.last_seen is not None and now - self.last_seen < 2 * RETRY_NS)
        if self._stopping_until is not None and now >= self._stopping_until:
            self._stop_sending()
        self.log.tick(now)

    def next_deadline(self) -> int | None:
        """Return the time of the next `tick`, or None if not needed."""
        task = self._task.next_deadline() if self._task is not None else None
        earliest = self.sdo.next_deadline()
        for deadline in (task, self._retry_at, self._stopping_until, self.log.deadline):
            if deadline is not None and (earliest is None or deadline < earliest):
                earliest = deadline
        return earliest

    def age_ns(self, now: int) -> int | None:
        """Return the time since the node's last message in ns, or None if no message was received."""
        newest = -1 if self.last_seen is None else self.last_seen
        for pdo in self.received:  # no generator expression, for speed: called for each state sample
            if pdo.stamp > newest:
                newest = pdo.stamp
        return now - newest if newest >= 0 else None

    def _on_boot_up(self, now: int, since: int | None) -> None:
        self.nmt_state, self.last_seen = NmtState.PRE_OPERATIONAL, now  # entered after the boot-up
        # CiA 301, 7.3.2: the initialisation resets the SDO server
        self.sdo.forget()  # a restarted node does not answer pending requests
        self.log.boot_up(now, since)
        if self._task is not None and self._task.awaits_boot_up:
            self._task.boot_up(now)
            self._settle(now)
            return
        if self.ready:
            self._drop(
                now,
                f"{self.label} has restarted by itself; its settings are gone, booting it again",
                Level.ERROR,
                kind="restarted",
            )
        if self.is_managed and not self.is_taken_out:
            self.begin_boot(now, reset=False)

    def _toggled(self, now: int) -> None:
        """Handle a wrong toggle bit in a guarding response, which indicates a restart or a duplicate node-ID."""
        text = "its guarding toggle bit is wrong: it has restarted, or a second node has its id"
        if self.ready:
            self._drop(now, f"{self.label}: {text}; booting it again", Level.ERROR, kind="guarding_toggle")
            self._retry_at = now + RETRY_NS
        else:
            self.log.report(now, "guarding_toggle", text, Level.WARNING)

    def _left_operational(self, state: NmtState | None, now: int) -> None:
        name = "an unknown state" if state is None else state.name
        self._drop(now, f"{self.label} changed to {name} without a command; booting it again", Level.ERROR, kind="nmt")
        self._retry_at = now + RETRY_NS

    def _drop(self, now: int, text: str, level: Level, *, kind: str, error: CanopenError | None = None) -> None:
        """End READY or the boot, invalidate the process data, and report the event if the node was in use."""
        was_used, was_ready = self.ready or self._task is not None, self.ready
        self._abandon()
        self.state, self.ready, self.stale = NodeState.WAITING, False, False
        self._owner.guard(self, False, now)
        self.error = str(error) if error is not None else text
        for received in self.received:
            received.forget()
        self._stopping_until = None
        if was_ready and kind in _MAY_BE_ALIVE:
            self._stop_silent_drive(now)
        else:
            self._stop_sending()
        if was_used:
            self._owner.report(Event(now, kind, self.name, text, level))

    def _stop_silent_drive(self, now: int) -> None:
        """Send a quick stop by SDO, and RPDOs for another `STOPPING_NS`; a silent drive may still receive them.

        The owner of the axes provides the values; the SDO also reaches a drive in an NMT state without PDOs.
        """
        self._stopping_until = now + STOPPING_NS
        for offset in self.plan.axes:
            self.write(CONTROLWORD + offset, 0, _QUICK_STOP)

    def _send_controlwords(self) -> None:
        """Enable only RPDOs with a controlword, to continue a stop during a boot.

        A boot-up may be from a second node, or a stray frame, while the drive continues to turn. A node that has really
        restarted has its stored mapping, in which other objects may have any position; a controlword is always first.
        """
        controlwords = [CONTROLWORD + offset for offset in self.plan.axes]
        for sent in self.sent:
            sent.enabled = any(mapped.index in controlwords for mapped in sent.codec.objects)

    def _stop_sending(self) -> None:
        self._stopping_until = None
        for sent in self.sent:
            sent.enabled = False

    def _abandon(self) -> None:
        if self._task is not None:
            self._task.cancel()
            self._task = None
        self.sdo.cancel_all(BootError(self.node_id, "B", "given up, the node is booted again", self.name))

    def _settle(self, now: int) -> None:
        """Start supervision in the boot step that needs it, and handle the end of the boot."""
        task = self._task
        if task is None:
            return
        if task.step == "heartbeat" and self.plan.heartbeat_timeout_ns:
            self._owner.watch_heartbeat(self.node_id, self.plan.heartbeat_timeout_ns)
        if task.step in ("keep alive", "heartbeat") and self.plan.guard and not self._guarding_boot:
            self._guarding_boot = True
            self._owner.guard(self, True, now)
        if not task.done:
            return
        self._task = None
        if self._ending:
            self._end_disabling(task.error, now)
            return
        self.boot_steps = task.steps
        self.boots += 1
        if task.result is not None:
            self._become_ready(task.result, task.started, now)
        else:
            self._failed(task.error, now)

    def _become_ready(self, result: BootResult, started: int, now: int) -> None:
        self.identity, self.error, self.state, self.ready = result, None, NodeState.READY, True
        self.disobeys = False
        if not self._guarding_boot:
            self._owner.guard(self, True, now)
        self._stopping_until = None
        confirmed = self.nmt_state is NmtState.OPERATIONAL
        self.nmt_state = NmtState.OPERATIONAL  # shown by a TPDO if not by a heartbeat
        if not self.plan.supervision_ns and not confirmed:
            text = "it has neither heartbeat nor guarding: OPERATIONAL was commanded, but cannot be confirmed"
            self.log.report(now, "nmt_unconfirmed", text)
        self._owner.lay_out(self, result)
        for received in self.received:
            received.expected, received.reported_lengths = True, 0
        for sent in self.sent:
            sent.start()
        for warning in result.warnings:
            self.log.report(now, "boot_warning", warning, Level.WARNING)
        self.log.report(
            now,
            "ready",
            f"operational after {(now - started) / 1e9:.3f} s, {result.writes} objects written, {result.reads} read",
        )

    def _guard_at_once(self, request: SdoRequest, now: int) -> None:
        """Start guarding once the boot has written guard time or life time factor.

        Some devices expect guarding from this write on, instead of after the first remote frame (CiA 301, 7.2.8.3.2.1),
        and send EMCY 0x8130 if the first remote frame comes only after the life time.
        """
        writes_guarding = request.index in (GUARD_TIME, LIFE_FACTOR) and self._task is not None
        if writes_guarding and self.plan.guard is not None and not self._guarding_boot:
            self._guarding_boot = True
            self._owner.guard(self, True, now)

    def _follow_heartbeat(self, request: SdoRequest, now: int) -> None:
        """Adapt the supervision to a heartbeat period that a user has just written to 0x1017."""
        if request.index != HEARTBEAT_PRODUCER or self._task is not None or not self.plan.heartbeat_timeout_ns:
            return
        ms = int.from_bytes(request.data, "little")
        if not ms:
            text = "0x1017 was set to 0 by SDO: its heartbeat ends, and it will be reported as lost"
            self.log.report(now, "heartbeat_changed", text, Level.WARNING)
            return
        self.log.heartbeat_changed(ms * 1_000_000)
        timeout = round(ms * self.config.supervision.multiplier * 1_000_000)
        self._owner.watch_heartbeat(self.node_id, timeout)
        text = f"0x1017 was set to {ms} ms by SDO: until the next boot its heartbeat timeout is {timeout / 1e9:g} s"
        self.log.report(now, "heartbeat_changed", text)

    def _end_disabling(self, error: CanopenError | None, now: int) -> None:
        """Take the result of `disable`; a node that never answered may not exist."""
        self.state, self.disabled = NodeState.WAITING, error is None
        if error is None:
            return
        if isinstance(error, BootError) and error.letter == "B" and self.last_seen is None:
            self.disabled = None
        else:
            text = f"{self.label}: could not be disabled: {without_node(str(error), self.node_id, self.name)}"
            self._owner.report(Event(now, "not_disabled", self.name, text, Level.ERROR))

    def _failed(self, error: CanopenError | None, now: int) -> None:
        text = str(error)
        if text != self.error:  # a missing node is reported once, not every second
            self._owner.report(Event(now, "boot_failed", self.name, text, Level.ERROR))
        self.error, self.state = text, NodeState.WAITING
        self._owner.watch_heartbeat(self.node_id, 0)
        self._retry_at = now + RETRY_NS


def _is_absence(request: SdoRequest) -> bool:
    """Whether an upload was aborted because the object does not exist, which is not a failure."""
    error = request.error
    return not request.is_write and isinstance(error, SdoAbort) and error.code in _ABSENT


_SYNC_LENGTH = 0x8240  # EMCY: the length of the SYNC does not match 0x1019
_ABSENT = (AbortCode.NO_OBJECT, AbortCode.NO_SUBINDEX)
_MAY_BE_ALIVE = ("heartbeat_lost", "guarding_lost", "guarding_toggle", "restarted", "nmt", "bus_lost")
_COMMANDED = {
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_NODE: NmtState.PRE_OPERATIONAL,
    NmtCommand.RESET_COMMUNICATION: NmtState.PRE_OPERATIONAL,
}


def _with_part(place: ObjectPlace, done: Callable[[SdoRequest], None]) -> Callable[[SdoRequest], None]:
    """Return a callback that reduces the data of an upload to one motor's part, and calls `done`."""

    def take(request: SdoRequest) -> None:
        request.data = place.part_of(request.data)
        done(request)

    return take
