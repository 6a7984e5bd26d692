"""Run of the master checks: scheduled faults of a virtual device on the master's bus.

After the first frame from the master the device runs without faults for `FIRST_NS`, then steps through the stages of
`master_drive.schedule`. Stages that do not fit into the time of the run are left out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.emcy import EMCY_COB_ID
from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NMT_COB_ID, NmtState
from canopen_control.cia301.sdo_codec import ABORT, ANSWER_BASE, REQUEST_BASE
from canopen_control.conformance.master_checks import MS, MasterFindings, MasterObserver, S
from canopen_control.conformance.master_config import ConfigurationObserver
from canopen_control.conformance.master_drive import ControlObserver, ReactionObserver, Stage, schedule
from canopen_control.conformance.master_network import HeartbeatObserver, PdoObserver, SyncObserver, rpdos_of
from canopen_control.conformance.master_sdo import SdoObserver
from canopen_control.conformance.run import ConformanceReport
from canopen_control.errors import BusClosed, ConfigError
from canopen_control.frame import CanFrame, frames_of, pack_records
from canopen_control.virtual.fault_table import FaultSwitches

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.bus.port import Port
    from canopen_control.host.reactor import Reactor
    from canopen_control.virtual.virtual_node import VirtualNode


FIRST_NS = 8 * S
DEFAULT_S = 120.0  # whole schedule, including the time in which an operator enables the drive again
_ENABLE_NS = 5 * S  # time for an operator to enable the drive again
_BOOT_NS = 200 * MS  # boot time of the device
_STEP_NS = 20 * MS
_BEHIND_NS = 100 * MS
#: checks of each kind of stage, which a run that is too short leaves out
_OF_STAGE = {
    "fault": ("MF01", "MF02"),
    "power": ("MF03",),
    "leaves": ("MF04", "MF05"),
    "flood": ("MF06",),
    "reset": ("MF07", "MF08", "MF09"),
    "heartbeat": ("MF10", "MF11"),
    "silent": ("MF12",),
}


class _HeldAnswers:
    """Delay of one SDO response until the master's next request.

    The answer to that request follows `_BEHIND_NS` later. A master that mistakes the late answer for the answer to its
    next request continues before the right answer arrives.
    """

    def __init__(self, node: VirtualNode) -> None:
        self._node = node
        self._armed = False
        self._late: CanFrame | None = None
        self._released: list[CanFrame] = []
        self._behind: list[CanFrame] = []
        self._until: int | None = None

    def arm(self, *, on: bool) -> None:
        """Delay the next SDO response; with `on` False, cancel the delay."""
        self._armed = on

    def request(self, frame: CanFrame, now: int) -> None:
        """Release the delayed response at the next request other than an abort."""
        if self._late is None or frame.can_id != REQUEST_BASE + self._node.node_id or frame.data[:1] == bytes((ABORT,)):
            return
        self._released.append(self._late)
        self._late, self._until = None, now + _BEHIND_NS

    def pass_on(self, frames: list[CanFrame], now: int) -> list[CanFrame]:
        """Take new frames of the device; return the frames to send now, in order, including delayed ones."""
        leaving, self._released = self._released, []
        if self._until is not None and now >= self._until:
            leaving += self._behind
            self._behind, self._until = [], None
        for frame in frames:
            if frame.can_id != ANSWER_BASE + self._node.node_id:
                leaving.append(frame)
            elif self._armed and self._node.nmt.state is NmtState.PRE_OPERATIONAL:
                self._armed, self._late = False, frame
            elif self._until is not None:
                self._behind.append(frame)
            else:
                leaving.append(frame)
        return leaving


class MasterJudge:
    """Sans-IO test of a CANopen master: a virtual device, and observers that check the frames on its bus."""

    def __init__(self, node: VirtualNode, now: int) -> None:
        self.node, self.findings = node, MasterFindings()
        self.findings.now = self.findings.begin = now
        self.contacts = 0
        config = ConfigurationObserver(node, self.findings)
        self.reactions = ReactionObserver(node, self.findings, config)
        control = ControlObserver(node, self.findings, self.reactions)
        sdo = SdoObserver(node, self.findings, (config, control))
        self.observers: tuple[MasterObserver, ...] = (
            sdo,
            config,
            HeartbeatObserver(node, self.findings),
            SyncObserver(node, self.findings),
            PdoObserver(node, self.findings, config),
            control,
            self.reactions,
        )
        self._shown: dict[int, bytes] = {}
        self._answers = _HeldAnswers(node)
        self._switches = node.fault_switches or FaultSwitches(node)
        node.set_reset_delay(_BOOT_NS, now)

    def receive(self, frame: CanFrame, now: int) -> None:
        """Pass a frame from the bus to the observers, then to the device."""
        self.findings.now = now
        self._log("<", frame)
        self.contacts += self._is_for_device(frame)
        self._answers.request(frame, now)
        for observer in self.observers:
            observer.receive(frame, now)
        self.node.receive(frame, now)

    def _is_for_device(self, frame: CanFrame) -> bool:
        node_id = self.node.node_id
        if frame.can_id == NMT_COB_ID:
            return frame.data[1:2] in (b"\0", bytes((node_id,)))
        if frame.is_remote:
            return frame.can_id & 0x7FF == ERROR_CONTROL_COB_ID + node_id
        return frame.can_id == REQUEST_BASE + node_id or any(rpdos_of(self.node, frame))

    def frames(self, now: int) -> list[CanFrame]:
        self.findings.now = now
        frames = self._answers.pass_on(self.node.frames(), now)
        for frame in frames:
            self._log(">", frame)
            for observer in self.observers:
                observer.sent(frame)
        return frames

    def tick(self, now: int) -> None:
        """Advance device and observers to `now`."""
        self.findings.now = now
        self.node.tick(now)
        for observer in self.observers:
            observer.tick(now)

    def begin(self, stage: Stage, now: int) -> None:
        self.findings.now = now
        self.reactions.begin(stage, now)
        self._answers.arm(on=stage.holds)
        for fault in (stage.also, stage.fault):
            if fault:
                self._switches.set(fault, True, now)

    def clear_faults(self, stage: Stage, now: int) -> None:
        """Clear the faults of a stage that are still active."""
        for fault in (stage.fault, stage.also):
            if fault in self._switches.active:
                self._switches.set(fault, False, now)

    def end(self, now: int) -> None:
        self.findings.now = now
        self.reactions.end()

    def report(self, now: int) -> ConformanceReport:
        """Run the checks that need the whole run, and return the report."""
        self.findings.now = now
        for observer in self.observers:
            observer.finish()
        number = self.node.store.number
        identity = {"device type": f"{number(0x1000):08X}"}
        for subindex, name in enumerate(("vendor", "product", "revision", "serial"), 1):
            identity[name] = f"{number(0x1018, subindex):08X}"
        return ConformanceReport(self.node.node_id, identity, self.findings.results(), "master")

    def _log(self, direction: str, frame: CanFrame) -> None:
        """Log a frame from or to the device; an RPDO is logged only if its data has changed."""
        node_id, can_id = self.node.node_id, frame.can_id & 0x7FF
        services = (
            NMT_COB_ID,
            *(base + node_id for base in (REQUEST_BASE, ANSWER_BASE, ERROR_CONTROL_COB_ID, EMCY_COB_ID)),
        )
        if can_id in services:
            self.findings.record(direction, frame)
        elif any(rpdos_of(self.node, frame)) and self._shown.get(can_id) != frame.data:
            self._shown[can_id] = frame.data
            self.findings.record(direction, frame)


class MasterRun:
    """Run of the master checks on a port; ends after `seconds` or with the schedule."""

    def __init__(
        self, reactor: Reactor, port: Port, node: VirtualNode, seconds: float, report: Callable[[str], object]
    ) -> None:
        self._reactor, self._port, self._report_stage = reactor, port, report
        now = reactor.now()
        self.judge = MasterJudge(node, now)
        self._begin, self._end = now, now + round(seconds * S)
        self._stages = schedule()
        self._stage: Stage | None = None
        self._faults_cleared = self._closing = self._was_enabled = False
        self._first: int | None = None  # time of the first frame from the master
        self._ready: int | None = None  # earliest time of the next stage
        self._lost: BusClosed | None = None
        reactor.add_reader(port, self._on_readable)
        self._timer_at = now
        self._timer = reactor.call_at(now, self._on_timer)

    def run(self, progress: Callable[[int, int], object] = lambda _done, _total: None) -> ConformanceReport:
        """Run to the end and return the report; `progress` is called with elapsed and total seconds."""
        total = (self._end - self._begin) // S
        while not self.done:
            self._reactor.run_for(min(S // 2, self._end - self._reactor.now()))
            progress((self._reactor.now() - self._begin) // S, total)
        self.close()
        return self.report()

    @property
    def done(self) -> bool:
        """Whether the schedule or the time has ended, or the bus was lost."""
        return self._closing or self._lost is not None or self._reactor.now() >= self._end

    def close(self) -> None:
        """Remove the device from the reactor; the port stays open."""
        self._closing = True
        self._reactor.remove_reader(self._port)
        self._timer.cancel()

    def report(self) -> ConformanceReport:
        """Return the report; raise ConfigError if no frame for the device arrived, or BusClosed if the bus was lost."""
        if self._lost is not None:
            raise self._lost
        if not self.judge.contacts:
            raise ConfigError(self._nothing())
        self._leave_out()
        return self.judge.report(self._reactor.now())

    def stop(self) -> None:
        """End the run early; the report remains available."""
        self._closing = True
        self._reactor.stop()

    def _nothing(self) -> str:
        node_id = self.judge.node.node_id
        return (
            f"no master on {self._port.channel} sent anything to node {node_id} in "
            f"{(self._reactor.now() - self._begin) / S:.1f} s; start the master, or give the node-ID that it expects "
            "with --node-id"
        )

    # -- the device

    def _plan(self) -> None:
        """Set the timer to the next deadline of the device, but at most one step of the observers ahead."""
        now = self._reactor.now()
        deadline = self.judge.node.next_deadline()
        self._timer.cancel()
        self._timer_at = now + _STEP_NS if deadline is None else min(now + _STEP_NS, max(deadline, now))
        self._timer = self._reactor.call_at(self._timer_at, self._on_timer)

    def _on_timer(self) -> None:
        self._step()
        if not self.done:
            self._plan()

    def _on_readable(self) -> None:
        try:
            records = self._port.receive()
            now = self._reactor.now()
            for frame in frames_of(records):
                self.judge.receive(frame, now)
                self._send(now)
            for event in self._port.events():
                self.judge.node.bus_event(event.kind, now)
            deadline = self.judge.node.next_deadline()
            if deadline is not None and deadline < self._timer_at and not self.done:
                self._plan()
        except BusClosed as error:
            self._lost = error
            self._reactor.stop()

    def _send(self, now: int) -> None:
        if frames := self.judge.frames(now):
            self._port.send(pack_records(frames))

    def _step(self) -> None:
        now = self._reactor.now()
        try:
            self.judge.tick(now)
            self._send(now)
            if self._port.wants_write:
                self._port.flush()
            self._follow_schedule(now)
            self._send(now)
        except BusClosed as error:
            self._lost = error

    # -- the schedule

    def _follow_schedule(self, now: int) -> None:
        self._was_enabled = self._was_enabled or self.judge.reactions.enabled
        if self._first is None:
            if not self.judge.contacts:
                return
            self._first = now
            self._ready = now + FIRST_NS
        stage = self._stage
        if stage is None:
            self._begin_next(now)
        elif not self._faults_cleared and now >= stage.begun + stage.lasts:
            self._faults_cleared = True
            self.judge.clear_faults(stage, now)
        elif self._faults_cleared and now >= stage.begun + stage.total:
            self.judge.end(now)
            self._stage, self._ready = None, now

    def _begin_next(self, now: int) -> None:
        if self._ready is None or now < self._ready:
            return
        if not self._stages or now + self._stages[0].total > self._end:
            self._closing = True
            return
        stage = self._stages[0]
        waits = stage.enables and self._was_enabled and not self.judge.reactions.enabled
        if waits and now < self._ready + _ENABLE_NS:
            return
        self._stages.pop(0)
        self._stage, self._faults_cleared = stage, False
        self._report_stage(f"{(now - self._begin) / S:.0f} s: {stage.title}")
        self.judge.begin(stage, now)

    def _leave_out(self) -> None:
        for stage in self._stages:
            for check_id in _OF_STAGE[stage.kind]:
                self.judge.findings.skipped[check_id] = (
                    "the run was too short for this check; allow more time with --for"
                )
