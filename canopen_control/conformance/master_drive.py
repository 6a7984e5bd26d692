"""Checks of a master's commands to a drive, and of its reaction to faults of the device (CiA 402-2).

Only the first axis is checked. Commands are received in RPDOs and in SDO writes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NMT_COB_ID, NmtCommand, NmtState
from canopen_control.cia301.sdo_codec import REQUEST_BASE
from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import FAULT_RESET_BIT, Command, State, command_of, transition_of
from canopen_control.conformance.master_checks import MS, MasterObserver, S, present
from canopen_control.conformance.master_network import rpdos_of, values_of
from canopen_control.od.codec import decode

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.conformance.master_checks import MasterFindings
    from canopen_control.conformance.master_config import ConfigurationObserver
    from canopen_control.conformance.master_sdo import Mux
    from canopen_control.frame import CanFrame
    from canopen_control.od.model import Value
    from canopen_control.virtual.virtual_node import VirtualNode


_CHAIN_NS, _BIT_7_NS = S // 2, S
_RATES = (o.VL_TARGET_VELOCITY, o.TARGET_VELOCITY, o.TARGET_TORQUE)  # target velocities and torque, which are 0 at rest
_SET_POINTS = (o.TARGET_POSITION, *_RATES)
_RESERVED, _NEW_SET_POINT, _ACKNOWLEDGED = 1 << 10, 1 << 4, 1 << 12
_FALLBACK_WINDOW = 1000  # increments, if 0x6065 is not set
_ENABLE_BITS = 0x0F
_UP = (Command.SWITCH_ON, Command.ENABLE_OPERATION)


def window_of(node: VirtualNode) -> int:
    """Return the following error window, the largest distance from 0x6064 that is not considered a jump."""
    window = node.store.number(o.FOLLOWING_ERROR_WINDOW)
    return window if 0 < window < 1 << 31 else _FALLBACK_WINDOW


class ControlObserver(MasterObserver):
    """Observer of controlwords, modes and set-points, which are also passed to `reactions`."""

    def __init__(self, node: VirtualNode, findings: MasterFindings, reactions: ReactionObserver) -> None:
        super().__init__(node, findings)
        self.reactions = reactions
        self._word = 0
        self._reset_at: int | None = None
        self._rose_at: int | None = None

    @property
    def _state(self) -> State:
        return self.node.drives[0].state

    def receive(self, frame: CanFrame, now: int) -> None:
        if frame.is_remote or not self.node.drives:
            return
        for rpdo in rpdos_of(self.node, frame):
            for index, value in values_of(rpdo, frame):
                self._object(index, value, now)

    def writing(self, mux: Mux, data: bytes) -> None:
        entry = self.node.od.get(*mux)
        if not self.node.drives or entry is None or mux[1] or not 0x6000 <= mux[0] < 0x6800:
            return
        try:
            value: Value = decode(data, entry.data_type)
        except ValueError:
            return
        if isinstance(value, int):
            self._object(mux[0], value, self.findings.now)

    def reading(self, mux: Mux) -> None: ...

    def written(self, mux: Mux, code: int | None) -> None: ...

    def _object(self, index: int, value: int, now: int) -> None:
        if index == o.CONTROLWORD:
            self._controlword(value, now)
        elif index == o.MODES_OF_OPERATION:
            modes = self.node.store.number(o.SUPPORTED_DRIVE_MODES, default=-1)
            if 0 < value <= 32:
                self.findings.expect(bool(modes >> value - 1 & 1), "MW07", f"mode {value} with 0x6502 = 0x{modes:08X}")
        elif index in _SET_POINTS:
            self._set_point(index, value)
            self.reactions.set_point(index, value, now)

    def _set_point(self, index: int, value: int) -> None:
        operational = self.node.nmt.state is NmtState.OPERATIONAL
        if index in _RATES and operational and self._state in (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON):
            self.findings.expect(value == 0, "MW05", f"0x{index:04X} = {value} in {self._state.name.replace('_', ' ')}")

    def _controlword(self, word: int, now: int) -> None:
        expect, before = self.findings.expect, self._word
        command, state = command_of(word, before), self._state
        self._word = word
        expect(not word & _RESERVED, "MW09", f"controlword 0x{word:04X}")
        if command is Command.FAULT_RESET:
            expect(state is State.FAULT, "MW04", f"bit 7 rose in {state.name.replace('_', ' ')}")
            expect(True, "MW02", "")
            self._reset_at = self._rose_at = now
        elif not word & FAULT_RESET_BIT and self._rose_at is not None:
            expect(now - self._rose_at <= _BIT_7_NS, "MW03", f"bit 7 at 1 for {(now - self._rose_at) / MS:.0f} ms")
            self._rose_at = None
        if command in _UP and command is not command_of(before & ~FAULT_RESET_BIT, 0):
            self._switch_on(command, state, now)
        self._new_set_point(word, before)
        self.reactions.controlword(word, now)

    def _switch_on(self, command: Command, state: State, now: int) -> None:
        """Check a new command towards OPERATION ENABLED."""
        expect, store = self.findings.expect, self.node.store
        legal = transition_of(state, command) is not None or (state, command) in (
            (State.SWITCHED_ON, Command.SWITCH_ON),
            (State.OPERATION_ENABLED, Command.ENABLE_OPERATION),
        )
        name = command.name.replace("_", " ")
        expect(legal, "MW01", f"{name} (0x{self._word:04X}) in {state.name.replace('_', ' ')}")
        if command is not Command.ENABLE_OPERATION:
            return
        if self._reset_at is not None:
            gap = now - self._reset_at
            expect(gap > _CHAIN_NS, "MW02", f"{name} (0x{self._word:04X}) {gap / MS:.0f} ms after the fault reset")
            self._reset_at = None
        if state is not State.SWITCHED_ON:
            return
        mode, display = store.number(o.MODES_OF_OPERATION), present(self.node, o.MODES_OF_OPERATION_DISPLAY)
        expect(mode == display != 0, "MW08", f"mode {display} shown, {mode} in 0x6060")
        if display == OperationMode.CSP:
            target, actual = store.number(o.TARGET_POSITION), present(self.node, o.POSITION_ACTUAL)
            text = f"0x607A = {target} with 0x6064 = {actual}"
            expect(abs(target - actual) <= window_of(self.node), "MW06", text)

    def _new_set_point(self, word: int, before: int) -> None:
        drive = self.node.drives[0]
        rises = word & ~before & _NEW_SET_POINT
        if (
            rises
            and self._state is State.OPERATION_ENABLED
            and present(self.node, o.MODES_OF_OPERATION_DISPLAY) == OperationMode.PP
        ):
            self.findings.expect(not drive.statusword() & _ACKNOWLEDGED, "MW10", "bit 4 rose while bit 12 was 1")

    def tick(self, now: int) -> None:
        if self._rose_at is not None and now - self._rose_at > _BIT_7_NS:
            self.findings.expect(False, "MW03", "bit 7 still 1 after 1 s")
            self._rose_at = None


@dataclass(slots=True)
class Stage:
    """Stage of the schedule: a fault of the device, and the master's actions during it. Times are in ns.

    `kind` determines the checks; `fault` and `also` are faults in `fault_table`. The fault lasts for `lasts`, and the
    reaction is awaited for a further time `after`. With `enables` the stage starts when the drive is enabled; with
    `holds` an SDO answer is delayed.
    """

    kind: str
    title: str
    fault: str
    lasts: int
    after: int
    also: str = ""
    enables: bool = False
    holds: bool = False
    begun: int = 0
    fault_end: int = 0
    enabled: bool = False  # OPERATION ENABLED at the beginning
    operational: bool = False
    configured: bool = False
    word: int | None = None  # controlword at the beginning
    contact: int | None = None  # time of the first SDO request or NMT command
    noticed: int | None = None  # time of the first SDO request, NMT command or other controlword
    words: list[tuple[int, int]] = field(default_factory=list)  # controlwords and their times
    set_points: dict[int, list[int]] = field(default_factory=dict)  # after the time allowed for the reaction

    @property
    def total(self) -> int:
        """Duration of the stage, including the time for a reaction, in ns."""
        return self.lasts + self.after


def schedule() -> list[Stage]:
    """Return the stages of a run, in order."""
    return [
        Stage("fault", "EMCY and FAULT (over-temperature)", "drive_fault", 3 * S, 2 * S, enables=True),
        Stage("power", "the power stage loses its supply", "power_stage_off", 3 * S, 2 * S, enables=True),
        Stage("leaves", "PRE-OPERATIONAL without a command", "leaves_operational", 0, 6 * S, enables=True),
        Stage("flood", "a flood of EMCY", "emcy_flood", 2 * S, 1 * S),
        Stage("reset", "the device resets itself", "spontaneous_reset", 0, 8 * S, enables=True),
        Stage("reset", "reset, one SDO request is not answered", "spontaneous_reset", 6 * S, 2 * S, "sdo_silent_once"),
        Stage("reset", "reset, SDO answers are late", "spontaneous_reset", 3 * S, 6 * S, "sdo_late"),
        Stage("reset", "reset, an SDO answer comes after the next request", "spontaneous_reset", 0, 8 * S, holds=True),
        Stage("reset", "reset, SDO writes are refused", "spontaneous_reset", 3 * S, 7 * S, "sdo_busy"),
        Stage("heartbeat", "the heartbeat is lost", "heartbeat_lost", 4 * S, 4 * S, enables=True),
        Stage("silent", "the device is silent", "silent", 4 * S, 6 * S),
    ]


_GRACE_NS = S  # time allowed for the reaction of a master
_NOTICE_NS = 3 * S
_SILENCE_NS = S // 2
_RESET_NOTICE_NS, _RETURN_NOTICE_NS = 5 * S, 6 * S


class ReactionObserver(MasterObserver):
    """Observer of the master's reaction to the faults of each stage; `stage` is None between stages."""

    def __init__(self, node: VirtualNode, findings: MasterFindings, boots: ConfigurationObserver) -> None:
        super().__init__(node, findings)
        self.boots = boots
        self.stage: Stage | None = None
        self._word: int | None = None
        self._cyclic: int | None = None  # time of the last cyclic frame
        self._longest = 0  # longest gap between two cyclic frames in the stage
        self._contacts: list[int] = []

    @property
    def enabled(self) -> bool:
        return bool(self.node.drives) and self.node.drives[0].state is State.OPERATION_ENABLED

    def begin(self, stage: Stage, now: int) -> None:
        """Start a stage; must be called before its fault is injected."""
        stage.begun, stage.enabled, stage.word = now, self.enabled, self._word
        stage.operational = self.node.nmt.state is NmtState.OPERATIONAL
        stage.configured = self.boots.configured
        stage.fault_end = now + stage.lasts
        self.stage, self._longest = stage, 0

    # -- frames and commands

    def receive(self, frame: CanFrame, now: int) -> None:
        node, can_id = self.node, frame.can_id
        if can_id == REQUEST_BASE + node.node_id:
            self._noticed(now)
        elif can_id == NMT_COB_ID and len(frame.data) == 2 and frame.data[1] in (0, node.node_id):
            self._noticed(now)
            self._start(frame.data[0])
        elif can_id == node.sync.cob_id or can_id in self._heartbeats() or any(rpdos_of(node, frame)):
            if self._cyclic is not None:
                self._longest = max(self._longest, now - self._cyclic)
            self._cyclic = now

    def _heartbeats(self) -> Iterable[int]:
        return (ERROR_CONTROL_COB_ID + node_id for node_id in self.node.consumer.watched())

    def _start(self, command: int) -> None:
        stage = self.stage
        if stage is None or stage.kind != "reset" or command != NmtCommand.START:
            return
        if stage.configured and self.node.nmt.state is NmtState.PRE_OPERATIONAL:
            text = "NMT start without any SDO request after the boot-up message"
            self.findings.expect(self.boots.configured, "MF07", text)

    def _noticed(self, now: int) -> None:
        stage = self.stage
        if stage is not None:
            stage.contact = now if stage.contact is None else stage.contact
            stage.noticed = now if stage.noticed is None else stage.noticed
            if stage.kind == "silent" and now >= stage.fault_end:
                self._contacts.append(now)

    def controlword(self, word: int, now: int) -> None:
        """Record a controlword; the first change counts as a reaction of the master."""
        self._word = word
        stage = self.stage
        if stage is None:
            return
        if stage.word is not None and word & 0xFF != stage.word & 0xFF and stage.noticed is None:
            stage.noticed = now
        if not stage.words or stage.words[-1][0] != word or now - stage.words[-1][1] >= S // 2:
            stage.words.append((word, now))

    def set_point(self, index: int, value: int, now: int) -> None:
        """Record the range of a set-point during a fault, after the time allowed for the reaction."""
        stage = self.stage
        if stage is not None and stage.kind == "fault" and now - stage.begun > _GRACE_NS and now < stage.fault_end:
            values = stage.set_points.setdefault(index, [value, value])
            values[0], values[1] = min(values[0], value), max(values[1], value)

    # -- the end of a stage

    def end(self) -> None:
        """End the current stage, and check the master's reaction."""
        stage, self.stage = self.stage, None
        if stage is None:
            return
        judge = {"fault": self._fault, "power": self._power, "leaves": self._leaves, "flood": self._flood}
        judge |= {"reset": self._reset, "heartbeat": self._heartbeat, "silent": self._silent}
        judge[stage.kind](stage)
        self._contacts.clear()

    def _commands_enable(self, stage: Stage, begin: int) -> tuple[int, int] | None:
        """Return the first controlword after `begin` that enables the drive again, with its time, or None."""
        before = stage.word or 0
        for word, time in stage.words:
            new = word & _ENABLE_BITS == _ENABLE_BITS != before & _ENABLE_BITS
            if new and not word & FAULT_RESET_BIT and time > begin:
                return word, time
            before = word
        return None

    def _not_enabled(self, stage: Stage, check_id: str) -> None:
        """Check that the master does not re-enable a drive that was enabled at the start of the stage."""
        if not stage.enabled:
            return
        commanded = self._commands_enable(stage, stage.begun)
        text = (
            ""
            if commanded is None
            else f"controlword 0x{commanded[0]:04X} {(commanded[1] - stage.begun) / S:.1f} s after: {stage.title}"
        )
        self.findings.expect(commanded is None, check_id, text)

    def _fault(self, stage: Stage) -> None:
        late = [(word, time) for word, time in stage.words if stage.begun + _GRACE_NS < time < stage.fault_end]
        if late:
            early = next(
                ((w, t) for w, t in late if w & _ENABLE_BITS == _ENABLE_BITS and not w & FAULT_RESET_BIT), None
            )
            text = (
                ""
                if early is None
                else f"controlword 0x{early[0]:04X} {(early[1] - stage.begun) / S:.1f} s after FAULT"
            )
            self.findings.expect(early is None, "MF01", text)
        for index, (low, high) in stage.set_points.items():
            moves = low != 0 or high != 0 if index in _RATES else high - low > window_of(self.node)
            self.findings.expect(not moves, "MF02", f"0x{index:04X} from {low} to {high}")

    def _power(self, stage: Stage) -> None:
        self._not_enabled(stage, "MF03")

    def _leaves(self, stage: Stage) -> None:
        if stage.operational:
            self._in_time(stage, stage.noticed, "MF04", _NOTICE_NS)
        self._not_enabled(stage, "MF05")

    def _flood(self, stage: Stage) -> None:
        if self._cyclic is not None and stage.operational:
            longest = max(self._longest, stage.fault_end - self._cyclic)
            self.findings.expect(longest <= _SILENCE_NS, "MF06", f"no cyclic frame for {longest / MS:.0f} ms")

    def _reset(self, stage: Stage) -> None:
        if stage.configured and not (stage.also or stage.holds):
            self._in_time(stage, stage.contact, "MF08", _RESET_NOTICE_NS)
        self._not_enabled(stage, "MF09")

    def _heartbeat(self, stage: Stage) -> None:
        if self.node.heartbeat.period_ns:
            self._in_time(stage, stage.noticed, "MF10", _NOTICE_NS)
        self._not_enabled(stage, "MF11")

    def _silent(self, stage: Stage) -> None:
        if stage.configured:
            good = bool(self._contacts) and self._contacts[0] - stage.fault_end <= _RETURN_NOTICE_NS
            self.findings.expect(good, "MF12", "no NMT command and no SDO request in 6 s")

    def _in_time(self, stage: Stage, reaction: int | None, check_id: str, limit: int) -> None:
        delay = None if reaction is None else reaction - stage.begun
        text = "nothing" if delay is None else f"first reaction after {delay / S:.1f} s"
        self.findings.expect(delay is not None and delay <= limit, check_id, text)
        if delay is not None:
            self.findings.note(check_id, f"{stage.title}: first reaction after {delay / MS:.0f} ms")
