"""Invariants of what a robot shows: `status`, the stream of its state, its events and `/joint_states` tell the truth.

Each is asked as a client gets it and held against the drives themselves: which states of NMT and CiA 402 they are in,
in which mode, where their shafts are and how fast they turn, within the time in which each is told. What nobody could
know (a drive that is disturbed, a bus that loses frames) is not judged; that a drive without supply is gone, and that a
fault, an EMCY or a wrong toggle bit which everybody could see has an event, is. Times in ns.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.modes import mode_name
from canopen_control.rpc.messages.samples import JointStatesSample
from canopen_control.runtime.status import readings_of, state_sample, status_message
from canopen_control.simulation.wire_view import watched_joints
from canopen_control.virtual.axis_objects import wrap32

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.rpc.messages.samples import Values
    from canopen_control.rpc.messages.state import NodeReading, RobotEvent, Snapshot
    from canopen_control.simulation.disturbed_nodes import DisturbedNodes
    from canopen_control.simulation.simulated_robot import SimulatedRobot
    from canopen_control.simulation.wire_view import NodeView, WireView

__all__ = ["LAG_NS", "FaceRules"]

_MS: Final = 1_000_000
_EVERY_NS: Final = 100 * _MS  # how often the faces are asked
_SOON_NS: Final = 400 * _MS  # in which a state that has changed is told
LAG_NS: Final = 120 * _MS  # in which values are told: some cycles
_CALM_NS: Final = 1000 * _MS  # since a node was disturbed
_PUT_S: Final = 0.3  # a count that a fault puts elsewhere is seen within this; it leaves its 32 bits later
_FLOOD_NS: Final = 1500 * _MS  # in which of many EMCYs one is told
_JUMPED: Final = "position_jump"
_SLACK: Final = 0.02
_LEAST: Final = 1e-3  # rad, rad/s, m or m/s
_MARGIN_S: Final = 0.3  # by which an event may be before what a listener saw
_POSITION, _VELOCITY = 1, 2
_VALUES: Final = {_POSITION: "position", _VELOCITY: "velocity"}
Faces = tuple[str, ...]
_FACES: Final[Faces] = ("status", "sample")
_PUBLISHED: Final[Faces] = ("joint_states",)
_STAMP: Final = (_PUBLISHED, "", "stamp")
_TOLD: Final = 1 << 62
Truth = tuple[int, float, float]  # time, position, velocity in SI


class _Shaft:
    """A joint behind the first axis of a node, and where its shaft was in the last cycles.

    A drive that boots anew counts from 0, and a robot goes on from where it saw it last: `offset` is by how much they
    differ, None until the next place that is told. What does not boot the drive, nor moves its count, changes nothing
    of it: `origin` is what the offset is of. Where the drive's count passes over its 32 bits, both go on.
    """

    def __init__(self, joint: str, node: str, view: NodeView, units: Mapping[str, float]) -> None:
        self.joint, self.node, self.view = joint, node, view
        self._position, self._velocity = units["pos_from_dev"], units["vel_from_dev"]
        self.truth: deque[Truth] = deque()
        self.offset: float | None = 0.0
        self.origin: tuple[object, ...] = ()
        self._shown = self._counts = 0  # what it counts, and without the turns of its 32 bits
        self._blur = 0.0  # of the offset, which was taken while it turned
        self._zero = 0.0
        self._bounds: dict[int, tuple[float, float]] = {}  # of each kind of value in the last cycles

    def take(self, robot: SimulatedRobot, now: int) -> None:
        """Note where it is."""
        device, truth = robot.drives[self.view.node_id].device, self.truth
        if device is None:
            truth.clear()
            return
        drive = device.drives[0]
        plant, units = drive.mover.plant, drive.objects.units
        if units.zero != self._zero:
            truth.clear()
            self.offset, self._zero = None, units.zero
        shown = units.user(plant.position)
        self._counts = self._counts + wrap32(shown - self._shown) if truth else shown
        self._shown = shown
        truth.append((now, self._counts * self._position, plant.velocity / units.velocity * self._velocity))
        while truth[0][0] < now - LAG_NS:
            truth.popleft()
        if self._bounds:
            self._bounds = {}

    def agrees(self, which: int, value: float | None) -> bool:
        """Whether a position or a velocity is one of the last cycles."""
        if value is None or not self.truth:
            return True
        bounds = self._bounds.get(which)
        if bounds is None:
            seen = [each[which] for each in self.truth]
            bounds = self._bounds[which] = min(seen), max(seen)
        low, high = bounds
        if which == _POSITION and self.offset is None:
            self.offset, self._blur = value - self.truth[-1][_POSITION], high - low
        if which == _POSITION:
            offset = self.offset or 0.0
            low, high = low + offset - self._blur, high + offset + self._blur
        slack = _LEAST + (high - low) + _SLACK * abs(self.truth[-1][2])
        return low - slack <= value <= high + slack


class FaceRules:
    """Judges what a robot shows; `tell(rule, text)` takes breaches. `sampled` is called as time passes."""

    def __init__(
        self,
        robot: SimulatedRobot,
        views: Mapping[str, WireView],
        disturbed: DisturbedNodes,
        tell: Callable[[str, str], None],
    ) -> None:
        self._robot, self._disturbed, self._tell = robot, disturbed, tell
        self._nodes = {
            name: view.nodes[plan.node_id] for view in views.values() for name, plan in view.config.plans.items()
        }
        self._shafts = [
            _Shaft(joint, node.name, self._nodes[node.name], node.units.of_axis(0))
            for joint, node in watched_joints(robot.setup)
        ]
        self._due = robot.now_ns + _EVERY_NS
        self._calm: dict[int, bool] = {}  # whether a node was left alone for a while, and is on its bus
        self._wrong_since: dict[tuple[Faces, str, str], int] = {}  # faces, who and what
        self._gone: dict[str, tuple[int, bool]] = {}  # node without supply -> since when, whether it was told ready
        self._ready: dict[str, bool] = {}
        self._told_faults: dict[tuple[str, str], int] = {}
        self._emcys: dict[str, int] = {}  # node -> an EMCY that has to be told, 0: none
        self._emcys_told: dict[str, int] = {}  # node -> the last one that was looked for
        self._ready_since: dict[str, int] = {}  # node -> since when it is told as ready
        self._first_start = 0
        self._jumped = 0.0  # when the newest jump was told that was looked at

    def sampled(self, now: int) -> None:
        """Judge what is shown now."""
        robot = self._robot
        for shaft in self._shafts:
            shaft.take(robot, now)
        if now < self._due:
            return
        self._due = now + _EVERY_NS
        if not robot.up or now < robot.host.stalled_until or not robot.running:
            self._wrong_since.clear()
            self._gone.clear()
            return
        self._first_start = self._first_start or robot.started_ns
        readings = readings_of(robot.core)
        status, sample = status_message(robot.core, readings), state_sample(robot.core, readings)
        self._calm = {view.node_id: self._is_calm(view, now) for view in self._nodes.values()}
        same = sample.nodes is status.nodes and sample.joints is status.joints
        self._judge_snapshot(_FACES if same else _FACES[:1], status, now)
        if not same:
            self._judge_snapshot(_FACES[1:], sample, now)
        for each in sample.samples.values():
            if isinstance(each, JointStatesSample):
                self._judge_published(each, now)
        for name, view in self._nodes.items():
            self._judge_supply(name, status.nodes[name], status.events, now)
            self._judge_fault(name, view, status.events, now)
            self._judge_emcy(name, view, status.events, now)
            self._judge_toggle(name, view, status.events, now)
        self._judge_jumps(status.events)

    def true_place(self, joint: str) -> tuple[float, float] | None:
        """Return between which positions a joint's shaft was in the last cycles, in SI; None where nobody knows."""
        for shaft in self._shafts:
            if shaft.joint == joint and shaft.truth and shaft.offset is not None and self._calm.get(shaft.view.node_id):
                places = [each[_POSITION] for each in shaft.truth]
                return min(places) + shaft.offset, max(places) + shaft.offset
        return None

    def _is_calm(self, view: NodeView, now: int) -> bool:
        """Whether a node was left alone for a while and is on its bus."""
        since = max(self._disturbed.last(view.node_id), view.booted_at, self._robot.started_ns)
        return since < now - _CALM_NS and self._robot.drives[view.node_id].device is not None

    def _judge_snapshot(self, faces: Faces, shown: Snapshot, now: int) -> None:
        """Hold what faces show, all of them the same, against what is."""
        for name, view in self._nodes.items():
            self._judge_node(faces, shown.nodes[name], view, now)
        for shaft in self._shafts:
            told = shown.joints.get(shaft.joint)
            if told is not None:  # a joint without feedback is shown by nobody
                self._judge_values(faces, shaft, told.position, told.velocity, now)

    # -- states

    def _judge_node(self, faces: Faces, told: NodeReading, view: NodeView, now: int) -> None:
        """Hold the states told of a node, and of its axes, against those that it is in."""
        device = self._robot.drives[view.node_id].device
        if device is None:
            return
        calm = self._calm[view.node_id]
        self._judge_claim(faces, told.name, "NMT", told.nmt_state, device.nmt.state.name, calm, now)
        for axis in told.axes:
            drive = device.drives[axis.axis]
            self._judge_claim(faces, told.name, "CiA 402", axis.state, drive.state.name, calm, now)
            self._judge_claim(faces, told.name, "mode", axis.mode, mode_name(drive.modes.number), calm, now)

    def _judge_claim(
        self, faces: Faces, who: str, what: str, claim: str | None, truth: str, calm: bool, now: int
    ) -> None:
        if claim is None or claim == truth or not calm:
            if self._wrong_since:
                self._wrong_since.pop((faces, who, what), None)
        elif self._lasts((faces, who, what), _SOON_NS, now):
            self._tell_of(faces, f"{who} is told as {claim}, it is {truth}")

    def _judge_values(
        self, faces: Faces, shaft: _Shaft, position: float | None, velocity: float | None, now: int
    ) -> None:
        node_id = shaft.view.node_id
        calm = self._calm[node_id]
        boots = self._robot.core.nodes[shaft.node].boots
        origin = self._robot.started_ns, boots, self._disturbed.moved(node_id)
        if shaft.origin != origin:
            if origin != (self._first_start, 1, 0):  # the first boot of both: what is told is what the drive counts
                shaft.offset = None
            shaft.origin = origin
        self._judge_value(faces, shaft, _POSITION, position, calm, now)
        self._judge_value(faces, shaft, _VELOCITY, velocity, calm, now)

    def _judge_value(self, faces: Faces, shaft: _Shaft, which: int, value: float | None, calm: bool, now: int) -> None:
        what = _VALUES[which]
        if not calm or shaft.agrees(which, value):
            if self._wrong_since:
                self._wrong_since.pop((faces, shaft.joint, what), None)
        elif self._lasts((faces, shaft.joint, what), _EVERY_NS, now):
            true = shaft.truth[-1][which]
            self._tell_of(faces, f"the {what} of {shaft.joint} is told as {value}, it is {true:.4f}")

    def _judge_published(self, sample: JointStatesSample, now: int) -> None:
        """Judge what ROS publishes as `/joint_states`, and its stamp."""
        by_joint: dict[str, Values] = sample.joints
        for shaft in self._shafts:
            values = by_joint.get(shaft.joint, {})
            self._judge_values(_PUBLISHED, shaft, values.get("position"), values.get("velocity"), now)
        late = now - round(sample.time * 1e9) > LAG_NS + self._robot.setup.cycle_ns
        calm = self._disturbed.hidden_at < now - _CALM_NS and self._robot.started_ns < now - 2 * _CALM_NS
        if not (late and calm):
            self._wrong_since.pop(_STAMP, None)
        elif self._lasts(_STAMP, _SOON_NS, now):
            old = f"{now / 1e9 - sample.time:.3f} s"
            self._tell_of(_PUBLISHED, f"stamped {old} ago, each cycle brings new ones")

    def _tell_of(self, faces: Faces, text: str) -> None:
        for face in faces:
            self._tell("shown_wrong", f"{face}: {text}")

    def _lasts(self, wrong: tuple[Faces, str, str], soon: int, now: int) -> bool:
        """Whether something wrong, of faces, of somebody, has been so for longer than it takes to be told; once."""
        since = self._wrong_since.setdefault(wrong, now)
        if now - since <= soon:
            return False
        self._wrong_since[wrong] = _TOLD
        return True

    # -- what must be told

    def _judge_supply(self, name: str, told: NodeReading, events: list[RobotEvent], now: int) -> None:
        """Hold that a node without supply is told as gone within its heartbeat time, with an event."""
        view = self._nodes[name]
        if self._robot.drives[view.node_id].device is not None:
            self._gone.pop(name, None)
            self._ready[name] = told.ready
            if told.ready:
                self._ready_since.setdefault(name, now)
            else:
                self._ready_since.pop(name, None)
            return
        since, was_ready = self._gone.setdefault(name, (now, self._ready.get(name, False)))
        limit = view.plan.heartbeat_timeout_ns
        if not limit or now < max(since, self._disturbed.hidden_at) + limit + _SOON_NS:
            return
        if told.ready:
            self._tell_once(name, since, "shown_wrong", f"status: {name} is told as ready and has no supply")
        elif was_ready and not _has_event(events, name, since):
            self._tell_once(name, since, "event_missing", f"{name} was lost, and no event says so")

    def _judge_fault(self, name: str, view: NodeView, events: list[RobotEvent], now: int) -> None:
        """Hold that a fault which is seen on the wire has an event."""
        hidden = max(self._disturbed.hidden_at, self._robot.started_ns)
        seen = view.in_fault and now - view.status_at < _EVERY_NS
        if seen and hidden + _CALM_NS < view.fault_at < now - _SOON_NS and not _has_event(events, name, view.fault_at):
            self._tell_once(name, view.fault_at, "event_missing", f"{name} is in fault, and no event says so")

    def _judge_emcy(self, name: str, view: NodeView, events: list[RobotEvent], now: int) -> None:
        """Hold that an EMCY of an error is told; of a flood one."""
        sent = self._emcys.get(name, 0)
        if not sent:
            if view.emcy_at > self._emcys_told.get(name, 0):
                self._emcys[name] = view.emcy_at
            return
        if now <= sent + _FLOOD_NS:
            return
        self._emcys[name], self._emcys_told[name] = 0, sent
        hidden = max(self._disturbed.deaf_at, self._robot.started_ns)
        if hidden + _CALM_NS < sent and not _has_event(events, name, sent - _FLOOD_NS, "emcy"):
            self._tell("event_missing", f"{name} has sent an EMCY, and no event says so")

    def _judge_toggle(self, name: str, view: NodeView, events: list[RobotEvent], now: int) -> None:
        """Hold that an answer to guarding with the toggle bit of the one before is told, of a node that was there."""
        at = view.toggled_at
        hidden = max(self._disturbed.deaf_at, self._robot.started_ns, view.booted_at)
        known = hidden + _CALM_NS < at and self._ready_since.get(name, now) < at - _CALM_NS
        if known and at < now - _SOON_NS and not _has_event(events, name, at, "guarding"):
            self._tell_once(
                name, at, "event_missing", f"the guarding toggle bit of {name} was wrong, and no event says so"
            )

    def _judge_jumps(self, events: list[RobotEvent]) -> None:
        """Hold that a jump is told of counts alone that have jumped."""
        for event in events:
            if event.kind != _JUMPED or event.time <= self._jumped or event.node not in self._nodes:
                continue
            self._jumped = event.time
            node_id = self._nodes[event.node].node_id
            for shaft in self._shafts:
                if shaft.node == event.node:
                    shaft.offset = None
            # a stranger's frame may be a forged TPDO, and bring any count
            since = max(self._disturbed.moved(node_id), self._disturbed.hidden_at, self._robot.started_ns)
            put = self._disturbed.put(node_id) / 1e9
            if since / 1e9 < event.time - _CALM_NS / 1e9 and not 0.0 <= event.time - put < _PUT_S:
                self._tell("shown_wrong", f"events: {event.text}, and its shaft has turned on")

    def _tell_once(self, name: str, since: int, rule: str, text: str) -> None:
        if self._told_faults.get((name, text)) != since:
            self._told_faults[name, text] = since
            self._tell(rule, text)


def _has_event(events: list[RobotEvent], node: str, since: int, kind: str = "") -> bool:
    """Whether something was told of a node since about then, of kinds that begin with `kind`."""
    earliest = since / 1e9 - _MARGIN_S
    return any(event.node == node and event.time > earliest and event.kind.startswith(kind) for event in events)
