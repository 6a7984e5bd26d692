"""Events of a node apart from its boot: EMCY messages, missing or malformed frames, and wrong boot-ups.

TPDOs that are overdue or have another length, heartbeats of another length, a second node with the same node-ID and a
node that repeats its boot-up are reported. Every text begins with the node-ID and the name. The active errors of EMCY
messages are recorded even if a message is not reported; a flood of messages is reported as one summary.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.emcy import MANUFACTURER_BYTES, EmcyConsumer
from canopen_control.master.event_log import Event, Level
from canopen_control.master.supervision import DuplicateWatch, EmcyGate

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.master.cycle import ReceivedPdo
    from canopen_control.master.keys import NodeConfig
    from canopen_control.rpc.messages.fault import FaultEvent


_CHAIN = "; if a fault reset has no effect: nmt reset-comm, then axis fault-reset, then axis enable"
_HINTS = {
    0x8120: _CHAIN,
    0x8130: _CHAIN,
    0x8240: "; the node expects another SYNC length: compare sync_overflow in bus.yml with its 0x1019",
}
"""Advice by EMCY error code."""


class NodeLog:
    """Events of a node, passed to `report`; `errors` are the errors reported by EMCY and not yet reset.

    `period_ns` is the period of the node's heartbeat, 0 without a heartbeat.
    """

    def __init__(self, config: NodeConfig, report: Callable[[Event], None], period_ns: int) -> None:
        self.label = f"node {config.node_id} ({config.name})"
        self.errors = EmcyConsumer(config.node_id)
        self._name, self._report = config.name, report
        self.astray: dict[ReceivedPdo, int] = {}
        """TPDOs received with their default identifier instead of the configured one, with that identifier."""
        self._gate = EmcyGate()
        self._odd_heartbeat = False
        self._duplicates = DuplicateWatch(period_ns)

    def report(
        self, now: int, kind: str, text: str, level: Level = Level.INFO, details: FaultEvent | None = None
    ) -> None:
        """Report an event of the node; the text is prefixed with node-ID and name."""
        self._report(Event(now, kind, self._name, f"{self.label}: {text}", level, details))

    @property
    def deadline(self) -> int | None:
        """Time at which `tick` reports the next event, or None."""
        return self._gate.deadline

    def tick(self, now: int) -> None:
        """Report the number of suppressed EMCY messages, if due."""
        if count := self._gate.summary(now):
            self.report(
                now, "emcy_flood", f"{count} more EMCY within a second, not reported individually", Level.WARNING
            )

    def heartbeat_changed(self, period_ns: int) -> None:
        """Set the expected heartbeat period of the node in ns."""
        self._duplicates.set_period(period_ns)

    def emcy(self, fault: FaultEvent, now: int, hints: Mapping[int, str] | None = None) -> str | None:
        """Report the fault of an EMCY message; return the error as text, or None for an error reset.

        `hints` is advice by EMCY code, which takes precedence over the general advice.
        """
        is_passed = self._gate.passes(now)
        code, data = fault.error_code or 0, bytes.fromhex(fault.data or "")
        if fault.is_over:
            if is_passed:
                active = ", ".join(f"0x{code:04X}" for code in self.errors.active)
                also = f"; still active: {active}" if active else ""
                cleared = f"error reset (EMCY 0x{code:04X}){also}"
                self.report(now, "emcy_reset", cleared, details=fault)
            return None
        text = f"EMCY {fault.code_text}"
        if is_passed:
            raw = f"register 0x{fault.error_register or 0:02X}, data {data.hex(' ') or 'none'}"
            short = "" if len(data) == MANUFACTURER_BYTES else f"; {len(data) + 3} bytes, the standard has 8"
            hint = (hints or {}).get(code, _HINTS.get(code, ""))
            self.report(now, "emcy", f"{text}, {raw}{short}{hint}", Level.WARNING, fault)
        return text

    def pdo(self, pdo: ReceivedPdo, now: int) -> None:
        """Report that a TPDO is overdue, or received again."""
        title = f"TPDO with identifier 0x{pdo.cob_id:03X}"
        pause = f"{pdo.silent} SYNCs" if pdo.every else f"{pdo.age_limit_ns / 1e9:g} s, three times its event timer"
        if not pdo.overdue:
            self.report(now, "pdo_back", f"its {title} is received again")
        elif pdo.stamp < 0:
            advice = self._stray_text(pdo) or "check its transmission type and inhibit time"
            text = f"its {title} was not received within {pause} after the start; {advice}"
            self.report(now, "pdo_missing", text, Level.ERROR)
        else:
            stray = self._stray_text(pdo)
            text = f"no {title} for {pause}; its values are stale{stray and f'; {stray}'}"
            self.report(now, "pdo_stale", text, Level.ERROR)

    def _stray_text(self, pdo: ReceivedPdo) -> str:
        """Return a text about frames with a TPDO's default identifier, or "" if none were received."""
        default = self.astray.get(pdo)
        if default is None:
            return ""
        return (
            f"frames with its default 0x{default:03X} are received instead: the node has returned to its own COB-IDs, "
            "also for its RPDOs; set `cob_id: auto` for its PDOs in bus.yml"
        )

    def malformed(self, pdo: ReceivedPdo, length: int, now: int) -> None:
        """Report a TPDO frame of the wrong length, once per boot, TPDO and length."""
        if pdo.reported_lengths & 1 << length:
            return
        pdo.reported_lengths |= 1 << length
        kind, reaction = ("short", "it is dropped") if length < pdo.codec.length else ("long", "the rest is ignored")
        text = f"its TPDO 0x{pdo.cob_id:03X} is too {kind}: {length} bytes instead of {pdo.codec.length}; {reaction}"
        self.report(now, f"pdo_{kind}", text, Level.WARNING)

    def short_emcy(self, data: bytes, now: int) -> None:
        """Report an EMCY message without an error register (CiA 301, 7.2.7), which cannot be processed."""
        if self._gate.passes(now):
            text = (
                f"an EMCY message of {len(data)} bytes (data {data.hex(' ') or 'none'}) is ignored; the standard has 8"
            )
            self.report(now, "emcy_short", text, Level.WARNING)

    def check_heartbeat(self, length: int, now: int) -> None:
        """Report once per boot a heartbeat of the wrong length, which does not count."""
        if length != 1 and not self._odd_heartbeat:
            self._odd_heartbeat = True
            # CiA 301, 7.2.8.3.2.2: a heartbeat has one byte
            text = (
                f"its heartbeat has {length} bytes instead of 1, so it does not count; correct the program of the node"
            )
            self.report(now, "heartbeat_malformed", text, Level.WARNING)

    def heartbeat(self, now: int, since: int | None = None) -> None:
        """Record a heartbeat, and report a rate that indicates two nodes with the same node-ID."""
        if self._duplicates.heartbeat(now, since):
            self._report_duplicate("its heartbeats are twice as frequent as configured", now)

    def reset(self) -> None:
        """Expect a boot-up message, because a reset was sent to the node."""
        self._duplicates.reset()

    def boot_up(self, now: int, since: int | None = None) -> None:
        """Clear earlier errors after a boot-up; report two nodes with one node-ID, and endless boot-ups."""
        self.errors.forget()
        self.astray.clear()
        self._odd_heartbeat = False
        was_stuck = self._duplicates.stuck
        if self._duplicates.boot_up(now, since):
            self._report_duplicate("two boot-ups arrived at once", now)
        elif self._duplicates.stuck and not was_stuck:
            text = (
                "it repeats its boot-up (0x00) like a heartbeat and never shows a state: it has not left INITIALISING "
                "after a reset. Correct its program (LocalNode of python canopen: set node.nmt.state = "
                "'PRE-OPERATIONAL' after each reset), or restart the node"
            )
            self.report(now, "boot_up_repeated", text, Level.ERROR)

    def _report_duplicate(self, evidence: str, now: int) -> None:
        text = f"two devices seem to have this node-ID: {evidence}; change one of them (lss, or switches of the device)"
        self.report(now, "duplicate_node", text, Level.ERROR)
