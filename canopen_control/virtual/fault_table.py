"""Table of the faults of virtual nodes.

Each entry has the row in the catalogue of real drives' behaviour, the name, the affected part (such as wire or axis),
the effect, and the reaction of a correct master. A fault has one or more of three hooks: on frames that leave the
node, on frames that reach the node, or on the node itself when the fault is switched. A fault with `once` is cleared
after its effect. Clearing a fault makes the drive healthy; the master must recover from the consequences (FAULT, a
reset).
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError, nearest
from canopen_control.rpc.messages.drive import FaultListing
from canopen_control.virtual import fault_effects as effects
from canopen_control.virtual.node_outbox import FaultSwitched
from canopen_control.virtual.quirks import QUIRKS, switches_of
from canopen_control.virtual.virtual_node import VirtualNode

if TYPE_CHECKING:
    from canopen_control.frame import CanFrame
    from canopen_control.virtual.fault_effects import Incoming, Outgoing, Switch


# ruff: noqa: E501 - one fault is one line of the table


@dataclass(frozen=True, slots=True)
class Fault:
    """Fault of a virtual node: row in the catalogue, effect, and expected reaction of the master.

    `acts` is ``wire``, ``node``, ``axis``, ``program`` (nodes whose program can be loaded over CANopen), ``input`` or
    ``output`` (devices other than drives). A fault with a `quirk` is normal behaviour of some drives: switching the
    fault switches the quirk.
    """

    row: int
    name: str
    acts: str
    does: str
    reaction: str
    outgoing: Outgoing | None = None
    incoming: Incoming | None = None
    switched: Switch | None = None
    once: bool = False
    floods: bool = False
    second_node: bool = False
    quirk: str = ""

    def fits(self, node: VirtualNode) -> bool:
        """Whether a node can have the fault."""
        function = node.function
        if self.acts == "output":
            return function is not None and any(signal.output for signal in function.describe())
        parts = {"input": function is not None, "axis": bool(node.drives), "program": node.program is not None}
        return parts.get(self.acts, True)

    def listing(self, *, on: bool = False) -> FaultListing:
        """Return the entry of the fault for lists."""
        return FaultListing(
            name=self.name,
            row=self.row,
            acts=self.acts,
            does=self.does,
            reaction=self.reaction,
            once=self.once,
            on=on,
        )


_STOP_ALL = "stops all axes, names the node, and requires a new enable"
_ROWS = (
    Fault(1, "boot_late", "node", "boots 5 s after its next reset", "repeats its boot requests, and boots the other nodes meanwhile", switched=effects.boot_after(5_000_000_000)),
    Fault(1, "no_boot", "node", "does not boot after its next reset", "reports boot error B with the name of the node, and boots the other nodes", switched=effects.boot_after(None)),
    Fault(2, "spontaneous_reset", "node", "resets itself and loses everything that is not stored", "stops all axes, boots and configures the node again, and requires a new enable", switched=effects.brown_out, once=True),
    Fault(3, "heartbeat_lost", "wire", "its heartbeats are lost", f"detects the loss of the node after the consumer time, {_STOP_ALL}", outgoing=effects.heartbeat_dropped),
    Fault(3, "silent", "wire", "its cable is cut: it neither receives nor sends frames", f"detects the loss of the node after the consumer time, {_STOP_ALL}", outgoing=effects.drop_all, incoming=effects.deaf),
    Fault(4, "heartbeat_jitter", "wire", "its heartbeats are up to 60 % of a period late", "raises no alarm", outgoing=effects.jittered),
    Fault(5, "heartbeat_wrong_state", "wire", "its heartbeats show PRE-OPERATIONAL", f"detects the change of the NMT state, {_STOP_ALL}", outgoing=effects.heartbeat_wrong),
    Fault(5, "leaves_operational", "node", "enters PRE-OPERATIONAL without a command", f"detects the change of the NMT state, {_STOP_ALL}", switched=effects.drop_out, once=True),
    Fault(6, "nmt_start_ignored", "wire", "does not receive NMT start", "repeats NMT start up to three times, then reports an error with the name of the node", incoming=effects.deaf_to_start),
    Fault(7, "already_operational", "node", "is OPERATIONAL without a command", "resets communication of the node before it configures the node", quirk="already_operational"),
    Fault(8, "sdo_silent_once", "wire", "does not answer one SDO request", "repeats the request once", incoming=effects.deaf_to_sdo, once=True),
    Fault(8, "sdo_silent", "wire", "does not answer SDO requests", "reports an error with the names of node and object, and does not hang", incoming=effects.deaf_to_sdo),
    Fault(8, "sdo_late", "wire", "answers SDO requests 0.7 s late", "does not take a late answer for the answer to another request", quirk="sdo_late=0.7"),
    Fault(9, "sdo_wrong_mux", "wire", "answers SDO requests with the address of another object", "ignores the answer until the timeout", outgoing=effects.sdo_wrong_mux),
    Fault(10, "sdo_busy", "wire", "refuses SDO downloads because of its present state", "repeats the download for some seconds, then reports the reason", incoming=effects.refuses_writes),
    Fault(11, "optional_missing", "wire", "has no objects 0x603F, 0x6007 and 0x60C2", "runs without these objects", quirk="optional_missing"),
    Fault(12, "sdo_toggle_error", "wire", "repeats the toggle bit in SDO segments", "aborts and repeats the transfer, at most twice", outgoing=effects.sdo_toggled),
    Fault(12, "sdo_segment_lost", "wire", "loses the segments of SDO uploads", "aborts and repeats the transfer, at most twice", outgoing=effects.sdo_segment_lost),
    Fault(13, "sdo_no_block", "wire", "does not support SDO block transfer", "uses segmented transfer instead", quirk="sdo_no_block"),
    Fault(14, "sdo_short_answer", "wire", "sends one byte for objects that have more", "reports the wrong size, and does not use the value", outgoing=effects.sdo_one_byte),
    Fault(15, "mapping_fixed", "wire", "has a PDO mapping that cannot be written", "uses the existing mapping if it is sufficient, else reports a clear error", quirk="mapping_fixed"),
    Fault(17, "tpdo_short", "wire", "its TPDOs lack their last byte", "drops and counts these PDOs, warns once, and does not use old bytes", outgoing=effects.tpdo_shortened),
    Fault(17, "tpdo_long", "wire", "its TPDOs have an extra byte", "warns once", outgoing=effects.tpdo_lengthened),
    Fault(18, "tpdo_missing", "wire", "its TPDOs are lost", "makes a controlled stop after some cycles, and shows the age of the feedback", outgoing=effects.tpdo_dropped),
    Fault(18, "tpdo_late", "wire", "its TPDOs are 70 ms late", "shows the age of the feedback", outgoing=effects.tpdo_delayed),
    Fault(20, "sync_deaf", "wire", "does not receive SYNC", "detects that TPDOs are missing, and makes a controlled stop", incoming=effects.deaf_to_sync),
    Fault(21, "emcy_flood", "node", "sends a thousand EMCY messages per second", "limits its log, and keeps its cycle", floods=True),
    Fault(22, "emcy_short", "node", "sends an EMCY of four bytes with an unknown code", "shows the raw data", switched=effects.short_emcy, once=True),
    Fault(23, "emcy_partial_reset", "node", "sends EMCY 0x0000 (error reset) while the error register still shows an error", "keeps the other errors", switched=effects.partial_reset, once=True),
    Fault(24, "fault_on_enable", "axis", "enters FAULT when it is enabled (0x5441)", "reports the fault as the result of the enable, and does not reset the fault by itself", switched=effects.fault_on_enable),
    Fault(25, "drive_fault", "axis", "enters FAULT because of over-temperature, which persists", "names the fault; after a reset it reports that the cause persists", switched=effects.over_temperature),
    Fault(25, "short_circuit", "axis", "enters FAULT because of a short circuit, which persists", "names the fault; after a reset it reports that the cause persists", switched=effects.short_circuit),
    Fault(25, "fault_reset_ignored", "axis", "ignores a fault reset", "reports this after its timeout", switched=effects.reset_deaf),
    Fault(26, "fault_needs_reset", "node", "enters FAULT with 0x8120, which can be cleared only after a reset of its communication", "offers the sequence: reset communication, boot, fault reset", switched=effects.stubborn_fault),
    Fault(27, "transition_slow", "axis", "needs two seconds for every transition", "waits, and holds its targets", quirk="transition_slow=2"),
    Fault(28, "power_stage_off", "axis", "loses the supply of its power stage, without a fault", "reports this, stops all axes, and does not enable the drive by itself", switched=effects.power_stage_off),
    Fault(28, "undervoltage", "axis", "enters FAULT because of undervoltage, which persists", "names the fault; after a reset it reports that the cause persists", switched=effects.supply_low),
    Fault(30, "undefined_statusword", "axis", "shows a statusword that is not a state (0x0001)", "keeps the last state for some cycles, then reports an error", switched=effects.status_undefined),
    Fault(31, "mode_display_stuck", "axis", "its mode display (0x6061) never changes", "sends no set-point for the new mode, and after a timeout restores the old mode", switched=effects.mode_frozen),
    Fault(31, "mode_display_late", "axis", "changes its mode 200 ms late", "waits for the mode display", quirk="mode_display_late=0.2"),
    Fault(32, "pp_ack_missing", "axis", "does not acknowledge a set-point (bit 12)", "reports a timeout, and clears bit 4", switched=effects.ack_missing),
    Fault(32, "pp_ack_stuck", "axis", "always shows an acknowledged set-point (bit 12)", "waits until bit 12 is cleared, and reports a timeout", switched=effects.ack_stuck),
    Fault(33, "target_reached_stale", "axis", "always shows target reached (bit 10)", "waits for the acknowledgement first", switched=effects.reached_stuck),
    Fault(34, "hand_moved", "axis", "its shaft is moved by 500 counts", "sets its targets to the actual position", switched=effects.shaft_moved, once=True),
    Fault(36, "limit_switch", "axis", "reaches the positive limit switch", "reports the side and moves only in the other direction; the axes that move together with it (the wheels of a base) stop too, and require a new enable", switched=effects.limit_switch),
    Fault(37, "homing_fails", "axis", "ends homing with an error", "clears bit 4, restores the previous mode, and reports the axis as not homed", switched=effects.homing_failing),
    Fault(37, "homing_endless", "axis", "never ends homing: its switches are out of reach, and methods without a search do not end either", "reports a timeout, and clears bit 4", switched=effects.homing_endless),
    Fault(38, "position_jump", "axis", "its position jumps by a million counts", "reports an error, and does not use the jump for odometry", switched=effects.count_lost, once=True),
    Fault(38, "position_wrap", "axis", "its position is about to overflow 32 bits", "continues without a jump", switched=effects.count_wraps, once=True),
    Fault(39, "error_passive", "node", "reports that its CAN controller is error passive", "shows this", switched=effects.error_passive),
    Fault(39, "bus_off", "wire", "is bus-off, and reports this when it is back on the bus", f"detects the loss of the node after the consumer time, {_STOP_ALL}", outgoing=effects.drop_all, incoming=effects.deaf, switched=effects.recovered_from_bus_off),
    Fault(40, "duplicate_node", "wire", "has a duplicate on the bus that only sends: every heartbeat is received twice", "reports the duplicate node-ID", outgoing=effects.heartbeat_twice),
    Fault(40, "second_node", "node", "is joined by a second node with the same node-ID, which boots and answers as the first does", "reports unexpected boot-up messages and heartbeats, stops all axes, and names the node", second_node=True),
    Fault(40, "wrong_identity", "node", "shows another product code", "refuses the node at boot (error M)", switched=effects.wrong_entry(0x1018, 2, 1)),
    Fault(40, "wrong_revision", "node", "shows another revision number", "warns", switched=effects.wrong_entry(0x1018, 3, 1)),
    Fault(41, "local_control", "axis", "is under local control (bit 9 is 0)", "refuses to enable the drive, with a reason", switched=effects.local_control),
    Fault(42, "parameter_clamped", "node", "limits 0x6083 to 1000 without an error", "reads the value back and compares", quirk="parameter_clamped=1000"),
    Fault(43, "direction_inverted", "axis", "shows position and velocity with the wrong sign", "detects the wrong sign in a jog test", switched=effects.inverted),
    Fault(47, "clock_fast", "node", "has a clock that is 100 ppm fast: in CSP it sometimes uses a set-point twice", "continues; a repeated set-point is not a fault", switched=effects.clock_off_by(100.0)),
    Fault(47, "clock_slow", "node", "has a clock that is 100 ppm slow: in CSP it sometimes misses a set-point", "continues; a missed set-point is not a fault", switched=effects.clock_off_by(-100.0)),
    Fault(0, "rpdo_late", "node", "receives its RPDOs 3 ms late", "continues; the set-points that the drive reports show the delay", quirk="rpdo_late=0.003"),
    Fault(0, "rpdo_lost", "node", "does not receive one RPDO in a hundred", "continues; the set-points that the drive reports show how many are missed", switched=effects.rpdos_lost(100)),
    Fault(0, "enabled_in_preop", "axis", "obeys controlword 15 in PRE-OPERATIONAL too, and accepts set-points by SDO", "enables the drive only in OPERATIONAL, as always", quirk="enabled_in_preop"),
    Fault(0, "warning", "axis", "sets the warning bit", "shows the warning, and stops nothing", switched=effects.warning),
    Fault(0, "device_error", "node", "reports a persistent hardware error (0x5000)", "shows the error", switched=effects.hardware_error),
    Fault(0, "input_stuck", "input", "its inputs keep their values, on devices other than drives", "cannot detect this; a second sensor or a plausibility check can", switched=effects.inputs("stuck")),
    Fault(0, "input_noise", "input", "its analogue inputs have noise of 2 % of the full scale, on devices other than drives", "continues", switched=effects.inputs("noise")),
    Fault(0, "input_jump", "input", "its analogue inputs are off by a quarter of the full scale, on devices other than drives", "shows the value; a limit in the application stops the motion", switched=effects.inputs("jump")),
    Fault(0, "output_overload", "output", "its outputs are overloaded: it switches them off and reports 0x2310, which persists, on devices other than drives", "shows the error, and keeps the commanded values", switched=effects.output_overload),
    Fault(0, "program_lost", "program", "loses its program and resets; its boot loader runs, on nodes with 0x1F51", "stops all axes, and does not take the boot loader for the drive; `firmware` loads a program without its EDS", switched=effects.program_lost),
    Fault(0, "program_damaged", "program", "changes one bit of a program while it is written to flash, on nodes with 0x1F51", "reports the wrong checksum and does not start the program; the same command can be repeated", switched=effects.program_damaged),
    Fault(0, "flash_fails", "program", "its flash fails after 1024 bytes of a program, on nodes with 0x1F51", "reports this and does not start the program; the same command can be repeated", switched=effects.flash_failing),
    Fault(0, "flash_slow", "program", "needs twelve seconds to erase its program, on nodes with 0x1F51", "waits as long as the flash is busy", switched=effects.flash_slow),
    Fault(0, "following_error", "axis", "enters FAULT because of a following error (0x8611), which persists", "names the fault; after a reset it reports that the cause persists", switched=effects.following_error),
)  # fmt: skip
FAULTS: dict[str, Fault] = {fault.name: fault for fault in _ROWS}
"""All faults by name; row 0 marks faults that are not in the catalogue.

