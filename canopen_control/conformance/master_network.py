"""Checks of a master's frames in operation: guarding, heartbeats, SYNC and RPDOs (CiA 301, 7.2 and 7.5.2)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NmtState, state_of_byte
from canopen_control.cia402.objects import CONTROLWORD, INTERPOLATION_TIME_PERIOD, MODES_OF_OPERATION_DISPLAY
from canopen_control.conformance.master_checks import MS, MasterObserver, S, present
from canopen_control.frame import MAX_NODE_ID, REMOTE_FLAG
from canopen_control.od.indices import CYCLE_PERIOD, GUARD_TIME, HEARTBEAT_PRODUCER, LIFE_FACTOR, SYNC_OVERFLOW

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.conformance.master_checks import MasterFindings
    from canopen_control.conformance.master_config import ConfigurationObserver
    from canopen_control.frame import CanFrame
    from canopen_control.virtual.node_pdos import MappedRpdo
    from canopen_control.virtual.virtual_node import VirtualNode


_CYCLIC_MODES = (8, 9, 10)
_SETTLE_NS = 50 * MS  # frames sent just before a change of state are not counted
_MAX_SYNCS = 100_000  # maximum number of stored intervals
_MIN_COUNT = 50  # minimum number of intervals for a result


class HeartbeatObserver(MasterObserver):
    """Observer of guarding, and of the heartbeats that 0x1016 monitors."""

    def __init__(self, node: VirtualNode, findings: MasterFindings) -> None:
        super().__init__(node, findings)
        self._last: dict[int, int] = {}
        self._sums: dict[int, tuple[int, int]] = {}  # number and sum of the intervals
        self._limits: dict[int, int] = {}  # consumer times in 0x1016, in ns
        self._announced: set[int] = set()  # nodes in 0x1016 at their previous heartbeat
        self._missing: set[int] = set()
        self._started: int | None = None
        self._guarded: int | None = None

    def receive(self, frame: CanFrame, now: int) -> None:
        node_id = (frame.can_id & 0x7FF) - ERROR_CONTROL_COB_ID
        if not 1 <= node_id <= MAX_NODE_ID:
            return
        is_own = node_id == self.node.node_id
        if frame.is_remote:
            if is_own:
                self._guard(now)
            return
        self.findings.expect(not is_own, "MH05", f"a heartbeat {frame.data.hex().upper()} with the id of the device")
        if is_own:
            return
        good = len(frame.data) == 1 and not frame.data[0] & 0x80 and state_of_byte(frame.data[0]) is not None
        guarded = len(frame.data) == 1 and bool(frame.data[0] & 0x80)  # the answer of a guarded node
        self.findings.expect(good or guarded, "MH04", f"node {node_id} sent {frame.data.hex(' ').upper() or 'no byte'}")
        self._beat(node_id, now)

    def _guard(self, now: int) -> None:
        expect, number = self.findings.expect, self.node.store.number
        expect(number(HEARTBEAT_PRODUCER) == 0, "MG01", f"a remote frame while 0x1017 is {number(HEARTBEAT_PRODUCER)}")
        guard_ns = number(GUARD_TIME) * MS
        if self._guarded is not None and guard_ns:
            gap = now - self._guarded
            expect(abs(gap - guard_ns) <= guard_ns // 2, "MG03", f"{gap / MS:.0f} ms after the one before")
            if factor := number(LIFE_FACTOR):
                expect(gap <= guard_ns * factor, "MG02", f"{gap / MS:.0f} ms after the one before")
        self._guarded = now

    def _beat(self, node_id: int, now: int) -> None:
        last = self._last.get(node_id)
        self._last[node_id] = now
        self._missing.discard(node_id)
        limit, announced = self.node.consumer.watched().get(node_id), node_id in self._announced
        if limit is None:
            return
        self._limits[node_id] = limit
        self._announced.add(node_id)
        if last is None or not announced:
            return
        gap = now - last
        number, total = self._sums.get(node_id, (0, 0))
        self._sums[node_id] = number + 1, total + gap
        text = f"{gap / MS:.0f} ms without a heartbeat of node {node_id}, announced as {limit // MS} ms"
        self.findings.expect(gap <= limit, "MH02", text)

    def sent(self, frame: CanFrame) -> None:
        if frame.can_id == ERROR_CONTROL_COB_ID + self.node.node_id and frame.data == b"\0":
            self._started = self._guarded = None
            self._last.clear()
            self._announced.clear()

    def tick(self, now: int) -> None:
        if self.node.nmt.state is not NmtState.OPERATIONAL:
            self._started = None
            return
        if self._started is None:
            self._started = now
        for node_id, limit in self.node.consumer.watched().items():
            last = self._last.get(node_id)
            if last is not None:
                self.findings.expect(True, "MH01", "")
            elif now - self._started > limit and node_id not in self._missing:
                self._missing.add(node_id)
                self.findings.expect(False, "MH01", f"no heartbeat of node {node_id} in {limit // MS} ms")
            if last is not None and now - last > 2 * limit and node_id not in self._missing:
                self._missing.add(node_id)
                self.findings.expect(False, "MH02", f"no heartbeat of node {node_id} for {(now - last) / MS:.0f} ms")

    def finish(self) -> None:
        for node_id, (number, total) in self._sums.items():
            mean, limit = total / number, self._limits[node_id]
            text = f"node {node_id}: a heartbeat every {mean / MS:.1f} ms"
            self.findings.note("MH02", text)
            self.findings.expect(2 * limit >= 3 * mean, "MH03", f"{text}, with {limit // MS} ms in 0x1016")


class SyncObserver(MasterObserver):
    """Observer of SYNC: length, counter, period and jitter."""

    def __init__(self, node: VirtualNode, findings: MasterFindings) -> None:
        super().__init__(node, findings)
        self._last: int | None = None
        self._counter: int | None = None
        self._gaps: list[int] = []
        self._cyclic_ns = 0  # interpolation time of a cyclic mode, 0 before a cyclic mode was in use
        self._missing_since: int | None = None

    def receive(self, frame: CanFrame, now: int) -> None:
        if frame.can_id != self.node.sync.cob_id:
            return
        overflow = self.node.store.number(SYNC_OVERFLOW)
        length = 1 if overflow else 0
        self.findings.expect(len(frame.data) == length, "MY02", f"{len(frame.data)} bytes with {overflow} in 0x1019")
        if overflow and len(frame.data) == 1:
            counter, before = frame.data[0], self._counter
            good = 1 <= counter <= overflow if before is None else counter == before % overflow + 1
            self.findings.expect(good, "MY03", f"{counter} after {before}")
            self._counter = counter
        if self._last is not None and self.node.nmt.state is NmtState.OPERATIONAL and len(self._gaps) < _MAX_SYNCS:
            self._gaps.append(now - self._last)
        self._last = now
        self._note_mode()

    def _note_mode(self) -> None:
        store = self.node.store
        if present(self.node, MODES_OF_OPERATION_DISPLAY) in _CYCLIC_MODES and store.has(INTERPOLATION_TIME_PERIOD, 1):
            exponent = store.number(INTERPOLATION_TIME_PERIOD, 2, -3)
            self._cyclic_ns = round(store.number(INTERPOLATION_TIME_PERIOD, 1) * 10.0 ** (9 + exponent))

    def tick(self, now: int) -> None:
        if self.node.nmt.state is not NmtState.OPERATIONAL or not self._has_synchronous():
            self._missing_since = None
            return
        if self._missing_since is None or (self._last is not None and self._last > self._missing_since):
            self._missing_since = now
        if self._last is not None and now - self._last < S:
            self.findings.expect(True, "MY01", "")
        elif now - self._missing_since > 2 * S:
            self._missing_since = now
            self.findings.expect(False, "MY01", f"no SYNC (0x{self.node.sync.cob_id:03X}) in 2 s of OPERATIONAL")

    def _has_synchronous(self) -> bool:
        pdos = self.node.pdos
        parameters = [rpdo.consumer.parameters for rpdo in pdos.rpdos.values()]
        parameters += [tpdo.producer.parameters for tpdo in pdos.tpdos.values()]
        return any(parameter.enabled and parameter.transmission_type <= 240 for parameter in parameters)

    def finish(self) -> None:
        gaps = sorted(self._gaps)
        if len(gaps) < _MIN_COUNT:
            return
        period = gaps[len(gaps) // 2]
        late = sorted(abs(gap - period) for gap in gaps if gap < 10 * period)
        mean = sum(gap for gap in gaps if gap < 10 * period) / len(late)
        most = late[min(len(late) - 1, round(len(late) * 0.99))]
        figure = f"every {mean / MS:.3f} ms; jitter: 99 % within {most / MS:.3f} ms, at most {late[-1] / MS:.3f} ms"
        self.findings.note("MY06", f"SYNC {figure}, as this computer received it")
        self.findings.expect(10 * most <= period, "MY06", figure)
        announced = self.node.store.number(CYCLE_PERIOD) * 1_000
        for check_id, nominal in (("MY04", announced), ("MY05", self._cyclic_ns)):
            if nominal:
                text = f"a mean of {mean / MS:.3f} ms, announced as {nominal / MS:g} ms"
                self.findings.expect(100 * abs(mean - nominal) <= nominal, check_id, text)


class PdoObserver(MasterObserver):
    """Observer of RPDOs, and of remote frames for TPDOs; `received` counts RPDOs."""

    def __init__(self, node: VirtualNode, findings: MasterFindings, boots: ConfigurationObserver) -> None:
        super().__init__(node, findings)
        self.received = 0
        self._boots = boots
        self._operated = False
        self._state = node.nmt.state
        self._changed = 0
        self._since_sync: dict[int, int] = {}
        self._times: dict[int, int] = {}

    def receive(self, frame: CanFrame, now: int) -> None:
        self._follow_state(now)
        if frame.is_remote:
            self._remote(frame)
        elif frame.can_id == self.node.sync.cob_id:
            self._since_sync.clear()
        else:
            for rpdo in rpdos_of(self.node, frame):
                self._rpdo(rpdo, frame, now)

    def _follow_state(self, now: int) -> None:
        if self.node.nmt.state is not self._state:
            self._state, self._changed = self.node.nmt.state, now
            self._times.clear()

    def _remote(self, frame: CanFrame) -> None:
        for tpdo in self.node.pdos.tpdos.values():
            parameters = tpdo.producer.parameters
            if parameters.enabled and parameters.cob_id == frame.can_id & ~REMOTE_FLAG:
                text = f"a remote frame for TPDO {tpdo.number + 1} (0x{parameters.cob_id:03X})"
                self.findings.expect(parameters.rtr_allowed, "MP04", text)

    def _rpdo(self, rpdo: MappedRpdo, frame: CanFrame, now: int) -> None:
        self.received += 1
        expect, name = self.findings.expect, f"RPDO {rpdo.number + 1}"
        operational = self._state is NmtState.OPERATIONAL
        # A master that has not noticed yet that the device has reset itself, or has left OPERATIONAL, is not judged;
        # nor are controlwords by which it stops a drive that it has lost.
        boots, settled = self._boots, now - self._changed > _SETTLE_NS
        is_configured = boots.started is None and (boots.configured or boots.boots <= 1)
        self._operated = self._operated or operational
        if operational or (settled and is_configured and not (self._operated and _stops(rpdo, frame))):
            expect(operational, "MP01", f"{name} in {self._state.text}")
        if not operational:
            return
        length, mapped = len(frame.data), rpdo.codec.length
        expect(length == mapped, "MP02", f"{length} bytes in {name}, which is mapped with {mapped}")
        parameters = rpdo.consumer.parameters
        if parameters.transmission_type <= 240:
            count = self._since_sync[rpdo.number] = self._since_sync.get(rpdo.number, 0) + 1
            expect(count == 1 or not self.node.sync.count, "MP03", f"{name} {count} times between two SYNCs")
        if parameters.event_timer_ms:
            gap = now - self._times.get(rpdo.number, now)
            text = f"{name} {gap / MS:.0f} ms after the one before, announced as {parameters.event_timer_ms} ms"
            expect(gap <= parameters.event_ns, "MP05", text)
        self._times[rpdo.number] = now

    def tick(self, now: int) -> None:
        self._follow_state(now)
        if self._state is NmtState.OPERATIONAL and any(
            tpdo.producer.parameters.enabled for tpdo in self.node.pdos.tpdos.values()
        ):
            self.findings.expect(True, "MP04", "")


def rpdos_of(node: VirtualNode, frame: CanFrame) -> Iterator[MappedRpdo]:
    """Yield the device's valid RPDOs that have the identifier of a frame."""
    for rpdo in node.pdos.rpdos.values():
        parameters = rpdo.consumer.parameters
        if parameters.enabled and parameters.cob_id == frame.can_id:
            yield rpdo


def values_of(rpdo: MappedRpdo, frame: CanFrame) -> Iterator[tuple[int, int]]:
    """Yield index and value of each mapped number in a frame; nothing if the frame is too short."""
    if len(frame.data) >= rpdo.codec.length:
        values = rpdo.codec.unpack(frame.data[: rpdo.codec.length])
        for entry, value in zip(rpdo.entries, values, strict=True):
            if entry is not None and isinstance(value, int):
                yield entry.index, value


def _stops(rpdo: MappedRpdo, frame: CanFrame) -> bool:
    """Whether a frame commands a drive to stop or to switch off (bit 3 of the controlword is 0)."""
    return any(index == CONTROLWORD and not value & 8 for index, value in values_of(rpdo, frame))
