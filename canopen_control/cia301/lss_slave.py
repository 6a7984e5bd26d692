"""The LSS slave: node id and bit timing of one node, set over the bus (CiA 305, 3.9).

The law: waiting until the master switches all slaves, or this one by its identity, or this one was found by fast scan;
configuring then until switched back. A new node id becomes active when an unconfigured node goes back to waiting, and
for any other node at its next reset communication. Frames that are not 8 bytes, or that do not fit the state, are
ignored and counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.cia301.lss import (
    AUTOMATIC_BIT_TIMING,
    BIT_TIMINGS,
    FAST_SCAN_START,
    MASTER_COB_ID,
    SLAVE_COB_ID,
    UNCONFIGURED,
    LssCommand,
    LssIdentity,
    LssMode,
    lss_frame,
)
from canopen_control.cia301.outbox import Outbox
from canopen_control.frame import MAX_NODE_ID

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.frame import CanFrame

__all__ = ["LssActivateBitTiming", "LssNodeIdAssigned", "LssSlave"]

OK, REFUSED, STORE_FAILED = 0, 1, 2


@dataclass(frozen=True, slots=True)
class LssNodeIdAssigned:
    """An unconfigured node has its node id: initialise with it and send the boot-up."""

    node_id: int


@dataclass(frozen=True, slots=True)
class LssActivateBitTiming:
    """Switch to `bitrate` (bit/s, 0: detect) `delay_ms` from now, and be silent for `delay_ms` after that."""

    bitrate: int
    delay_ms: int


class LssSlave:
    """One node's LSS; `node_id` is the active one (255: none), `pending_node_id` the one to come.

    `store` keeps node id and bit rate (None: unchanged) and returns whether that worked; without it storing is
    refused as not supported. `bit_timings` are the indices of table 0 that the node can do.
    """

    def __init__(
        self,
        identity: LssIdentity,
        node_id: int = UNCONFIGURED,
        *,
        bit_timings: frozenset[int] = frozenset(BIT_TIMINGS),
        store: Callable[[int, int | None], bool] | None = None,
    ) -> None:
        self.identity = identity
        self.node_id = node_id
        self.pending_node_id = node_id
        self.pending_bitrate: int | None = None
        self.bit_timings = bit_timings
        self.store = store
        self.mode = LssMode.WAITING
        self.malformed = 0
        self.ignored = 0
        self._selected = 0  # parts of the identity matched by switch selective
        self._identified = 0  # by identify remote slave
        self._scanned = 0  # the part that fast scan looks at
        self.outgoing: Outbox[CanFrame] = Outbox()
        self._events: Outbox[LssNodeIdAssigned | LssActivateBitTiming] = Outbox()
        self._services: dict[int, Callable[[bytes], None]] = self._table()

    def reset(self) -> None:
        """Take the pending node id and wait (reset communication)."""
        self.node_id = self.pending_node_id
        self.mode = LssMode.WAITING
        self._selected = self._identified = self._scanned = 0

    def receive(self, frame: CanFrame, now: int) -> None:  # noqa: ARG002 - the verb of every core
        """Serve a frame of the LSS master; other frames are ignored."""
        if frame.can_id != MASTER_COB_ID:
            return
        service = self._services.get(frame.data[0]) if len(frame.data) == 8 else None
        if service is None:
            self.malformed += 1
        else:
            service(frame.data)

    def tick(self, now: int) -> None:
        """Do nothing: this core has no timers."""

    def next_deadline(self) -> None:
        """Return None: this core has no timers."""

    def frames(self) -> list[CanFrame]:
        """Drain the answers to send."""
        return self.outgoing.drain()

    def events(self) -> list[LssNodeIdAssigned | LssActivateBitTiming]:
        """Drain what happened, in order."""
        return self._events.drain()

    def _table(self) -> dict[int, Callable[[bytes], None]]:
        table: dict[int, Callable[[bytes], None]] = {
            LssCommand.SWITCH_GLOBAL: self._switch_global,
            LssCommand.CONFIGURE_NODE_ID: self._configuring(self._configure_node_id),
            LssCommand.CONFIGURE_BIT_TIMING: self._configuring(self._configure_bit_timing),
            LssCommand.ACTIVATE_BIT_TIMING: self._configuring(self._activate_bit_timing),
            LssCommand.STORE: self._configuring(self._store),
            LssCommand.IDENTIFY_NON_CONFIGURED: self._identify_non_configured,
            LssCommand.FAST_SCAN: self._fast_scan,
            LssCommand.INQUIRE_NODE_ID: self._configuring(self._inquire_node_id),
        }
        for part in range(4):
            table[LssCommand.SWITCH_SELECTIVE + part] = self._switch_selective
            table[LssCommand.INQUIRE + part] = self._configuring(self._inquire)
        for step in range(6):
            table[LssCommand.IDENTIFY + step] = self._identify
        return table

    def _configuring(self, service: Callable[[bytes], None]) -> Callable[[bytes], None]:
        def guarded(data: bytes) -> None:
            if self.mode is LssMode.CONFIGURATION:
                service(data)
            else:
                self.ignored += 1

        return guarded

    def _answer(self, command: int, value: int = 0) -> None:
        self.outgoing.put(lss_frame(command, value, cob_id=SLAVE_COB_ID))

    def _switch_global(self, data: bytes) -> None:
        if data[1] == LssMode.CONFIGURATION:
            self.mode = LssMode.CONFIGURATION
        elif data[1] == LssMode.WAITING:
            self._leave_configuration()
        else:
            self.ignored += 1

    def _leave_configuration(self) -> None:
        was_configuring, self.mode = self.mode is LssMode.CONFIGURATION, LssMode.WAITING
        if was_configuring and self.node_id == UNCONFIGURED != self.pending_node_id:
            self.node_id = self.pending_node_id
            self._events.put(LssNodeIdAssigned(self.node_id))

    def _switch_selective(self, data: bytes) -> None:
        part = data[0] - LssCommand.SWITCH_SELECTIVE
        if part == 0:
            self._selected = 0
        matches = part == self._selected and _number(data) == self.identity[part]
        self._selected = part + 1 if matches else 0
        if self._selected == 4:
            self._selected = 0
            self.mode = LssMode.CONFIGURATION
            self._answer(LssCommand.SWITCHED)

    def _configure_node_id(self, data: bytes) -> None:
        accepted = 1 <= data[1] <= MAX_NODE_ID or data[1] == UNCONFIGURED
        if accepted:
            self.pending_node_id = data[1]
        self._answer(LssCommand.CONFIGURE_NODE_ID, OK if accepted else REFUSED)

    def _configure_bit_timing(self, data: bytes) -> None:
        accepted = data[1] == 0 and data[2] in self.bit_timings
        if accepted:
            self.pending_bitrate = 0 if data[2] == AUTOMATIC_BIT_TIMING else BIT_TIMINGS[data[2]]
        self._answer(LssCommand.CONFIGURE_BIT_TIMING, OK if accepted else REFUSED)

    def _activate_bit_timing(self, data: bytes) -> None:
        if self.pending_bitrate is None:
            self.ignored += 1
        else:
            self._events.put(LssActivateBitTiming(self.pending_bitrate, data[1] | data[2] << 8))

    def _store(self, data: bytes) -> None:
        if self.store is None:
            self._answer(data[0], REFUSED)
        else:
            self._answer(data[0], OK if self.store(self.pending_node_id, self.pending_bitrate) else STORE_FAILED)

    def _inquire(self, data: bytes) -> None:
        self._answer(data[0], self.identity[data[0] - LssCommand.INQUIRE])

    def _inquire_node_id(self, data: bytes) -> None:
        self._answer(data[0], self.node_id)

    def _identify(self, data: bytes) -> None:
        step, number = data[0] - LssCommand.IDENTIFY, _number(data)
        vendor, product, revision, serial = self.identity
        matches = (
            number == vendor,
            number == product,
            number <= revision,
            number >= revision,
            number <= serial,
            number >= serial,
        )[step]
        if step == 0:
            self._identified = 0
        self._identified = step + 1 if matches and step == self._identified else 0
        if self._identified == 6:
            self._identified = 0
            self._answer(LssCommand.IDENTIFIED)

    def _identify_non_configured(self, _data: bytes) -> None:
        if self.pending_node_id == UNCONFIGURED:
            self._answer(LssCommand.IDENTIFIED_NON_CONFIGURED)

    def _fast_scan(self, data: bytes) -> None:
        bit, part, following = data[5], data[6], data[7]
        if self.mode is not LssMode.WAITING or self.pending_node_id != UNCONFIGURED:
            return
        if bit == FAST_SCAN_START:
            self._scanned = 0
            self._answer(LssCommand.IDENTIFIED)
        elif bit > 31 or part > 3 or following > 3:
            self.ignored += 1
        elif part == self._scanned and (_number(data) ^ self.identity[part]) >> bit == 0:
            self._scanned = following
            if bit == 0 and following < part:
                self.mode = LssMode.CONFIGURATION
            self._answer(LssCommand.IDENTIFIED)


def _number(data: bytes) -> int:
    return int.from_bytes(data[1:5], "little")
