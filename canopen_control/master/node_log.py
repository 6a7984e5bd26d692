"""Events of a node beside its boot: emergencies, missing process data, a second node with its id.

The law of this file: every sentence names the node and says what it means or what helps. Emergencies are kept (the
errors that last) whatever is told of them; a flood is told in sum.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.emcy import EmcyConsumer
from canopen_control.cia301.emcy_codes import error_text
from canopen_control.master.event_log import Event, Level
from canopen_control.master.supervision import DuplicateWatch, EmcyGate
from canopen_control.rpc.messages.state import EventDetails

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.cia301.emcy import EmcyMessage
    from canopen_control.master.config import NodeConfig
    from canopen_control.master.cycle import ReceivedPdo

__all__ = ["NodeLog"]

_CHAIN = "; if a fault reset has no effect: nmt reset-comm, then axis fault-reset, then axis enable"
_HINTS = {
    0x8120: _CHAIN,
    0x8130: _CHAIN,
    0x8240: "; the length of SYNC is not what it expects: compare sync_overflow of bus.yml with its 0x1019",
}
"""EMCY code to what helps."""


class NodeLog:
    """The events of one node, handed to `report`; `errors` are those it reported and has not taken back.

    `period_ns` is that of its heartbeat, 0 for none.
    """

    def __init__(self, config: NodeConfig, report: Callable[[Event], None], period_ns: int) -> None:
        self.who = f"node {config.node_id} ({config.name})"
        self.errors = EmcyConsumer(config.node_id)
        self._name, self._report = config.name, report
        self.astray: dict[ReceivedPdo, int] = {}
        """TPDOs of which frames with their default identifier came instead, and that identifier."""
        self._gate = EmcyGate()
        self._duplicates = DuplicateWatch(period_ns)

    def tell(
        self, now: int, kind: str, text: str, level: Level = Level.INFO, details: EventDetails | None = None
    ) -> None:
        """Tell something about the node; `text` goes on after its name and a colon."""
        self._report(Event(now, kind, self._name, f"{self.who}: {text}", level, details))

    @property
    def deadline(self) -> int | None:
        """When `tick` has something to tell."""
        return self._gate.deadline

    def tick(self, now: int) -> None:
        """Tell how many emergencies were kept back."""
        if held := self._gate.summary(now):
            self.tell(now, "emcy_flood", f"{held} more EMCY within a second, not listed one by one", Level.WARNING)

    def heartbeat_changed(self, period_ns: int) -> None:
        """Expect the heartbeats of the node in another period."""
        self._duplicates = DuplicateWatch(period_ns)

    def emcy(self, message: EmcyMessage, now: int, hints: Mapping[int, str] | None = None) -> str | None:
        """Tell an emergency that `errors` heard; returns the error in words, None where one is gone.

        `hints` say what helps by EMCY code, before what is said otherwise.
        """
        told = self._gate.passes(now)
        if message.is_reset:
            if told:
                left = ", ".join(f"0x{code:04X}" for code in self.errors.active)
                also = f"; still active: {left}" if left else ""
                gone = f"an error is gone (EMCY 0x{message.error_code:04X}){also}"
                self.tell(now, "emcy_reset", gone, details=_details(message))
            return None
        text = f"EMCY 0x{message.error_code:04X} ({error_text(message.error_code)})"
        if told:
            raw = f"register 0x{message.error_register:02X}, data {message.data.hex(' ') or 'none'}"
            short = "" if message.is_complete else f"; {len(message.data) + 3} bytes, the standard has 8"
            hint = (hints or {}).get(message.error_code, _HINTS.get(message.error_code, ""))
            self.tell(now, "emcy", f"{text}, {raw}{short}{hint}", Level.WARNING, _details(message))
        return text

    def pdo(self, pdo: ReceivedPdo, now: int) -> None:
        """Tell that a TPDO stays away, or is back."""
        what = f"TPDO with identifier 0x{pdo.cob_id:03X}"
        if not pdo.overdue:
            self.tell(now, "pdo_back", f"its {what} is back")
        elif pdo.stamp < 0:
            advice = self._astray_words(pdo) or "check its transmission type and inhibit time"
            text = f"its {what} has not come within {pdo.silent} SYNCs of its start; {advice}"
            self.tell(now, "pdo_missing", text, Level.ERROR)
        else:
            astray = self._astray_words(pdo)
            text = f"no {what} for {pdo.silent} SYNCs; what it carries is stale{astray and f'; {astray}'}"
            self.tell(now, "pdo_stale", text, Level.ERROR)

    def _astray_words(self, pdo: ReceivedPdo) -> str:
        """Say that frames with the TPDO's default identifier come instead, "" where none do."""
        default = self.astray.get(pdo)
        if default is None:
            return ""
        return (
            f"frames with 0x{default:03X}, its default, come instead: the node went back to its own COB-IDs, those of "
            "its RPDOs too; write `cob_id: auto` for its PDOs in bus.yml"
        )

    def malformed(self, pdo: ReceivedPdo, length: int, now: int) -> None:
        """Tell that a TPDO's length is not the mapping's: each wrong length once per boot and TPDO."""
        if pdo.told_lengths & 1 << length:
            return
        pdo.told_lengths |= 1 << length
        kind, reaction = ("short", "it is dropped") if length < pdo.codec.length else ("long", "the rest is ignored")
        text = f"its TPDO 0x{pdo.cob_id:03X} is too {kind}: {length} bytes instead of {pdo.codec.length}; {reaction}"
        self.tell(now, f"pdo_{kind}", text, Level.WARNING)

    def heartbeat(self, now: int, since: int | None = None) -> None:
        """Take a heartbeat: too many of them come from two nodes."""
        if self._duplicates.heartbeat(now, since):
            self._tell_duplicate("its heartbeats come twice as often as configured", now)

    def reset(self) -> None:
        """Take that a reset is sent to the node."""
        self._duplicates.reset()

    def boot_up(self, now: int, since: int | None = None) -> None:
        """Take a boot-up: whatever was wrong before is gone, and two at once come from two nodes."""
        self.errors.forget()
        self.astray.clear()
        was_stuck = self._duplicates.stuck
        if self._duplicates.boot_up(now, since):
            self._tell_duplicate("two boot-ups came at once", now)
        elif self._duplicates.stuck and not was_stuck:
            text = (
                "it sends its boot-up (0x00) again and again, as others send heartbeats, and never shows a state: it "
                "did not leave INITIALISING after a reset. Its program has to (a LocalNode of python canopen: "
                "node.nmt.state = 'PRE-OPERATIONAL' after each reset), or restart it"
            )
            self.tell(now, "boot_up_repeated", text, Level.ERROR)

    def _tell_duplicate(self, what: str, now: int) -> None:
        text = f"two devices seem to have this node id: {what}; give one of them another (lss, or its switches)"
        self.tell(now, "duplicate_node", text, Level.ERROR)


def _details(message: EmcyMessage) -> EventDetails:
    return EventDetails(message.error_code, message.error_register, message.data.hex())
