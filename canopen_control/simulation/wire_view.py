"""State of the nodes and the master as decoded from bus frames alone, and the last disturbance of each node.

Frames are decoded by the PDO mappings in bus.yml; SDO downloads of the controlword are decoded too. Times are in ns.

A disturbance is a fault, a stall, a lost or foreign frame, or the absence of the robot. Invariants that compare reports
with the truth skip disturbed nodes: a drive that lost a frame does not have its target, and a drive with a broken
encoder reports wrong positions.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects as o
from canopen_control.frame import RECORD
from canopen_control.hardware.axis_parameters import planned_scales
from canopen_control.runtime.sync_choice import axis_number, node_of
from canopen_control.simulation.robot_under_test import MASTER

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator, Mapping, Sequence

    from canopen_control.cia301.pdo import MappedObject
    from canopen_control.master.config import BusConfig
    from canopen_control.master.keys import NodeConfig
    from canopen_control.master.plan import NodePlan
    from canopen_control.master.plan_builder import PlannedPdo
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.simulation.robot_under_test import RobotUnderTest, SimulatedDrive
    from canopen_control.virtual.scenario import ScenarioEvent


_SDO_DOWNLOAD: Final = (0x22, 0x2B, 0x27, 0x23, 0x2F)
_ENABLED: Final = 0x0F  # controlword bits: switch on, enable voltage, no quick stop, enable operation
_KEPT: Final = 64  # number of target values kept
_STATE: Final = 0x6F  # state bits of a statusword (CiA 402-2)
_LIMIT: Final = 0x800  # bit of an active limit
_SHOWN_ENABLED: Final = 0x27  # state bits of OPERATION ENABLED (CiA 402-2)


class ObservedNode:
    """Process data of one node on the bus: `controlword` and `targets` by object, and `statusword`.

    `timeout_ns` is the longest silence allowed, 0: unlimited. Times, 0 for never: `controlword_at` of a controlword,
    `alive_at` of the last heartbeat or guarding answer, `booted_at` of the last boot-up, `status_at` of the statusword,
    `fault_at` of the beginning of a fault; `enabled_at` of the first controlword that enables the drive,
    `shown_enabled_at` of the last statusword that shows OPERATION ENABLED; `emcy_at` of the last EMCY with an error,
    `toggled_at` of the last guarding answer with a repeated toggle bit, `limited_at` of the beginning of an active
    limit. `drive_edges` and `nmt_edges` count pairs of consecutive statuswords (state bits) and NMT states; `recent`
    contains the newest values of each target with their times.
    """

    def __init__(self, plan: NodePlan) -> None:
        self.plan, self.node_id = plan, plan.node_id
        self.timeout_ns = plan.heartbeat_timeout_ns
        self.controlword = self.statusword = 0
        self.targets: dict[int, int] = {}
        self.recent: dict[int, deque[tuple[int, int]]] = {}
        self.target_changed_at = self.controlword_at = 0
        self.alive_at = self.booted_at = self.status_at = self.enabled_at = self.shown_enabled_at = 0
        self.fault_at = self.emcy_at = self.toggled_at = self.limited_at = 0
        self.nmt, self._toggle = -1, -1
        self.drive_edges: dict[tuple[int, int], int] = {}
        self.nmt_edges: dict[tuple[int, int], int] = {}

    def alive(self, state: int, now: int) -> None:
        """Record a heartbeat or guarding response with an NMT state, where 0 is a boot-up."""
        self.alive_at = now
        if self.plan.guard:
            state = self._without_toggle(state, now)
        if state == 0:
            self.booted_at = now
        if self.nmt not in (-1, state):
            edge = self.nmt, state
            self.nmt_edges[edge] = self.nmt_edges.get(edge, 0) + 1
        self.nmt = state

    def _without_toggle(self, answer: int, now: int) -> int:
        """Check the toggle bit of a guarding response (CiA 301, 7.2.8.3.2.1); return the NMT state."""
        toggle = answer >> 7
        if answer and toggle == self._toggle:
            self.toggled_at = now
        self._toggle = toggle if answer else 1
        return answer & 0x7F

    @property
    def commanded(self) -> bool:
        return self.controlword & 0x8F == _ENABLED

    @property
    def follows(self) -> bool:
        """Whether the drive is enabled, not halted (controlword bit 8) and not at a limit (statusword bit 11)."""
        return self.controlword & 0x18F == _ENABLED and self.statusword & (_STATE | _LIMIT) == _SHOWN_ENABLED

    @property
    def in_fault(self) -> bool:
        return self.statusword & 0x4F in (0x08, 0x0F)

    @property
    def enabled(self) -> bool:
        return self.statusword & _STATE == _SHOWN_ENABLED

    def record_written(self, index: int, value: int, now: int) -> None:
        """Record a value that the master has written to the node."""
        if index == o.CONTROLWORD:
            self.controlword_at = now
            if value != self.controlword:
                was, self.controlword = self.commanded, value
                if self.commanded and not was:
                    self.enabled_at = now
        elif self.targets.get(index) != value:
            self.targets[index] = value
            self.target_changed_at = now
            self.recent.setdefault(index, deque(maxlen=_KEPT)).append((now, value))

    def targets_since(self, index: int, since: int) -> list[int]:
        """Return the values of a target that were valid since a time, in order; empty if none."""
        values: list[int] = []
        for at, value in reversed(self.recent.get(index, ())):
            values.append(value)
            if at <= since:
                break
        return values[::-1]

    def record_sent(self, index: int, value: int, now: int) -> None:
        """Record a value from the node if the object is the statusword."""
        if index == o.STATUSWORD:
            if value != self.statusword:
                self._shows(value, now)
            self.status_at = now
            if value & _STATE == _SHOWN_ENABLED:
                self.shown_enabled_at = now

    def _shows(self, value: int, now: int) -> None:
        """Record a changed statusword and its state transition."""
        before = self.statusword if self.status_at else value
        if (before ^ value) & _STATE:
            edge = before & _STATE, value & _STATE
            self.drive_edges[edge] = self.drive_edges.get(edge, 0) + 1
        if value & ~before & _LIMIT:
            self.limited_at = now
        faulty, self.statusword = self.in_fault, value
        if self.in_fault and not faulty:
            self.fault_at = now


class WireView:
    """State of one bus; `nodes` are by node-ID.

    `master_at` is the time of the master's last heartbeat, `sync_at` the time of the last SYNC.
    """

    def __init__(self, config: BusConfig) -> None:
        self.config = config
        self.nodes = {plan.node_id: ObservedNode(plan) for plan in config.plans.values()}
        self.master_at = self.sync_at = 0
        self._pdos: dict[int, tuple[ObservedNode, bool, int, tuple[tuple[int, int, int, bool], ...]]] = {}
        for plan in config.plans.values():
            view = self.nodes[plan.node_id]
            self._map(view, plan.rpdos, to_node=True)
            self._map(view, plan.tpdos, to_node=False)
        self._alive = {0x700 + node_id: view for node_id, view in self.nodes.items()}
        self._requests = {0x600 + node_id: view for node_id, view in self.nodes.items()}
        self._emcys = {0x80 + node_id: view for node_id, view in self.nodes.items()}
        self._master = 0x700 + config.master.node_id

    def _map(self, view: ObservedNode, layouts: Sequence[PlannedPdo], *, to_node: bool) -> None:
        for layout in layouts:
            bits = sum(mapped.bits for mapped in layout.objects)
            if fields := tuple(_fields(layout.objects)):
                self._pdos[layout.cob_id] = (view, to_node, bits, fields)

    def wants(self, can_id: int) -> bool:
        """Whether `hear` needs frames with this identifier."""
        identifier_sets: tuple[Container[int], ...] = (
            self._pdos,
            self._alive,
            self._requests,
            self._emcys,
            (0x80, self._master),
        )
        return any(can_id in identifiers for identifiers in identifier_sets)

    def hear(self, now: int, label: str, record: bytes) -> None:
        """Decode a frame; foreign frames are decoded too, because the robot also receives them."""
        can_id, length, data = RECORD.unpack(record)
        pdo = self._pdos.get(can_id)
        if pdo is not None:
            view, to_node, needed, fields = pdo
            if 8 * length < needed:  # the receiver drops a short PDO (CiA 301, 7.2.2.5)
                return
            bits = int.from_bytes(data, "little")  # no field reaches beyond `needed`
            take = view.record_written if to_node else view.record_sent
            for index, at, mask, signed in fields:
                value = bits >> at & mask
                if signed and value > mask >> 1:
                    value -= mask + 1
                take(index, value, now)
        elif can_id == 0x80:
            self.sync_at = now
        else:
            self._receive_service(can_id, data, length, label, now)

    def _receive_service(self, can_id: int, data: bytes, length: int, label: str, now: int) -> None:
        """Decode a frame of error control, SDO or EMCY."""
        if (view := self._alive.get(can_id)) is not None:
            view.alive(data[0] if length else 0x7F, now)
        elif can_id == self._master and label == MASTER:
            self.master_at = now
        elif (view := self._requests.get(can_id)) is not None and data[0] in _SDO_DOWNLOAD:
            index = int.from_bytes(data[1:3], "little")
            if index == o.CONTROLWORD:
                view.record_written(index, int.from_bytes(data[4:6], "little"), now)
        elif (view := self._emcys.get(can_id)) is not None and label != "stranger" and length == 8 and any(data[:2]):
            view.emcy_at = now


def watched_joints(setup: RobotSetup) -> Iterator[tuple[str, NodeConfig, Mapping[str, float]]]:
    """Yield each joint on a node's first axis, the only axis that the views decode, with its node and its scales."""
    for config in setup.joined.values():
        for joint in (joint_tag for tag in setup.description.hardware for joint_tag in tag.joints):
            node = node_of(config, joint)
            plan = None if node is None or axis_number(joint) else config.plans.get(node.name)
            if node is not None and plan is not None and plan.axes:
                yield joint.name, node, planned_scales(config, node.name, 0)


