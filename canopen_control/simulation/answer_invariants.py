"""Invariants of commands: an accepted command moves its axis, or the robot reports why it does not move.

An axis has a motion command if its target on the bus requests motion, or if a client's velocity or position was
accepted. It must then move within 2 s plus the delay of its brake (quirk `brake_delay`). Otherwise the robot must
report an error or a certain kind of warning about its node, or a stop that names its joint. The same reports excuse a
drive that does not follow its targets because of a quirk: `unless_reported` delays a breach for that time. Disturbed
nodes, axes at a limit, and robots on a floor are not checked. Times are in ns.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.master.event_log import Level
from canopen_control.simulation.wire_view import watched_joints
from canopen_control.urdf.joint_element import POSITION, VELOCITY
from canopen_control.virtual.axis_motion import wrap32

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from canopen_control.master.event_log import Event
    from canopen_control.simulation.motions import SampleMotion
    from canopen_control.simulation.robot_under_test import RobotUnderTest
    from canopen_control.simulation.wire_view import DisturbedNodes, ObservedNode, WireView
    from canopen_control.virtual.scenario import ScenarioEvent
    from canopen_control.virtual.virtual_drive import VirtualDrive


ANSWER_NS: Final = 2_000_000_000
_RENEWED_NS: Final = 500_000_000  # maximum age of a velocity command that is renewed
_KEPT: Final = 100  # number of reports kept
_MIN: Final = 5.0  # counts/s: slower is not a motion, and a slower command requires none
_WAY: Final = 0.02  # rad or m: a smaller distance to a target commands no motion
_VELOCITIES, _POSITIONS = (OperationMode.PV, OperationMode.CSV), (OperationMode.PP, OperationMode.CSP)
_REASONS: Final = (
    "standing",
    "limit",
    "target_refused",
    "velocity_unit",
)  # kinds of warnings that give a reason for the standstill of an axis
_ENDS: Final = ("stop", "latch", "axis", "activate", "deactivate", "leave", "cancel", "trajectory")


@dataclass(slots=True)
class _Request:
    """Motion of a joint that a client has requested: first and last time of the request, and its latest value."""

    since: int
    last: int
    value: float


@dataclass(slots=True)
class _Axis:
    """Observed axis: position at the last sample, time of its last motion, and start of the request by its target.

    `requested_since` is None without a request.
    """

    view: ObservedNode
    joints: list[str]
    way: float  # _WAY in counts
    rate: float  # velocity units of the drive per rad/s (m/s)
    position: float = 0.0
    moved_at: int = 0
    requested_since: int | None = None
    reported: bool = False


@dataclass(slots=True)
class _Waiting:
    """Violation that is reported at `deadline` unless the robot has given a reason by then."""

    axis: _Axis
    rule: str
    text: str
    since: int
    deadline: int


class AnswerInvariants:
    """Checks that each command leads to motion or a reported reason; violations are passed to `report(rule, text)`."""

    def __init__(
        self,
        robot: RobotUnderTest,
        views: Mapping[str, WireView],
        motions: Sequence[SampleMotion],
        disturbed: DisturbedNodes,
        report: Callable[[str, str], None],
    ) -> None:
        self._robot, self._disturbed, self._report = robot, disturbed, report
        self._interfaces = {motion.controller: motion.interfaces for motion in motions}
        nodes = {node.node_id: node for view in views.values() for node in view.nodes.values()}
        self._axes: dict[int, _Axis] = {}
        self._axis_of: dict[str, _Axis] = {}
        for joint, config, scale in watched_joints(robot.setup):
            way, rate = _WAY * abs(scale["pos_to_dev"]), abs(scale["vel_to_dev"])
            axis = self._axes.setdefault(config.node_id, _Axis(nodes[config.node_id], [], way, rate))
            axis.joints.append(joint)
            self._axis_of[joint] = axis
        self._requests: dict[tuple[str, str], _Request] = {}  # by joint and interface
        self._has_positions = False  # whether a position was requested
        self._reports: deque[tuple[int, Event]] = deque(maxlen=_KEPT)
        self._waiting: list[_Waiting] = []

    # -- reports

    def event(self, now: int, event: Event) -> None:
        if event.level is not Level.INFO:
            self._reports.append((now, event))

    def reported(self, node_id: int, since: int, word: str = "") -> bool:
        """Whether the robot has reported, from `since` on, why a node is at standstill (or any event with `word`)."""
        axis = self._axes.get(node_id)
        if axis is None:
            return False
        return any(
            at >= since
            and word in event.text
            and (event.node == axis.view.plan.name or _stops(event, axis.joints))
            and (word or event.level is Level.ERROR or event.kind in _REASONS or _stops(event, axis.joints))
            for at, event in self._reports
        )

    def unless_reported(self, node_id: int, rule: str, text: str, since: int) -> None:
        """Report a breach once the time for a reaction has passed, unless the robot reports a reason by then."""
        axis, now = self._axes.get(node_id), self._robot.now_ns
        if axis is None:
            self._report(rule, text)
        else:
            self._waiting.append(_Waiting(axis, rule, text, since, now + self._limit(axis)))

    def requested(self, _now: int, act: ScenarioEvent) -> None:
        """Discard the recorded commands if a client's request may end commands."""
        if act.kind in _ENDS:
            self._requests.clear()

    def applied(self, now: int, act: ScenarioEvent) -> None:
        """Record the values of an accepted command."""
        for name, value in zip(self._interfaces.get(act.target, ()), act.values, strict=False):
            joint, _, interface = name.partition("/")
            if joint in self._axis_of and interface in (POSITION, VELOCITY):
                self._record(now, joint, interface, value)

    def _record(self, now: int, joint: str, interface: str, value: float) -> None:
        key = joint, interface
        self._has_positions = self._has_positions or interface == POSITION
        request = self._requests.get(key)
        if interface == VELOCITY and self._is_slow(self._axis_of[joint], value):
            self._requests.pop(key, None)
        elif request is None or (interface == VELOCITY and now - request.last > _RENEWED_NS):
            # the position before the first request is unknown, so that this request commands no motion
            self._requests[key] = _Request(now if interface == VELOCITY else 1 << 62, now, value)
        else:
            if interface == POSITION and abs(value - request.value) > _WAY and request.since > now:
                request.since = now
            request.last, request.value = now, value

    def _is_slow(self, axis: _Axis, velocity: float) -> bool:
        """Whether a commanded velocity is too low for a visible motion of the shaft."""
        drive = self._drive_of(axis)
        return not velocity or (
            drive is not None and abs(velocity) * axis.rate * abs(drive.objects.units.velocity) <= _MIN
        )

    def _drive_of(self, axis: _Axis) -> VirtualDrive | None:
        """Return the first drive of the axis' device, or None while the device has no supply."""
        device = self._robot.drives[axis.view.node_id].device
        return None if device is None else device.drives.get(0)

    # -- what is observed

    def on_sample(self, now: int) -> None:
        """Check all axes and the pending breaches."""
        if self._robot.floor is not None:
            return
        for axis in self._axes.values():
            if (drive := self._drive_of(axis)) is None:
                axis.requested_since = None
                continue
            self._judge(axis, drive, now)
        for waiting in list(self._waiting):
            if self.reported(waiting.axis.view.node_id, waiting.since):
                self._waiting.remove(waiting)
            elif now >= waiting.deadline:
                self._waiting.remove(waiting)
                self._report(waiting.rule, waiting.text)

    def _judge(self, axis: _Axis, drive: VirtualDrive, now: int) -> None:
        view = axis.view
        plant, last = drive.mover.plant, axis.position
        axis.position = plant.position
        # a motion without a velocity limit can begin and end between two samples
        if abs(plant.velocity) > _MIN or abs(plant.position - last) > _MIN:
            axis.moved_at, axis.reported = now, False
        if not self._requests_motion(axis, drive):
            axis.requested_since = None
        elif axis.requested_since is None:
            axis.requested_since = now
        if axis.moved_at >= now - ANSWER_NS and not self._has_positions:
            return  # it has moved in time; the motion of a position command is recorded below
        quiet = max(self._disturbed.last(view.node_id), self._robot.started_ns, view.booted_at, view.limited_at)
        for since in self._since(axis, now):
            if not axis.reported and max(since, axis.moved_at, quiet) < now - self._limit(axis):
                axis.reported = True
                if not self.reported(view.node_id, since):
                    late = (now - max(since, axis.moved_at)) / 1e9
                    text = f"node {view.node_id} ignores a motion command for {late:.1f} s, and no event gives a reason"
                    self._report("motion_missing", text)

    def _since(self, axis: _Axis, now: int) -> Iterator[int]:
        """Yield the start times of the motion requests to an axis, from its target and from clients."""
        if axis.requested_since is not None:
            yield axis.requested_since
        for joint in axis.joints:
            if (request := self._requests.get((joint, VELOCITY))) and now - request.last <= _RENEWED_NS:
                yield request.since
            request = self._requests.get((joint, POSITION))
            if request is not None and request.since <= now:
                if axis.moved_at > request.since:
                    request.since = 1 << 62
                else:
                    yield request.since

    def _requests_motion(self, axis: _Axis, drive: VirtualDrive) -> bool:
        """Whether the target on the bus requests a visible motion of an enabled axis."""
        view, mode = axis.view, drive.modes.number
        if not view.follows:
            return False
        if mode in _VELOCITIES:
            return abs(view.targets.get(o.TARGET_VELOCITY, 0) * drive.objects.units.velocity) > _MIN
        target = view.targets.get(o.TARGET_POSITION)
        if mode not in _POSITIONS or target is None:
            return False
        place = round(float(drive.objects.units.user(drive.mover.plant.position)))
        return abs(wrap32(target - place)) > axis.way

    def _limit(self, axis: _Axis) -> int:
        """Return the time in ns within which an axis must start to move."""
        drive = self._drive_of(axis)
        gate = None if drive is None else drive.modes.gate
        return ANSWER_NS + (0 if gate is None else gate.brake_ns)


def _stops(event: Event, joints: Sequence[str]) -> bool:
    """Whether an event is a stop of the robot that names one of the joints as its cause."""
    return event.text.startswith("stopping") and any(joint in event.text for joint in joints)
