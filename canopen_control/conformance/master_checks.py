"""Checks of a master by the frames that a virtual device receives: table of the checks, and findings of a run.

`MASTER_CHECKS` declares the checks. Observers (`master_sdo`, `master_network`, `master_drive`) receive each frame
before the device does, and record their findings in `MasterFindings`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.conformance.check import CheckLevel
from canopen_control.conformance.checked_node import KEPT
from canopen_control.conformance.run import FAILED, PASSED, SKIPPED, CheckResult

if TYPE_CHECKING:
    from canopen_control.frame import CanFrame
    from canopen_control.virtual.virtual_node import VirtualNode


MS = 1_000_000
S = 1_000 * MS
_MUST, _SHOULD = CheckLevel.MUST, CheckLevel.SHOULD


class MasterCheck(NamedTuple):
    """Check of a master; `occasion` is the reported reason if the run did not permit the check."""

    id: str
    group: str
    clause: str
    level: CheckLevel
    title: str
    expected: str
    occasion: str


# ruff: noqa: E501 - one check is one line of the table
_SDO, _MAP, _NMT, _HB = "7.2.4.3", "7.5.2.36 and 7.5.2.38", "7.2.8.3", "7.2.8.3.2.2"
_BOOT, _POWER = "302-2, boot NMT slave", "402-2, 6.3 (power state machine)"
_CONTROL = "402-2, object 0x6040"
# EN 60204-1, 9.2.3 (start) and 7.5 (restoration of the supply) forbid a restart without an intended command.
_RESTART = "402-2, 6.3, with EN 60204-1, 9.2.3"

MASTER_CHECKS: tuple[MasterCheck, ...] = (
    # order of the configuration
    MasterCheck("MC01", "301", "7.3.2.2.1", _SHOULD, "no request is sent to a device that has not sent its boot-up message", "the boot-up message first", "no reset of the device was seen"),
    MasterCheck("MC02", "302", _BOOT, _SHOULD, "the device type (0x1000) is read before the first write", "an upload of 0x1000", "nothing was written by SDO"),
    MasterCheck("MC03", "302", _BOOT, _SHOULD, "the identity (0x1018) is read before the first write", "an upload of 0x1018:01", "nothing was written by SDO"),
    MasterCheck("MC04", "302", _BOOT, _SHOULD, "the configuration precedes NMT start", "the first write to 0x1005 to 0x1BFF before NMT start", "no configuration, or no NMT start, was seen"),
    MasterCheck("MC05", "301", "7.2.8.3", _MUST, "the device is supervised by a heartbeat or by guarding", "0x1017 above 0, or node guarding requests", "NMT start was not seen"),
    MasterCheck("MC06", "301", "7.5.2.19", _SHOULD, "the device supervises its master: heartbeat consumer (0x1016) or life guarding", "an entry of 0x1016, or 0x100C and 0x100D, before NMT start", "NMT start was not seen"),
    MasterCheck("MC07", "301", _MAP, _MUST, "a PDO is disabled (bit 31) before its mapping is changed", "bit 31 of its COB-ID set first", "no mapping was written"),
    MasterCheck("MC08", "301", _MAP, _MUST, "the number of mapped objects is 0 while entries are written", "0 written to subindex 0 first", "no mapping entry was written"),
    MasterCheck("MC09", "301", _MAP, _MUST, "the number of mapped objects is written last, and equals the number of entries", "the number of entries, after them", "no mapping was written"),
    MasterCheck("MC10", "301", "7.5.2.35 and 7.5.2.37", _MUST, "the identifier of a PDO is changed only while it is disabled", "bit 31 set before another identifier", "no COB-ID of a PDO was written"),
    MasterCheck("MC11", "301", "7.5.2.37", _MUST, "the inhibit time is changed only while the PDO is disabled", "bit 31 of its COB-ID set first", "no inhibit time was written"),
    MasterCheck("MC12", "301", "7.5.2.36", _SHOULD, "mappings are written in PRE-OPERATIONAL", "PRE-OPERATIONAL", "no mapping was written"),
    MasterCheck("MC13", "301", "7.3.5", _MUST, "no restricted CAN identifier is configured", "an identifier outside of table 40", "no COB-ID was written"),
    MasterCheck("MC14", "302", _BOOT, _SHOULD, "a refused or unanswered write is repeated before NMT start", "the write again, or no start", "no write was refused or unanswered"),
    MasterCheck("MC15", "301", "7.5.2.19", _MUST, "a heartbeat consumer entry names another node than the device", "the node-ID of the master", "0x1016 was not written"),
    # NMT
    MasterCheck("MN01", "301", _NMT, _MUST, "NMT commands have two bytes, a known command and a node-ID up to 127", "two bytes, command 1, 2, 80, 81 or 82", "no NMT command was seen"),
    MasterCheck("MN02", "301", "7.3.2.2.1", _MUST, "NMT start is not sent to a device that has not booted", "the boot-up message first", "NMT start was not seen"),
    MasterCheck("MN03", "301", _NMT, _SHOULD, "NMT commands to the device are not repeated without a pause", "at most 10 in a second", "no NMT command was seen"),
    # SDO
    MasterCheck("MT01", "301", _SDO, _MUST, "one SDO transfer at a time: a request follows the answer to the previous one", "no other request within 20 ms", "no SDO request was seen"),
    MasterCheck("MT02", "301", _SDO, _MUST, "SDO requests have eight bytes", "eight bytes", "no SDO request was seen"),
    MasterCheck("MT03", "301", "7.2.4.3.3 and 7.2.4.3.6", _MUST, "the toggle bit begins with 0 and alternates", "the other toggle bit", "no segment was seen"),
    MasterCheck("MT04", "301", _SDO, _MUST, "the size of a download equals that of the object", "the length of the data type", "nothing was written by SDO"),
    MasterCheck("MT05", "301", "7.2.4.3.17", _SHOULD, "a transfer without an answer ends with an abort", "an abort before the next request", "every request was answered"),
    MasterCheck("MT06", "301", _SDO, _MUST, "reserved bits and bytes of requests are 0", "zeros", "no SDO request was seen"),
    MasterCheck("MT07", "301", "7.2.4.3.17", _MUST, "an aborted transfer is not continued", "a new initiation", "no transfer was aborted"),
    MasterCheck("MT08", "301", _SDO, _SHOULD, "an unanswered request is followed by an abort, or by another request", "something within 10 s", "every request was answered"),
    MasterCheck("MT09", "301", _SDO, _SHOULD, "a silent device is not flooded with requests", "at most 20 requests in a second", "every request was answered"),
    MasterCheck("MT10", "301", _SDO, _MUST, "a late answer is not mistaken for the answer to another request", "a wait for the answer of the requested object", "no answer was late"),
    MasterCheck("MT11", "301", _SDO, _MUST, "command specifiers are known, and fit the transfer", "a command specifier of the transfer", "no SDO request was seen"),
    MasterCheck("MT12", "301", "7.2.4.3.17", _MUST, "the device aborts no transfer because of a protocol error", "no abort 0504 0001 to 0504 0004, 0503 0000", "no SDO request was seen"),
    MasterCheck("MT13", "301", "7.2.4.3.17", _SHOULD, "only objects that exist and are writable are written", "objects of the EDS", "nothing was written by SDO"),
    # error control
    MasterCheck("MG01", "301", "7.2.8.3.2.1", _MUST, "the device is not guarded while it sends heartbeats", "no remote frame while 0x1017 is above 0", "no node guarding request was seen"),
    MasterCheck("MG02", "301", "7.5.2.11 and 7.5.2.12", _MUST, "the device is guarded within its life time", "0x100C times 0x100D", "no guarding with a life time was seen"),
    MasterCheck("MG03", "301", "7.5.2.11", _SHOULD, "node guarding requests have the period 0x100C", "0x100C within 50 %", "no guarding with a guard time was seen"),
    MasterCheck("MH01", "301", "7.5.2.19", _MUST, "the node in 0x1016 sends heartbeats", "its heartbeat within the consumer time of NMT start", "0x1016 has no entry"),
    MasterCheck("MH02", "301", _HB, _MUST, "heartbeats arrive within the consumer time in 0x1016", "the consumer time", "no heartbeat of a node in 0x1016 was seen"),
    MasterCheck("MH03", "301", "7.5.2.19", _SHOULD, "the consumer time is at least 1.5 periods of the heartbeat", "1.5 periods", "no heartbeat of a node in 0x1016 was seen"),
    MasterCheck("MH04", "301", _HB, _MUST, "heartbeats have one byte with a known state", "00, 04, 05 or 7F", "no heartbeat of another node was seen"),
    MasterCheck("MH05", "301", _HB, _MUST, "no other node sends heartbeats with the node-ID of the device", "a node-ID of its own", "no frame of another node was seen"),
    # SYNC
    MasterCheck("MY01", "301", "7.2.2.3 and 7.5.2.5", _MUST, "SYNC is sent if synchronous PDOs are configured", "SYNC with the identifier of 0x1005", "no synchronous PDO was in operation"),
    MasterCheck("MY02", "301", "7.5.2.22 (object 0x1019)", _MUST, "SYNC has the length that 0x1019 defines", "0 bytes without a counter, 1 byte with a counter", "no SYNC was seen"),
    MasterCheck("MY03", "301", "7.5.2.22 (object 0x1019)", _MUST, "the counter of SYNC counts from 1 to the overflow value", "the next number", "no SYNC with a counter was seen"),
    MasterCheck("MY04", "301", "7.5.2.6 (object 0x1006)", _SHOULD, "SYNC has the period 0x1006", "the period within 1 %", "0x1006 is 0, or no SYNC was seen"),
    MasterCheck("MY05", "402", "402-2, object 0x60C2", _SHOULD, "SYNC has the interpolation time 0x60C2 as its period", "the interpolation time within 1 %", "no cyclic mode, or no SYNC, was seen"),
    MasterCheck("MY06", "301", "7.5.2.6 (object 0x1006)", _SHOULD, "99 % of the SYNCs arrive within a tenth of the period", "at most a tenth of the period", "no SYNC was seen"),
    # PDO
    MasterCheck("MP01", "301", "7.3.2.2.3", _SHOULD, "RPDOs are sent only while the device is OPERATIONAL", "no RPDO before NMT start", "no RPDO was seen"),
    MasterCheck("MP02", "301", "7.2.2.5", _MUST, "RPDOs have the mapped length", "the length of the mapping", "no RPDO was seen in OPERATIONAL"),
    MasterCheck("MP03", "301", "7.2.2.3", _SHOULD, "a synchronous RPDO is sent at most once per SYNC", "one per SYNC", "no synchronous RPDO was seen"),
    MasterCheck("MP04", "301", "7.5.2.37", _MUST, "no remote frame is sent for a TPDO whose bit 30 forbids it", "no remote frame", "no TPDO was in operation"),
    MasterCheck("MP05", "301", "7.5.2.35", _SHOULD, "an RPDO with an event timer is sent within that time", "the event timer in 0x1400:05", "no RPDO with an event timer was seen"),
    # controlword
    MasterCheck("MW01", "402", _POWER, _MUST, "switch on and enable are commanded in the order of the states", "0x06, then 0x07, then 0x0F, each when its state is shown", "the drive was not enabled"),
    MasterCheck("MW02", "402", _RESTART, _MUST, "a fault reset is not followed at once by an enable", "no enable within 0.5 s of the reset", "no fault reset was seen"),
    MasterCheck("MW03", "402", _POWER, _SHOULD, "bit 7 is 0 again after a fault reset", "bit 7 at 0 within 1 s", "no fault reset was seen"),
    MasterCheck("MW04", "402", _POWER, _SHOULD, "a fault is reset only in FAULT", "FAULT", "no fault reset was seen"),
    MasterCheck("MW05", "402", "402-2, 6.3", _SHOULD, "velocity and torque set-points are 0 before the drive is enabled", "0", "no velocity or torque set-point was seen before an enable"),
    MasterCheck("MW06", "402", "402-2, object 0x607A", _MUST, "an enable in cyclic synchronous position commands no jump", "0x607A near 0x6064", "no enable in cyclic synchronous position was seen"),
    MasterCheck("MW07", "402", "402-2, object 0x6060", _MUST, "only modes in 0x6502 are selected", "a mode in 0x6502", "no mode was selected"),
    MasterCheck("MW08", "402", "402-2, object 0x6061", _SHOULD, "the drive is enabled only after 0x6061 shows the mode", "0x6061 equal to 0x6060, and not 0", "the drive was not enabled"),
    MasterCheck("MW09", "402", _CONTROL, _MUST, "the reserved bit 10 of the controlword is 0", "0", "no controlword was seen"),
    MasterCheck("MW10", "402", "402-2, 10.3", _MUST, "a new set-point (bit 4) waits until bit 12 of the statusword is 0", "bit 12 at 0", "no set-point in profile position was seen"),
    # reaction to the faults of the device
    MasterCheck("MF01", "402", _POWER, _MUST, "after EMCY and FAULT the drive is not commanded to enable", "another controlword than 0x0F", "no fault with a controlword after it"),
    MasterCheck("MF02", "402", _POWER, _SHOULD, "after EMCY and FAULT set-points do not move any more", "a set-point that is 0 or constant", "no fault with set-points after it"),
    MasterCheck("MF03", "402", _RESTART, _MUST, "a drive that leaves OPERATION ENABLED without a fault is not enabled again", "no enable without a command", "the drive was not enabled when it left the state"),
    MasterCheck("MF04", "302", "302-2, error control", _SHOULD, "the master reacts to PRE-OPERATIONAL without a command", "NMT, SDO or another controlword within 3 s", "the device was not OPERATIONAL"),
    MasterCheck("MF05", "402", _RESTART, _MUST, "a drive in PRE-OPERATIONAL without a command is not enabled again", "no enable without a command", "the drive was not enabled when it left the state"),
    MasterCheck("MF06", "301", "7.2.7", _SHOULD, "a flood of EMCY does not disturb SYNC, heartbeat and PDOs", "no silence of 0.5 s", "no cyclic frame was seen before the flood"),
    MasterCheck("MF07", "302", _BOOT, _MUST, "a device that has reset itself is configured before NMT start", "SDO requests between boot-up and start", "the device was not started after a reset"),
    MasterCheck("MF08", "302", "302-2, error control", _SHOULD, "the master reacts to a device that has reset itself", "NMT or SDO within 5 s of its boot-up", "the device was not configured before"),
    MasterCheck("MF09", "402", _RESTART, _MUST, "a device that has reset itself is not enabled again", "no enable without a command", "the drive was not enabled when it was reset"),
    MasterCheck("MF10", "301", _HB, _SHOULD, "the master reacts to a lost heartbeat", "NMT, SDO or another controlword within 3 s", "the device sent no heartbeats"),
    MasterCheck("MF11", "402", _RESTART, _MUST, "a drive whose heartbeat was lost is not enabled again", "no enable without a command", "the drive was not enabled when its heartbeat was lost"),
    MasterCheck("MF12", "302", "302-2, error control", _SHOULD, "the master resumes contact with a device that was silent", "NMT or SDO within 6 s of its return", "the device was not configured before"),
)  # fmt: skip


@dataclass(slots=True)
class _Finding:
    occasions: int = 0
    failures: int = 0
    observed: str = ""
    seconds: float = 0.0
    notes: list[str] = field(default_factory=list)
    frames: list[str] = field(default_factory=list)


class MasterFindings:
    """Findings of the checks; `log` contains the last recorded frames, formatted as in `CheckedNode`."""

    def __init__(self) -> None:
        self.now = self.begin = 0
        self.log: deque[str] = deque(maxlen=KEPT)
        self.skipped: dict[str, str] = {}  # reasons that replace the occasion of the table
        self._by_id = {check.id: _Finding() for check in MASTER_CHECKS}

    def record(self, direction: str, frame: CanFrame) -> None:
        seconds = self.now / 1e9
        self.log.append(f"{seconds:.6f} {direction} {frame.can_id & 0x1FFFFFFF:03X} {frame.data.hex(' ').upper()}")

    def expect(self, good: bool, check_id: str, observed: str) -> None:
        """Record the outcome of a check; at the first failure, keep a copy of the log."""
        finding = self._by_id[check_id]
        finding.occasions += 1
        if good:
            return
        finding.failures += 1
        if finding.failures == 1:
            finding.observed, finding.seconds = observed, (self.now - self.begin) / 1e9
            finding.frames = list(self.log)

    def note(self, check_id: str, text: str) -> None:
        self._by_id[check_id].notes.append(text)

    def results(self) -> list[CheckResult]:
        """Return one result per check, in the order of `MASTER_CHECKS`."""
        return [self._result(check) for check in MASTER_CHECKS]

    def _result(self, check: MasterCheck) -> CheckResult:
        finding = self._by_id[check.id]
        of_check = check.id, check.group, check.clause, check.title, check.level.value
        if not finding.occasions:
            reason = self.skipped.get(check.id, check.occasion)
            return CheckResult(*of_check, SKIPPED, f"not tested: {reason}", notes=finding.notes)
        if not finding.failures:
            return CheckResult(*of_check, PASSED, notes=finding.notes)
        more = f"; {finding.failures} times in all" if finding.failures > 1 else ""
        observed = f"{finding.observed}, at {finding.seconds:.3f} s{more}"
        return CheckResult(
            *of_check, FAILED, observed, check.expected, finding.seconds, notes=finding.notes, frames=finding.frames
        )


class MasterObserver:
    """Base class of passive observers of the frames between a master and a virtual device."""

    def __init__(self, node: VirtualNode, findings: MasterFindings) -> None:
        self.node, self.findings = node, findings

    def receive(self, frame: CanFrame, now: int) -> None:
        """Check a frame from the bus, before the device receives it."""

    def sent(self, frame: CanFrame) -> None:
        """Check a frame that the device sends."""

    def tick(self, now: int) -> None:
        """Detect overdue frames; called periodically."""

    def finish(self) -> None:
        """Check the rules that concern the whole run."""


def present(node: VirtualNode, index: int) -> int:
    """Return the current value of a number, or 0 if the device does not have the object."""
    value = node.get(index) if node.store.has(index) else 0
    return value if isinstance(value, int) else 0