def _fields(objects: Iterable[MappedObject]) -> Iterable[tuple[int, int, int, bool]]:
    """Yield object index, bit position, mask and sign of each decoded object in a PDO."""
    at = 0
    for mapped in objects:
        if mapped.index in _JUDGED:
            signed = mapped.index in _TARGETS
            yield mapped.index, at, (1 << mapped.bits) - 1, signed
        at += mapped.bits


_TARGETS: Final = (o.TARGET_POSITION, o.TARGET_VELOCITY, o.TARGET_TORQUE)
_JUDGED: Final = (o.CONTROLWORD, o.STATUSWORD, *_TARGETS)


_CALM_NS: Final = 1_000_000_000
_OF_ALL: Final = ("frame", "kill", "lose", "double", "disturb", "bus_off", "cut", "stall")
_OF_ONE: Final = ("fault", "fault_off", "plant", "power")
_WRAPS: Final = "position_wrap"  # fault that sets the count near the end of its 32 bits, where it then wraps


class DisturbedNodes:
    """Times of the last disturbance of each node.

    `hidden_at` is the last time at which any node could not receive or answer, because of a bus, foreign frames, or the
    robot; `deaf_at` does not count foreign frames. `moved(node_id)` is the last time at which a shaft may have
    moved without a command of its drive.
    """

    def __init__(self, robot: RobotUnderTest) -> None:
        self._robot = robot
        self._last = dict.fromkeys(robot.drives, 0)
        self._moved = dict.fromkeys(robot.drives, 0)
        self._put = dict.fromkeys(robot.drives, 0)
        self.hidden_at = self.deaf_at = 0

    def moved(self, node_id: int) -> int:
        """Return the last time at which the count may have changed without a motion by the drive, or 0 for never."""
        return self._moved[node_id]

    def put(self, node_id: int) -> int:
        """Return the last time at which a fault set the count near its 32-bit limit, or 0 for never."""
        return self._put[node_id]

    def last(self, node_id: int) -> int:
        """Return the time of the last disturbance of the node, its bus or the robot, or 0 for never."""
        return self._last[node_id]

    def is_calm(self, view: ObservedNode, now: int) -> bool:
        """Whether a second has passed since the node's last disturbance, its boot and the start of the robot."""
        return max(self._last[view.node_id], view.booted_at, self._robot.started_ns) < now - _CALM_NS

    def on_event(self, now: int, act: ScenarioEvent) -> None:
        """Record the start of an event that disturbs nodes: a fault, foreign frames, or new values of the plant."""
        if act.kind in _OF_ALL:
            self._disturb_all(now)
            if act.kind != "frame":
                self.deaf_at = now
        elif act.kind in _OF_ONE:
            self._last[int(act.target)] = now
            (self._put if act.name == _WRAPS else self._moved)[int(act.target)] = now

    def on_sample(self, now: int) -> None:
        """Record all disturbances that exist at `now`."""
        robot = self._robot
        if not robot.up or now < robot.host.stalled_until:
            self._disturb_all(now)
            self.deaf_at = now
            return
        for node_id, drive in robot.drives.items():
            if drive.wire.has_wire_faults:  # including disconnected drives
                self.hidden_at = self.deaf_at = now
            if self.hidden_at == now or _is_disturbed(drive, now):
                self._last[node_id] = now
            if drive.device is None or drive.device.filter is not None:
                self._moved[node_id] = now

    def _disturb_all(self, now: int) -> None:
        self._last = dict.fromkeys(self._last, now)
        self.hidden_at = now


def _is_disturbed(drive: SimulatedDrive, now: int) -> bool:
    """Whether a drive has no supply, an active fault, or a stalled process."""
    device, actor = drive.device, drive.actor
    return device is None or actor is None or now < actor.stalled_until or device.filter is not None
