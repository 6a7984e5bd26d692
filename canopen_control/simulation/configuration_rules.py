"""Invariants of configuration: a drive holds what its plan writes, and no PDO is active that may not be.

The plan is held against the drive itself once for each boot, when the robot tells the node as ready; who was disturbed
meanwhile, but by a stranger's frames, may hold something else. The COB-IDs of active PDOs are looked at whenever a
value of the drive has changed, and what the robot has decoded of objects wider than 32 bits, which are no feedback of
an axis, against the device. Times in ns.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any, Final

from canopen_control.cia301.pdo import INVALID_BIT, NO_RTR_BIT
from canopen_control.cia402.objects import HOMING_SPEEDS, PROFILE_VELOCITY, axis_of
from canopen_control.od.codec import encode

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.cia301.pdo import MappedObject
    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedWrite
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.simulation.disturbed_nodes import DisturbedNodes
    from canopen_control.simulation.simulated_robot import SimulatedRobot
    from canopen_control.virtual.virtual_node import VirtualNode

__all__ = ["ConfigurationRules"]

_MS: Final = 1_000_000
_EVERY_NS: Final = 100 * _MS  # how often it is looked
_LAG_NS: Final = 120 * _MS  # in which a value of a TPDO comes
_CALM_NS: Final = 3000 * _MS  # since a node was disturbed: a boot goes on for a while
_RESTRICTED: Final = ((0, 0x7F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF))
"""First and last COB-ID of those that no PDO may have (CiA 301, table 42)."""
_RECORDS: Final = (*range(0x1400, 0x1600), *range(0x1800, 0x1A00))
_LOWERED: Final = (PROFILE_VELOCITY, HOMING_SPEEDS)  # to the velocity limit of the description, after the boot
_PROCEDURES: Final = (0x1010, 0x1011)  # what is read there is no value that was written
_WIDE: Final = 32  # bits of an object above which nobody else judges it


class _Configured:
    """One node: which of its boots was judged, its PDO records, and what its wide objects were in the last cycles."""

    def __init__(self, name: str, plan: NodePlan) -> None:
        self.name, self.plan = name, plan
        self.boots = 0
        self.version: tuple[object, int] = None, -1
        self.records: tuple[int, ...] = ()  # of its PDOs
        self.bad: set[int] = set()
        self.wide = [
            (layout.cob_id, position, mapped, deque[tuple[int, object]]())
            for layout in plan.tpdos
            for position, mapped in enumerate(layout.objects)
            if mapped.bits > _WIDE
        ]


class ConfigurationRules:
    """Judges what nodes hold; `tell(rule, text)` takes breaches. `sampled` is called as time passes."""

    def __init__(
        self,
        robot: SimulatedRobot,
        plans: Iterable[NodePlan],
        disturbed: DisturbedNodes,
        tell: Callable[[str, str], None],
    ) -> None:
        self._robot, self._disturbed, self._tell = robot, disturbed, tell
        self._nodes = [_Configured(plan.name, plan) for plan in plans]
        self._wide = [each for each in self._nodes if each.wide]
        self._due = robot.now_ns + _EVERY_NS
        self._core: object = None

    def sampled(self, now: int) -> None:
        """Judge what nodes hold now."""
        for node in self._wide:
            self._note(node, now)
        if now < self._due:
            return
        self._due = now + _EVERY_NS
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
            there = robot.core.nodes[node.name]
            if robot.up and there.ready and now >= robot.host.stalled_until:
                self._judge_boot(node, there, device, now)
                self._judge_wide(node, there, now)

    # -- what a boot has written

    def _judge_boot(self, node: _Configured, there: RemoteNode, device: VirtualNode, now: int) -> None:
        if there.boots == node.boots:
            return
        node.boots = there.boots
        disturbed = max(self._disturbed.moved(node.plan.node_id), self._disturbed.deaf_at)  # strangers excuse nothing
        if disturbed and disturbed > now - _CALM_NS:
            return
        final = {write.address: write for write in node.plan.writes}
        wrong = [write for write in final.values() if not _holds(device, write)]
        if wrong:
            names = ", ".join(f"0x{write.index:04X}:{write.subindex:02X}" for write in wrong)
            self._tell("plan_unwritten", f"{node.name} is ready, and does not hold what the plan writes to {names}")

    # -- what it may not hold

    def _judge_pdos(self, node: _Configured, device: VirtualNode) -> None:
        """Tell of a PDO that has become active with a COB-ID that none may have."""
        store = device.store
        if node.version == (store, store.version):
            return
        if node.version[0] is not store:
            node.records = tuple(index for index in _RECORDS if (index, 1) in device.od)
        node.version = store, store.version
        bad = set()
        for index in node.records:
            entry = store.get(index, 1)
            if isinstance(entry, int) and not entry & INVALID_BIT and _is_restricted(entry & 0x1FFFFFFF):
                bad.add(index)
                if index not in node.bad:
                    text = f"the PDO 0x{index:04X} of {node.name} is active with COB-ID 0x{entry & 0x1FFFFFFF:03X}"
                    self._tell("cob_id_restricted", text)
        node.bad = bad

    # -- what is decoded of it

    def _note(self, node: _Configured, now: int) -> None:
        device = self._robot.drives[node.plan.node_id].device
        for _, _, mapped, seen in node.wide:
            if device is None:
                seen.clear()
                continue
            seen.append((now, device.get(mapped.index, mapped.subindex)))
            while seen[0][0] < now - _LAG_NS:
                seen.popleft()

    def _judge_wide(self, node: _Configured, there: RemoteNode, now: int) -> None:
        """Hold what the robot has decoded against what the object was in the last cycles."""
        if self._disturbed.last(node.plan.node_id) > now - _CALM_NS:
            return
        for cob_id, position, mapped, seen in node.wide:
            pdo = next((each for each in there.received if each.cob_id == cob_id), None)
            if pdo is None or pdo.stamp < 0 or not seen or now - pdo.stamp > _LAG_NS:
                continue
            told: Any = pdo.values[position]
            values: list[Any] = [value for _, value in seen]
            if isinstance(told, int | float) and not min(values) <= told <= max(values):
                self._tell("shown_wrong", f"process data: {_name(mapped)} of {node.name} is {told}, it is {values[-1]}")
                seen.clear()


def _holds(device: VirtualNode, write: PlannedWrite) -> bool:
    """Whether a drive holds what a write gives it; what it need not hold counts as held."""
    if write.optional or not write.compare or write.index in _PROCEDURES or write.address not in device.od:
        return True
    entry = device.od.get(*write.address)
    value = device.store.get(*write.address)
    if entry is None:
        return True
    if isinstance(value, int) and entry.data_type.is_integer:
        planned = int.from_bytes(write.data, "little", signed=entry.data_type.signed)
        if write.index in _RECORDS and write.subindex == 1:
            planned, value = planned & ~NO_RTR_BIT, value & ~NO_RTR_BIT
            return planned == value or bool(planned & value & INVALID_BIT)
        lowered = axis_of(write.index)[0] in _LOWERED and 0 < value < planned
        return planned == value or lowered
    return encode(value, entry.data_type) == write.data


def _is_restricted(cob_id: int) -> bool:
    return any(low <= cob_id <= high for low, high in _RESTRICTED)


def _name(mapped: MappedObject) -> str:
    return f"0x{mapped.index:04X}:{mapped.subindex:02X}"
