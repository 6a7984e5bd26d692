"""Checks of a master's boot and configuration sequence (CiA 302-2; CiA 301, 7.3.2 and 7.5.2)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.heartbeat import parse_consumer_entry
from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NMT_COB_ID, NmtCommand, NmtState
from canopen_control.cia301.sdo_codec import REQUEST_BASE
from canopen_control.conformance.master_checks import MS, MasterObserver, S
from canopen_control.conformance.master_sdo import name_of
from canopen_control.frame import MAX_NODE_ID, REMOTE_FLAG, is_restricted
from canopen_control.od.indices import GUARD_TIME, HEARTBEAT_CONSUMER, HEARTBEAT_PRODUCER, LIFE_FACTOR

if TYPE_CHECKING:
    from canopen_control.conformance.master_checks import MasterFindings
    from canopen_control.conformance.master_sdo import Mux
    from canopen_control.frame import CanFrame
    from canopen_control.virtual.virtual_node import VirtualNode


_INVALID, _EXTENDED = 1 << 31, 1 << 29
_COMMUNICATION, _MAPPING = (0x1400, 0x1800), (0x1600, 0x1A00)
_OF_COMMUNICATION = range(0x1005, 0x1C00)
_COB_IDS = (0x1005, 0x1012, 0x1014)
_SETTLE_NS = 2 * S  # time from NMT start to the first node guarding request
_MAX_COMMANDS = 10  # maximum number of NMT commands per second


def is_record(index: int, bases: tuple[int, int]) -> bool:
    """Whether an object is a PDO record; `bases` are the first indices of the ranges of 512 records."""
    return any(base <= index < base + 0x200 for base in bases)


class ConfigurationObserver(MasterObserver):
    """Observer of boot, configuration and NMT; `boots` counts boot-up messages, `started` is the time of NMT start."""

    def __init__(self, node: VirtualNode, findings: MasterFindings) -> None:
        super().__init__(node, findings)
        self.boots = self.commands = 0
        self.started: int | None = None
        self.configured = False  # True once the node was configured after the boot-up
        self.guarded = False
        self._reads: set[int] = set()
        self._wrote = self._first = self._judged_start = False
        self._open: dict[Mux, str] = {}  # refused or unanswered writes, with the reason
        self._disabled: set[int] = set()  # communication records whose bit 31 was written
        self._entries: dict[int, set[int]] = {}  # by mapping record: entries written since subindex 0 was set to 0
        self._times: list[int] = []  # times of the NMT commands in the last second

    # -- frames

    def receive(self, frame: CanFrame, now: int) -> None:
        if frame.can_id == NMT_COB_ID:
            self._nmt(frame.data, now)
        elif frame.can_id == REQUEST_BASE + self.node.node_id:
            booted = self.node.nmt.state is not NmtState.INITIALISING
            if self.boots > 1 or not booted:
                self.findings.expect(booted, "MC01", "an SDO request before the boot-up message")
        elif frame.can_id == (ERROR_CONTROL_COB_ID + self.node.node_id) | REMOTE_FLAG:
            self.guarded = True

    def sent(self, frame: CanFrame) -> None:
        if frame.can_id == ERROR_CONTROL_COB_ID + self.node.node_id and frame.data == b"\0":
            self.boots += 1
            if self._open and self.started is None:
                self.findings.expect(True, "MC14", "")  # the boot has begun again instead
            self.started, self.configured, self.guarded = None, False, False
            self._reads, self._wrote, self._first = set(), False, False
            self._judged_start = False
            self._open, self._entries, self._disabled = {}, {}, set()

    def _nmt(self, data: bytes, now: int) -> None:
        expect = self.findings.expect
        is_valid = len(data) == 2 and data[0] in tuple(NmtCommand) and data[1] <= MAX_NODE_ID
        expect(is_valid, "MN01", f"NMT {data.hex(' ').upper() or 'without data'}")
        if not is_valid or data[1] not in (0, self.node.node_id):
            return
        self.commands += 1
        self._times = [time for time in self._times if now - time < S]
        self._times.append(now)
        expect(len(self._times) <= _MAX_COMMANDS, "MN03", f"{len(self._times)} NMT commands in a second")
        if data[0] == NmtCommand.START:
            booted = self.node.nmt.state is not NmtState.INITIALISING
            expect(booted, "MN02", "NMT start before the boot-up message")
            if self.node.nmt.state is NmtState.PRE_OPERATIONAL and self.started is None:
                self._start(now)

    def _start(self, now: int) -> None:
        """Check the first NMT start after a boot-up."""
        expect, number = self.findings.expect, self.node.store.number
        self.started = now
        if self._wrote:
            expect(True, "MC04", "")
        for mux, text in self._open.items():
            expect(False, "MC14", f"NMT start after {name_of(mux)} {text}")
        watched = any(self.node.consumer.watched())
        expect(watched or number(GUARD_TIME) * number(LIFE_FACTOR) > 0, "MC06", "neither 0x1016 nor 0x100C and 0x100D")

    # -- transfers

    def reading(self, mux: Mux) -> None:
        self.configured = True
        self._reads.add(mux[0])

    def writing(self, mux: Mux, data: bytes) -> None:
        index, subindex = mux
        self.configured = True
        if not self._first:
            self._first = True
            self.findings.expect(0x1000 in self._reads, "MC02", f"{name_of(mux)} was written before 0x1000 was read")
            self.findings.expect(0x1018 in self._reads, "MC03", f"{name_of(mux)} was written before 0x1018 was read")
        value = int.from_bytes(data, "little")
        if index in _OF_COMMUNICATION:
            if self.started is not None and not self._wrote:
                self.findings.expect(False, "MC04", f"{name_of(mux)} was written after NMT start")
            self._wrote = True
        if (index in _COB_IDS and not subindex) or (is_record(index, _COMMUNICATION) and subindex == 1):
            self._cob_id(mux, value)
        if is_record(index, _COMMUNICATION):
            self._communication(mux, value)
        elif is_record(index, _MAPPING):
            self._mapping(mux, value)
        elif index == HEARTBEAT_CONSUMER and subindex:
            node_id, milliseconds = parse_consumer_entry(value)
            is_own = node_id == self.node.node_id and milliseconds > 0
            self.findings.expect(not is_own, "MC15", f"{name_of(mux)} contains node {node_id}, the device itself")

    def written(self, mux: Mux, code: int | None) -> None:
        if code is None:
            if self._open.pop(mux, None) is not None:
                self.findings.expect(True, "MC14", "")
        elif mux[0] in _OF_COMMUNICATION:
            self._open[mux] = f"failed (0x{code:08X})"

    def _cob_id(self, mux: Mux, value: int) -> None:
        if value & (_EXTENDED | _INVALID):
            return
        identifier = value & 0x7FF
        good = not is_restricted(identifier)  # 0x080 and 0x100 are SYNC's and TIME's, and not in the table
        self.findings.expect(good, "MC13", f"0x{identifier:03X} for {name_of(mux)}")

    def _is_valid(self, record: int) -> bool:
        return self.node.store.has(record, 1) and not self.node.store.number(record, 1) & _INVALID

    def _communication(self, mux: Mux, value: int) -> None:
        """Check a write to a PDO communication record (CiA 301, 7.5.2.35 and 7.5.2.37)."""
        record, subindex = mux
        expect, valid = self.findings.expect, self._is_valid(record)
        if subindex == 1:
            if value & _INVALID:
                self._disabled.add(record)
            before = self.node.store.number(record, 1)
            other = (before ^ value) & 0x1FFFFFFF and not value & _INVALID
            expect(not (valid and other), "MC10", f"0x{value:08X} for {name_of(mux)}, which is 0x{before:08X}")
        elif subindex == 3:
            same = value == self.node.store.number(record, 3)
            expect(same or not valid, "MC11", f"{name_of(mux)} while the PDO is valid")

    def _mapping(self, mux: Mux, value: int) -> None:
        """Check the order of writes to a mapping record (CiA 301, 7.5.2.36)."""
        record, subindex = mux
        expect = self.findings.expect
        disabled = not self._is_valid(record - 0x200) or record - 0x200 in self._disabled  # or the device refused it
        expect(disabled, "MC07", f"{name_of(mux)} while bit 31 of its COB-ID is 0")
        state = self.node.nmt.state
        expect(state is NmtState.PRE_OPERATIONAL, "MC12", f"{name_of(mux)} in {state.text}")
        if subindex:
            zero = self.node.store.number(record, 0) == 0
            expect(zero, "MC08", f"{name_of(mux)} while 0x{record:04X}:00 is {self.node.store.number(record, 0)}")
            self._entries.setdefault(record, set()).add(subindex)
            return
        if not value:
            self._entries[record] = set()
            return
        entries = self._entries.get(record)
        if entries is None:
            return  # the master uses the present entries of the device
        text = f"{value} to 0x{record:04X}:00 after entries {', '.join(map(str, sorted(entries))) or 'none'}"
        expect(not entries or entries == set(range(1, value + 1)), "MC09", text)

    # -- time

    def tick(self, now: int) -> None:
        if self.started is not None and not self._judged_start and now - self.started > _SETTLE_NS:
            self._judged_start = True
            heartbeat = self.node.store.number(HEARTBEAT_PRODUCER)
            self.findings.expect(
                heartbeat > 0 or self.guarded, "MC05", "0x1017 is 0, and no node guarding request was received"
            )

    def finish(self) -> None:
        if self.started is not None:
            self.tick(max(self.findings.now, self.started + _SETTLE_NS + MS))