Rows 16, 29, 35 and 44 to 46 of the catalogue have no fault, because the drive behaves like that anyway, by its EDS, its
option codes or its device model; row 19 is row 18 from the start.
"""


def find_fault(name: str) -> Fault:
    """Return a fault by name; raise ConfigError if unknown."""
    fault = FAULTS.get(name)
    if fault is None:
        if name.partition("=")[0].partition("@")[0] in QUIRKS:
            raise ConfigError(
                f"{name} is a quirk, not a fault: canopen-control quirk NODE {name}, or quirk: in a scenario"
            )
        raise ConfigError(f"no fault {name!r}{nearest(name, FAULTS, listed=False)}; see: canopen-control fault list")
    return fault


def parse_fault(text: str) -> tuple[Fault, int]:
    """Parse ``name``, ``name@2.5`` or ``name@2.5s`` into fault and delay in ns; raise ConfigError if invalid."""
    name, at, seconds = text.partition("@")
    delay = 0.0
    if at:
        try:
            delay = float(seconds.removesuffix("s"))
        except ValueError:
            delay = -1.0
        if not 0.0 <= delay < 1e6:
            raise ConfigError(f"fault {text!r}: the text after @ must be a time in seconds, as in {name}@5s")
    return find_fault(name), round(delay * 1e9)


# The fault switches of one node, between the node and the wire.
#
# Without an active fault or quirk the filter is removed. Otherwise frames pass the hooks of all active faults in the
# order of the table; delayed frames are stored here until they are due.


_FLOOD_NS = 1_000_000
_OTHER_SERIAL = 1000
_DEVICES = {"axis": "drives", "program": "devices with a loadable program (0x1F51)"}


class FaultSwitches:
    """Fault switches of `node`, and the filter that applies faults and quirks to its frames."""

    def __init__(self, node: VirtualNode) -> None:
        self._node = node
        self._on: dict[str, Fault] = {}
        self._quirks: list[str] = []  # faults that are quirks, and on
        self._held: list[tuple[int, int, CanFrame]] = []  # due, order, frame
        self._ready: list[CanFrame] = []
        self._order = 0
        self._planned: list[tuple[int, str]] = []  # delay from the first tick, or due
        self._started = False
        self._flood_at: int | None = None
        self._second: VirtualNode | None = None
        self._outgoing: tuple[Outgoing, ...] = ()  # hooks of quirks, which act nearer to the node than faults
        self._incoming: tuple[Incoming, ...] = ()
        node.fault_switches = self

    @property
    def active(self) -> list[str]:
        return [*self._on, *self._quirks]

    def schedule(self, text: str) -> None:
        """Schedule a fault: ``name`` at start-up, or ``name@seconds``; raise ConfigError if invalid or impossible."""
        fault, delay_ns = parse_fault(text)
        self._require(fault)
        self._planned.append((delay_ns, fault.name))
        self._node.filter = self

    def _require(self, fault: Fault) -> None:
        node = self._node
        if not fault.fits(node):
            which = _DEVICES.get(fault.acts) or f"devices other than drives, with {fault.acts}s"
            raise ConfigError(f"{fault.name} is possible only on {which}; node {node.node_id} is {node.name}")

    def set_quirks(self, outgoing: tuple[Outgoing, ...], incoming: tuple[Incoming, ...]) -> None:
        self._outgoing, self._incoming = outgoing, incoming
        if outgoing or incoming:
            self._node.filter = self
        else:
            self._retire()

    def set(self, name: str, on: bool, now: int) -> None:
        """Switch a fault on or off; raise ConfigError for a fault that is unknown or impossible on the node."""
        fault = find_fault(name)
        if on == (name in self.active):
            return
        self._require(fault)
        if fault.quirk:
            self._set_quirk(fault, on, now)
            return
        self._node.advance_drives(now)
        self._node.filter = self
        if on:
            self._on = {n: f for n, f in FAULTS.items() if n in self._on or n == name}
        else:
            del self._on[name]
        if fault.floods:
            self._flood_at = now if on else None
        if fault.second_node:
            self._second = second_node(self._node, now) if on else None
        self._node.outbox.publish(FaultSwitched(name, on))
        if fault.switched is not None:
            fault.switched(self._node, on, now)
            if on and fault.once:
                self._off(name)
        self._node.outbox.values_changed()
        self._node.send_changes(now)
        self._retire()

    def _set_quirk(self, fault: Fault, on: bool, now: int) -> None:
        (self._quirks.append if on else self._quirks.remove)(fault.name)
        self._node.filter = self
        switches_of(self._node).set(fault.quirk, on, now)
        self._node.outbox.publish(FaultSwitched(fault.name, on))
        self._retire()

    def incoming(self, frame: CanFrame, now: int) -> CanFrame | None:
        received: CanFrame | None = frame
        if self._second is not None:
            self._second.receive(frame, now)
        for fault in tuple(self._on.values()):
            if fault.incoming is not None and received is not None:
                received = fault.incoming(self._node, received, now)
                if received is None and fault.once:
                    self._off(fault.name)
        for hook in self._incoming:
            received = received and hook(self._node, received, now)
        return received

    def outgoing(self, frames: list[CanFrame], now: int) -> list[CanFrame]:
        leaving, self._ready = self._ready, []
        if self._second is not None:
            self._second.events()  # discards the notification
            leaving += self._second.frames()
        for frame in frames:
            for delay, changed in self._changed(frame, now):
                if delay > 0:
                    self._order += 1
                    heapq.heappush(self._held, (now + delay, self._order, changed))
                else:
                    leaving.append(changed)
        return leaving

    def tick(self, now: int) -> None:
        if not self._started:
            self._started = True
            self._planned = [(now + delay, name) for delay, name in self._planned]
        while self._planned and (first := min(self._planned))[0] <= now:
            self._planned.remove(first)
            self.set(first[1], True, now)
        if self._second is not None:
            self._second.tick(now)
        while self._held and self._held[0][0] <= now:
            self._ready.append(heapq.heappop(self._held)[2])
        while self._flood_at is not None and self._flood_at <= now:
            effects.flood(self._node, now)
            self._flood_at = max(self._flood_at + _FLOOD_NS, now - 20 * _FLOOD_NS)

    def next_deadline(self) -> int | None:
        if not self._started or self._ready:
            return 0
        deadlines = [deadline for deadline, _ in self._planned] + [deadline for deadline, _, _ in self._held[:1]]
        if self._flood_at is not None:
            deadlines.append(self._flood_at)
        second = None if self._second is None else self._second.next_deadline()
        if second is not None:
            deadlines.append(second)
        return min(deadlines, default=None)

    def _changed(self, frame: CanFrame, now: int) -> list[tuple[int, CanFrame]]:
        changed = [(0, frame)]
        faults = [fault.outgoing for fault in self._on.values() if fault.outgoing is not None]
        for hook in (*self._outgoing, *faults):
            changed = [(a + b, last) for a, first in changed for b, last in hook(self._node, first, now)]
        return changed

    def _off(self, name: str) -> None:
        if self._on.pop(name, None) is not None:
            self._node.outbox.publish(FaultSwitched(name, on=False))

    def _retire(self) -> None:
        """Remove the filter if no fault or quirk needs it, no fault is scheduled and no frame is delayed."""
        quirks = self._outgoing or self._incoming or self._quirks
        if not (self._on or self._planned or self._held or self._ready or quirks) and self._started:
            self._node.filter = None


def second_node(node: VirtualNode, now: int) -> VirtualNode:
    """Return a second node with the same node-ID, as after a wrong DIP switch setting.

    The second node is the same device with another serial number; it is powered on now and boots by itself.
    """
    serial = (node.store.number(0x1018, 4) + _OTHER_SERIAL) & 0xFFFFFFFF
    second = VirtualNode(node.od, node.node_id, serial=serial, model=node.model)
    second.store.preset(0x1018, 4, serial)
    second.tick(now)
    return second
