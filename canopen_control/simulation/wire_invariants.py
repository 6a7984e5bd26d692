"""Invariants of the bus: timing of the master, bus load, order of SDO requests, configuration of the drives.

The timing of a stalled, killed or disconnected master is checked only from some time after its return. Times are in ns.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any, Final

from canopen_control.cia301.pdo import INVALID_BIT, NO_RTR_BIT
from canopen_control.cia402.objects import HOMING_SPEEDS, INTERPOLATION_BUFFER, PROFILE_VELOCITY, axis_of
from canopen_control.frame import RECORD, is_restricted
from canopen_control.master.budget import budget_of
from canopen_control.od.codec import encode
from canopen_control.simulation.robot_under_test import MASTER

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.cia301.pdo import MappedObject
    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedWrite
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.simulation.answer_invariants import AnswerInvariants
    from canopen_control.simulation.robot_under_test import RobotUnderTest
    from canopen_control.simulation.simulated_wire import SimulatedWire
    from canopen_control.simulation.wire_view import DisturbedNodes, WireView
    from canopen_control.virtual.virtual_node import VirtualNode


# Invariants of configuration: a drive has the values of its plan, and no PDO is active with an invalid COB-ID. The plan
# is compared with the drive once after each boot, when the robot reports the node as ready; nodes disturbed meanwhile,
# except by foreign frames, are skipped. COB-IDs of active PDOs are checked whenever a value of the drive has changed.
# Values decoded by the robot from objects wider than 32 bits, which are not feedback of an axis, are compared with the
# device. Times are in ns.


_MS: Final = 1_000_000
_EVERY_NS: Final = 100 * _MS  # interval of the checks
_LAG_NS: Final = 120 * _MS  # time allowed for a value of a TPDO
_CALM_NS: Final = 3000 * _MS  # time since a disturbance of the node, during which it may still boot
_RECORDS: Final = (*range(0x1400, 0x1600), *range(0x1800, 0x1A00))
_LOWERED: Final = (PROFILE_VELOCITY, HOMING_SPEEDS)  # reduced to the velocity limit of the description after the boot
# a read returns another value than the written one (CiA 301, 7.5.2.13 and 7.5.2.14)
_PROCEDURES: Final = (0x1010, 0x1011)
_WIDE: Final = 32  # objects above this width are checked only here


class _Configured:
    """Node with its last checked boot, its PDO records, and the recent values of its wide objects."""

    def __init__(self, name: str, plan: NodePlan) -> None:
        self.name, self.plan = name, plan
        self.boots = 0
        self.version: tuple[object, int] = None, -1
        self.records: tuple[int, ...] = ()  # mapping records of its PDOs
        self.bad: set[int] = set()
        self.wide = [
            (layout.cob_id, position, mapped, deque[tuple[int, object]]())
            for layout in plan.tpdos
            for position, mapped in enumerate(layout.objects)
            if mapped.bits > _WIDE
        ]


class ConfigurationInvariants:
    """Checks the configuration of all nodes; violations are passed to `report(rule, text)`."""

    def __init__(
        self,
        robot: RobotUnderTest,
        plans: Iterable[NodePlan],
        disturbed: DisturbedNodes,
        answers: AnswerInvariants,
        report: Callable[[str, str], None],
    ) -> None:
        self._robot, self._disturbed, self._answers, self._report = robot, disturbed, answers, report
        self._nodes = [_Configured(plan.name, plan) for plan in plans]
        self._wide = [node for node in self._nodes if node.wide]
        self._next_check = robot.now_ns + _EVERY_NS
        self._core: object = None

    def on_sample(self, now: int) -> None:
        for node in self._wide:
            self._note(node, now)
        if now < self._next_check:
            return
        self._next_check = now + _EVERY_NS
        robot = self._robot
        if robot.core is not self._core:
            self._core = robot.core
            for node in self._nodes:
                node.boots = 0
        for node in self._nodes:
            device = robot.drives[node.plan.node_id].device
            if device is None:
                continue
            self._judge_pdos(node, device)
            remote = robot.core.nodes[node.name]
            if robot.up and remote.ready and now >= robot.host.stalled_until:
                self._judge_boot(node, remote, device, now)
                self._judge_wide(node, remote, now)

    # -- values written by a boot

    def _judge_boot(self, node: _Configured, remote: RemoteNode, device: VirtualNode, now: int) -> None:
        if remote.boots == node.boots:
            return
        node.boots = remote.boots
        # foreign frames do not excuse a wrong configuration
        disturbed = max(self._disturbed.moved(node.plan.node_id), self._disturbed.deaf_at)
        if disturbed and disturbed > now - _CALM_NS:
            return
        carried = {(mapped.index, mapped.subindex) for layout in node.plan.rpdos for mapped in layout.objects}
        carried |= {(INTERPOLATION_BUFFER + offset, 6) for offset in node.plan.axes}  # open during a motion only
        final = {write.address: write for write in node.plan.writes if write.address not in carried}
        wrong = [f"0x{write.index:04X}:{write.subindex:02X}" for write in final.values() if not _holds(device, write)]
        since = self._robot.started_ns  # a boot reports a drive that keeps another value
        wrong = [name for name in wrong if not self._answers.reported(node.plan.node_id, since, name)]
        if wrong:
            names = ", ".join(wrong)
            self._report("plan_unwritten", f"{node.name} is ready but does not have the planned values of {names}")

    # -- forbidden values

    def _judge_pdos(self, node: _Configured, device: VirtualNode) -> None:
        """Report a PDO that became valid with a restricted COB-ID that is not in the EDS.

        A device starts with the values of its file, and a PDO with such a COB-ID transfers nothing (CiA 301, table 40).
        """
        store = device.store
        if node.version == (store, store.version):
            return
        if node.version[0] is not store:
            node.records = tuple(index for index in _RECORDS if (index, 1) in device.od)
        node.version = store, store.version
        bad = set()
        for index in node.records:
            entry = store.get(index, 1)
            if isinstance(entry, int) and not entry & INVALID_BIT and is_restricted(entry & 0x1FFFFFFF):
                if entry == (device.od[index, 1].value or 0):
                    continue
                bad.add(index)
                if index not in node.bad:
                    text = f"the PDO 0x{index:04X} of {node.name} is active with COB-ID 0x{entry & 0x1FFFFFFF:03X}"
                    self._report("cob_id_restricted", text)
        node.bad = bad

    # -- decoded values

    def _note(self, node: _Configured, now: int) -> None:
        device = self._robot.drives[node.plan.node_id].device
        for _, _, mapped, values in node.wide:
            if device is None:
                values.clear()
                continue
            values.append((now, device.get(mapped.index, mapped.subindex)))
            while values[0][0] < now - _LAG_NS:
                values.popleft()

    def _judge_wide(self, node: _Configured, remote: RemoteNode, now: int) -> None:
        """Compare the values of wide objects decoded by the robot with the recent values in the device."""
        if self._disturbed.last(node.plan.node_id) > now - _CALM_NS:
            return
        for cob_id, position, mapped, observed in node.wide:
            pdo = next((candidate for candidate in remote.received if candidate.cob_id == cob_id), None)
            if pdo is None or pdo.stamp < 0 or not observed or now - pdo.stamp > _LAG_NS:
                continue
            reported: Any = pdo.values[position]
            values: list[Any] = [value for _, value in observed]
            if isinstance(reported, int | float) and not min(values) <= reported <= max(values):
                self._report(
                    "shown_wrong",
                    f"process data: {_name(mapped)} of {node.name} is reported as {reported} but is {values[-1]}",
                )
                observed.clear()


_TRANSMISSION: Final = 2


def _holds(device: VirtualNode, write: PlannedWrite) -> bool:
    """Whether a drive has the value of a planned write; True for values that the drive may change."""
    od = device.od if device.motors is None else device.motors.device
    if write.optional or not write.compare or write.index in _PROCEDURES or write.address not in od:
        return True
    entry = od.get(*write.address)
    value = device.get(*write.address)
    if entry is None or (write.pdo is not None and write.subindex == _TRANSMISSION and not entry.writable):
        return True  # the master uses the current value of the node
    if isinstance(value, int) and entry.data_type.is_integer:
        planned = int.from_bytes(write.data, "little", signed=entry.data_type.signed)
        if write.index in _RECORDS and write.subindex == 1:
            planned, value = planned & ~NO_RTR_BIT, value & ~NO_RTR_BIT
            empty = not device.store.number(write.index + 0x200)  # a PDO that cannot be made invalid carries nothing
            return planned == value or bool(planned & INVALID_BIT and (value & INVALID_BIT or empty))
        lowered = axis_of(write.index)[0] in _LOWERED and 0 < value < planned
        return planned == value or lowered
    return encode(value, entry.data_type) == write.data


def _name(mapped: MappedObject) -> str:
    return f"0x{mapped.index:04X}:{mapped.subindex:02X}"


_SECOND: Final = 1_000_000_000
_LATE: Final = 1.6  # heartbeat or SYNC periods between two frames
_EXTRA_LOAD: Final = 0.15  # bus load of SDO and EMCY of a running robot
_BOOT_NS: Final = 3 * _SECOND  # time in which a boot may cause any bus load
_SDO_WAIT_NS: Final = 90 * _MS  # minimum time before a client may repeat a request
_ABORT, _BLOCK = 4, (5, 6)


class WireInvariants:
    """Checks one bus; violations are passed to `report(rule, text)`.

    `hear` receives the frames that `wants` selects; `on_sample` is called periodically.
    """

    def __init__(
        self, robot: RobotUnderTest, wire: SimulatedWire, view: WireView, report: Callable[[str, str], None]
    ) -> None:
        self._robot, self._wire, self._view, self._report = robot, wire, view, report
        master = view.config.master
        self._sync_ns, self._heartbeat_ns = master.sync_period * 1000, master.heartbeat_ms * _MS
        self._ours = master.sync_producer != "other"
        self._rate = master.baudrate * 1000
        period = self._sync_ns or robot.setup.cycle_ns
        self._budget = budget_of(view.config, period).load + _EXTRA_LOAD
        self._last: dict[str, int] = {}
        self._waiting: dict[int, tuple[int, bytes]] = {}  # node -> time and content of a pending SDO request
        self._in_block: set[int] = set()
        self._window, self._bits = robot.now_ns, 0
        self._quiet_until = 0
        self._heartbeat_id = 0x700 + master.node_id

    # -- frames

    def wants(self, can_id: int) -> bool:
        """Whether `hear` needs frames with this identifier."""
        return can_id in (0x80, self._heartbeat_id) or 0x580 < can_id < 0x600 or 0x600 < can_id < 0x680

    def hear(self, now: int, label: str, record: bytes) -> None:
        """Check the time of a SYNC or heartbeat, or the order of SDO requests."""
        can_id, length, data = RECORD.unpack(record)
        if label == MASTER:
            if can_id == 0x80:
                self._keeps_time("SYNC", self._sync_ns if self._ours else 0, now)
            elif can_id == self._heartbeat_id:
                self._keeps_time("heartbeat", self._heartbeat_ns, now)
            elif 0x600 < can_id < 0x680:
                self._request(can_id & 0x7F, data[:length], now)
        elif 0x580 < can_id < 0x600:
            self._waiting.pop(can_id & 0x7F, None)
            if length and data[0] >> 5 == _ABORT:
                self._in_block.discard(can_id & 0x7F)

    def _keeps_time(self, service: str, period: int, now: int) -> None:
        last, self._last[service] = self._last.get(service, 0), now
        gap = now - last
        if period and last > self._excused(now) and gap > period * _LATE:
            self._report(
                "late", f"{service} of the master was sent after {gap / 1e6:.1f} ms instead of {period / 1e6:g} ms"
            )

    def _request(self, node: int, data: bytes, now: int) -> None:
        """Check that an SDO request follows a response, an abort, or a timeout (CiA 301, 7.2.4)."""
        command = data[0] >> 5 if data else _ABORT
        if command == _ABORT:
            self._waiting.pop(node, None)
            self._in_block.discard(node)
            return
        if command in _BLOCK:
            self._in_block.add(node)
        elif command in (1, 2):
            self._in_block.discard(node)
        if node in self._in_block:
            self._waiting.pop(node, None)
            return
        pending = self._waiting.get(node)
        if pending is not None and 0 < now - pending[0] < _SDO_WAIT_NS and self._all_recorded_since(pending[0]):
            again = f"{(now - pending[0]) / 1e6:.1f} ms after {pending[1].hex(' ')}, which was not answered yet"
            self._report("sdo_overlap", f"node {node} gets the SDO request {data.hex(' ')} {again}")
        self._waiting[node] = (now, data)

    def _all_recorded_since(self, asked_ns: int) -> bool:
        """Whether no abort can have been missed: no frame was lost, and the master was not restarted."""
        return not self._wire.has_wire_faults and asked_ns > max(self._quiet_until, self._robot.started_ns)

    # -- time

    def on_sample(self, now: int) -> None:
        """Check the bus load once per second."""
        self._excused(now)
        if now - self._window < _SECOND:
            return
        bits = self._wire.bits - self._bits
        load = bits * 1e9 / (now - self._window) / self._rate
        self._window, self._bits = now, self._wire.bits
        booting = any(node.booted_at > now - _BOOT_NS for node in self._view.nodes.values())
        if load > self._budget and not booting and now > self._quiet_until and now > self._robot.started_ns + _BOOT_NS:
            self._report("bus_budget", f"the bus load is {load:.0%}, above its budget of {self._budget:.0%}")

    def _excused(self, now: int) -> int:
        """Return the time until which the master may be late after a stall, a restart, or a bus fault."""
        stalled_until = self._robot.host.stalled_until
        if now < stalled_until or self._wire.has_wire_faults:  # or a cable was cut
            self._quiet_until = now + _SECOND
        return max(self._quiet_until, stalled_until + 100 * _MS, self._robot.started_ns + _SECOND)
