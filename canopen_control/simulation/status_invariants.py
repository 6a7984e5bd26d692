"""Invariants of reports: status, state stream, events and `/joint_states` agree with the drives.

Each report is read as a client reads it and compared with the drives themselves: states of NMT and CiA 402, mode,
position and velocity of their shafts, within the time allowed for each. What cannot be known (a disturbed drive, a bus
that loses frames) is not checked, but a drive without supply must be reported as lost, and a fault, an EMCY or a wrong
toggle bit on the bus must have an event. Times are in ns.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.modes import mode_name
from canopen_control.cia402.objects import VELOCITY_ACTUAL
from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.trajectory.goal import ResultCode
from canopen_control.rpc.messages.samples import JointStatesSample
from canopen_control.runtime.status import snapshot_of, state_sample, status_message
from canopen_control.simulation.wire_view import watched_joints
from canopen_control.virtual.axis_motion import wrap32

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.controllers.trajectory.goal import TrajectoryGoal
    from canopen_control.rpc.messages.samples import Values
    from canopen_control.rpc.messages.state import NodeReading, RobotEvent, Snapshot
    from canopen_control.simulation.event_player import EventPlayer
    from canopen_control.simulation.robot_under_test import RobotUnderTest
    from canopen_control.simulation.wire_view import DisturbedNodes, ObservedNode, WireView
    from canopen_control.urdf.ros2_control import Transmission
    from canopen_control.virtual.scenario import ScenarioEvent
    from canopen_control.virtual.virtual_node import VirtualNode


_MS: Final = 1_000_000
_EVERY_NS: Final = 100 * _MS  # interval of reading the reports
_SOON_NS: Final = 400 * _MS  # time allowed for reporting a changed state
LAG_NS: Final = 120 * _MS  # time allowed for reporting values: some cycles
_CALM_NS: Final = 1000 * _MS  # undisturbed time before a node is checked
_PUT_S: Final = 0.3  # a fault's new count appears within this time; it leaves its 32 bits later
_FLOOD_NS: Final = 1500 * _MS  # time in which at least one of many EMCYs is reported
_JUMPED: Final = "position_jump"
_SLACK: Final = 0.02
_MIN: Final = 1e-3  # rad, rad/s, m or m/s
_MARGIN_S: Final = 0.3  # an event may precede the observation of a listener by this time
_POSITION, _VELOCITY = 1, 2
_VALUES: Final = {_POSITION: "position", _VELOCITY: "velocity"}
ReportNames = tuple[str, ...]
_STATUS_REPORTS: Final[ReportNames] = ("status", "sample")
_PUBLISHED: Final[ReportNames] = ("joint_states",)
_STAMP: Final = (_PUBLISHED, "", "stamp")
_REPORTED: Final = 1 << 62
Truth = tuple[int, float, float]  # time, position, velocity in SI units


class _Shaft:
    """Joint of a node's first axis, with the positions of its shaft in the last cycles.

    A drive that boots counts from 0, and the robot continues from the last position it received: `offset` is the
    difference, None until the next reported position. Only a boot or a changed count changes the offset; `origin`
    identifies the latest of them. If the drive's count wraps at 32 bits, both continue. The description may define a
    `transmission` between shaft and joint.
    """

    def __init__(
        self, joint: str, node: str, view: ObservedNode, units: Mapping[str, float], transmission: Transmission | None
    ) -> None:
        self.joint, self.node, self.view = joint, node, view
        reduction = 1.0 if transmission is None else transmission.reduction
        self._position, self._velocity = units["pos_from_dev"] / reduction, units["vel_from_dev"] / reduction
        self.truth: deque[Truth] = deque()
        zero = 0.0 if transmission is None else transmission.offset
        self.offset: float | None = zero + units["offset_pos_from_dev"] / reduction
        self.origin: tuple[object, ...] = ()
        self._shown = self._counts = 0  # the drive's count, and the count without wraps of its 32 bits
        self._blur = 0.0  # uncertainty of the offset, which was determined during motion
        self._zero = 0.0
        self._bounds: dict[int, tuple[float, float]] = {}  # by kind of value in the last cycles

    def take(self, robot: RobotUnderTest, now: int) -> None:
        """Record the current position and velocity of the shaft."""
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

    def shows(self, device: VirtualNode, velocity: float) -> bool:
        """Whether 0x606C of the device is a velocity within its unit."""
        shown = device.store.get(VELOCITY_ACTUAL) if device.store.has(VELOCITY_ACTUAL) else None
        return isinstance(shown, int) and abs(shown - velocity / self._velocity) <= 1.0

    def agrees(self, which: int, value: float | None) -> bool:
        """Whether a reported position or velocity is within the range of the last cycles; True if unknown."""
        if value is None or not self.truth:
            return True
        bounds = self._bounds.get(which)
        if bounds is None:
            values = [truth[which] for truth in self.truth]
            bounds = self._bounds[which] = min(values), max(values)
        low, high = bounds
        if which == _POSITION and self.offset is None:
            self.offset, self._blur = value - self.truth[-1][_POSITION], high - low
        if which == _POSITION:
            offset = self.offset or 0.0
            low, high = low + offset - self._blur, high + offset + self._blur
        slack = _MIN + (high - low) + _SLACK * abs(self.truth[-1][2])
        return low - slack <= value <= high + slack


class StatusInvariants:
    """Checks the robot's reports against the drives; violations are passed to `report(rule, text)`."""

    def __init__(
        self,
        robot: RobotUnderTest,
        views: Mapping[str, WireView],
        disturbed: DisturbedNodes,
        report: Callable[[str, str], None],
    ) -> None:
        self._robot, self._disturbed, self._report = robot, disturbed, report
        self._nodes = {
            name: view.nodes[plan.node_id] for view in views.values() for name, plan in view.config.plans.items()
        }
        transmissions = {
            transmission.joint: transmission
            for tag in robot.setup.description.hardware
            for transmission in tag.transmissions
        }
        self._shafts = [
            _Shaft(joint, node.name, self._nodes[node.name], units, transmissions.get(joint))
            for joint, node, units in watched_joints(robot.setup)
        ]
        self._heard_ns = {  # node -> time allowed for reporting its NMT state, which its next heartbeat shows
            name: max(_SOON_NS, node.supervision.heartbeat_ms * _MS + _EVERY_NS)
            for view in views.values()
            for name, node in view.config.nodes.items()
        }
        self._next_check = robot.now_ns + _EVERY_NS
        self._calm: dict[int, bool] = {}  # whether a node has been undisturbed for a while, and is on its bus
        self._wrong_since: dict[tuple[ReportNames, str, str], int] = {}  # (reports, node, text) -> since when
        # node without supply -> since when, whether it was reported as ready
        self._lost: dict[str, tuple[int, bool]] = {}
        self._ready: dict[str, bool] = {}
        self._reported: dict[tuple[str, str], int] = {}
        self._emcys: dict[str, int] = {}  # node -> EMCY that must be reported, 0: none
        self._emcys_checked: dict[str, int] = {}  # node -> last EMCY already checked
        self._ready_since: dict[str, int] = {}  # node -> since when it is reported as ready
        self._first_start = 0
        self._jumped = 0.0  # time of the newest jump event already checked

    def on_sample(self, now: int) -> None:
        """Check the current reports against the drives."""
        robot = self._robot
        for shaft in self._shafts:
            shaft.take(robot, now)
        if now < self._next_check:
            return
        self._next_check = now + _EVERY_NS
        if not robot.up or now < robot.host.stalled_until or not robot.running:
            self._wrong_since.clear()
            self._lost.clear()
            return
        self._first_start = self._first_start or robot.started_ns
        snapshot = snapshot_of(robot.core)
        status, sample = status_message(robot.core, snapshot), state_sample(robot.core, snapshot)
        self._calm = {
            view.node_id: self._disturbed.is_calm(view, now) and robot.drives[view.node_id].device is not None
            for view in self._nodes.values()
        }
        same = sample.nodes is status.nodes and sample.joints is status.joints
        self._judge_snapshot(_STATUS_REPORTS if same else _STATUS_REPORTS[:1], status, now)
        if not same:
            self._judge_snapshot(_STATUS_REPORTS[1:], sample, now)
        for item in sample.samples.values():
            if isinstance(item, JointStatesSample):
                self._judge_published(item, now)
        for name, view in self._nodes.items():
            self._judge_supply(name, status.nodes[name], status.events, now)
            self._judge_fault(name, view, status.events, now)
            self._judge_emcy(name, view, status.events, now)
            self._judge_toggle(name, view, status.events, now)
        self._judge_jumps(status.events)

    def true_place(self, joint: str) -> tuple[float, float] | None:
        """Return the lowest and the highest joint position in the last cycles in SI units, or None if unknown."""
        for shaft in self._shafts:
            if shaft.joint == joint and shaft.truth and shaft.offset is not None and self._calm.get(shaft.view.node_id):
                places = [truth[_POSITION] for truth in shaft.truth]
                return min(places) + shaft.offset, max(places) + shaft.offset
        return None

    def _judge_snapshot(self, reports: ReportNames, shown: Snapshot, now: int) -> None:
        """Compare a report with the drives; `reports` are the names of the reports with these contents."""
        for name, view in self._nodes.items():
            self._judge_node(reports, shown.nodes[name], view, now)
        for shaft in self._shafts:
            reading = shown.joints.get(shaft.joint)
            if reading is not None:  # a joint without feedback is not reported
                self._judge_values(reports, shaft, reading.position, reading.velocity, now)

    # -- states

    def _judge_node(self, reports: ReportNames, reading: NodeReading, view: ObservedNode, now: int) -> None:
        """Compare the reported states of a node and its axes with the device."""
        device = self._robot.drives[view.node_id].device
        if device is None:
            return
        calm = self._calm[view.node_id]
        at_ns = self._heard_ns[reading.name]
        self._judge_claim(reports, reading.name, "NMT", reading.nmt_state, device.nmt.state.name, calm, now, at_ns)
        for axis in reading.axes:
            drive = device.drives[axis.axis]
            self._judge_claim(reports, reading.name, "CiA 402", axis.state, drive.state.name, calm, now)
            self._judge_claim(reports, reading.name, "mode", axis.mode, mode_name(drive.modes.number), calm, now)

    def _judge_claim(
        self,
        reports: ReportNames,
        subject: str,
        what: str,
        claim: str | None,
        truth: str,
        calm: bool,
        now: int,
        soon: int = _SOON_NS,
    ) -> None:
        if claim is None or claim == truth or not calm:
            if self._wrong_since:
                self._wrong_since.pop((reports, subject, what), None)
        elif self._lasts((reports, subject, what), soon, now):
            self._report_shown(reports, f"{subject} is reported as {claim} but is {truth}")

    def _judge_values(
        self, reports: ReportNames, shaft: _Shaft, position: float | None, velocity: float | None, now: int
    ) -> None:
        node_id = shaft.view.node_id
        calm = self._calm[node_id]
        boots = self._robot.core.nodes[shaft.node].boots
        origin = self._robot.started_ns, boots, self._disturbed.moved(node_id)
        if shaft.origin != origin:
            if origin != (self._first_start, 1, 0):  # at the first boot of both the drive's count is reported unchanged
                shaft.offset = None
            shaft.origin = origin
        self._judge_value(reports, shaft, _POSITION, position, calm, now)
        self._judge_value(reports, shaft, _VELOCITY, velocity, calm, now)

    def _judge_value(
        self, reports: ReportNames, shaft: _Shaft, which: int, value: float | None, calm: bool, now: int
    ) -> None:
        quantity = _VALUES[which]
        if not calm or shaft.agrees(which, value):
            if self._wrong_since:
                self._wrong_since.pop((reports, shaft.joint, quantity), None)
        elif which == _VELOCITY and self._is_shown(shaft, value):
            self._wrong_since.pop((reports, shaft.joint, quantity), None)
        elif self._lasts((reports, shaft.joint, quantity), _EVERY_NS, now):
            true = shaft.truth[-1][which]
            self._report_shown(reports, f"the {quantity} of {shaft.joint} is reported as {value} but is {true:.4f}")

    def _is_shown(self, shaft: _Shaft, velocity: float | None) -> bool:
        """Whether the drive itself shows this velocity (0x606C), which need not be that of its shaft."""
        device = self._robot.drives[shaft.view.node_id].device
        return device is not None and velocity is not None and shaft.shows(device, velocity)

    def _judge_published(self, sample: JointStatesSample, now: int) -> None:
        """Check the values and the time stamp of the published `/joint_states`."""
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
            self._report_shown(_PUBLISHED, f"the time stamp is {old} old, though every cycle has new values")

    def _report_shown(self, reports: ReportNames, text: str) -> None:
        for name in reports:
            self._report("shown_wrong", f"{name}: {text}")

    def _lasts(self, wrong: tuple[ReportNames, str, str], soon: int, now: int) -> bool:
        """Whether a wrong report has lasted longer than allowed; True only once per report."""
        since = self._wrong_since.setdefault(wrong, now)
        if now - since <= soon:
            return False
        self._wrong_since[wrong] = _REPORTED
        return True

    # -- mandatory events

    def _judge_supply(self, name: str, reading: NodeReading, events: list[RobotEvent], now: int) -> None:
        """Check that a node without power is soon reported as not ready, and that an event reports its loss."""
        view = self._nodes[name]
        if self._robot.drives[view.node_id].device is not None:
            self._lost.pop(name, None)
            self._ready[name] = reading.ready
            if reading.ready:
                self._ready_since.setdefault(name, now)
            else:
                self._ready_since.pop(name, None)
            return
        since, was_ready = self._lost.setdefault(name, (now, self._ready.get(name, False)))
        limit = view.plan.heartbeat_timeout_ns
        if not limit or now < max(since, self._disturbed.hidden_at) + limit + _SOON_NS:
            return
        if reading.ready:
            self._report_once(name, since, "shown_wrong", f"status: {name} is reported as ready but has no supply")
        elif was_ready and not _has_event(events, name, since):
            self._report_once(name, since, "event_missing", f"{name} was lost, and no event reports the loss")

    def _judge_fault(self, name: str, view: ObservedNode, events: list[RobotEvent], now: int) -> None:
        """Check that an event reports a drive fault that is seen on the bus."""
        hidden = max(self._disturbed.hidden_at, self._robot.started_ns)
        is_in_fault = view.in_fault and now - view.status_at < _EVERY_NS
        if (
            is_in_fault
            and hidden + _CALM_NS < view.fault_at < now - _SOON_NS
            and not _has_event(events, name, view.fault_at)
        ):
            self._report_once(
                name, view.fault_at, "event_missing", f"{name} is in fault, and no event reports the fault"
            )

    def _judge_emcy(self, name: str, view: ObservedNode, events: list[RobotEvent], now: int) -> None:
        """Check that an event reports an EMCY with an error; one event is sufficient for a series."""
        sent = self._emcys.get(name, 0)
        if not sent:
            if view.emcy_at > self._emcys_checked.get(name, 0):
                self._emcys[name] = view.emcy_at
            return
        if now <= sent + _FLOOD_NS:
            return
        self._emcys[name], self._emcys_checked[name] = 0, sent
        hidden = max(self._disturbed.deaf_at, self._robot.started_ns)
        if hidden + _CALM_NS < sent and not _has_event(events, name, sent - _FLOOD_NS, "emcy"):
            self._report("event_missing", f"{name} has sent an EMCY, and no event reports it")

    def _judge_toggle(self, name: str, view: ObservedNode, events: list[RobotEvent], now: int) -> None:
        """Check that an event reports a repeated toggle bit in a guarding response."""
        at = view.toggled_at
        hidden = max(self._disturbed.deaf_at, self._robot.started_ns, view.booted_at)
        was_ready = hidden + _CALM_NS < at and self._ready_since.get(name, now) < at - _CALM_NS
        if was_ready and at < now - _SOON_NS and not _has_event(events, name, at, "guarding"):
            self._report_once(
                name, at, "event_missing", f"the guarding toggle bit of {name} was wrong, and no event reports it"
            )

    def _judge_jumps(self, events: list[RobotEvent]) -> None:
        """Check that a position jump is reported only if the drive's count has jumped."""
        for event in events:
            if event.kind != _JUMPED or event.time <= self._jumped or event.node not in self._nodes:
                continue
            self._jumped = event.time
            node_id = self._nodes[event.node].node_id
            for shaft in self._shafts:
                if shaft.node == event.node:
                    shaft.offset = None
            # a foreign frame may be a forged TPDO with any count
            since = max(self._disturbed.moved(node_id), self._disturbed.hidden_at, self._robot.started_ns)
            put = self._disturbed.put(node_id) / 1e9
            if since / 1e9 < event.time - _CALM_NS / 1e9 and not 0.0 <= event.time - put < _PUT_S:
                self._report("shown_wrong", f"events: {event.text}, but the shaft has not jumped")

    def _report_once(self, name: str, since: int, rule: str, text: str) -> None:
        if self._reported.get((name, text)) != since:
            self._reported[name, text] = since
            self._report(rule, text)


def _has_event(events: list[RobotEvent], node: str, since: int, kind: str = "") -> bool:
    """Whether an event of a node, later than about `since`, has a kind that starts with `kind`."""
    earliest = since / 1e9 - _MARGIN_S
    return any(event.node == node and event.time > earliest and event.kind.startswith(kind) for event in events)


# Invariants of goals and switches: a goal ends by its tolerances, a refused switch of controllers changes nothing. If a
# goal is reported as reached, its joints are at its last point; if it is reported as missed, a joint is outside of its
# tolerance; if all joints are at the last point, the goal ends. After a cancelled goal the joints stop with the
# decelerations of the parameters or at once, unless there is a newer request; a goal that was ended by a stop reports
# the stop. The shafts of undisturbed nodes are checked with the tolerances of the controller's parameters.


_LATE_NS: Final = 500 * _MS  # time after its end in which a reached goal must be reported
_GOAL_SLACK: Final = 2e-3  # rad or m: uncertainty of a count
_REST_NS: Final = 400 * _MS  # time allowed for stopping after a cancel, in addition to the ramps
_STOPPED_NS: Final = 100 * _MS  # time after a stop in which it must have ended every goal
_STOPS: Final = ("stop", "latch")
_STOP: Final = "stop was commanded"
_LEADS: Final = ("command", "trajectory", "activate", "deactivate")


class _Open:
    """Accepted goal with final positions and tolerances by joint, and the time by which it must have ended."""

    def __init__(
        self, act: ScenarioEvent, goal: TrajectoryGoal, places: dict[str, tuple[float, float]], over_ns: int
    ) -> None:
        self.act, self.goal, self.places, self.over_ns = act, goal, places, over_ns
        self.there_since = self.rests_ns = 0  # rests_ns: time at which its joints must stand after it was cancelled


class GoalInvariants:
    """Checks the results of goals; violations are passed to `report(rule, text)`.

    The owner calls `requested`, `applied` and `on_sample` as time passes.
    """

    def __init__(
        self, robot: RobotUnderTest, player: EventPlayer, status: StatusInvariants, report: Callable[[str, str], None]
    ) -> None:
        self._robot, self._player, self._status, self._report = robot, player, status, report
        self._open: list[_Open] = []
        self._core: object = None
        self._torn = 0
        self._newest: ScenarioEvent | None = None  # newest request that may move joints
        self._stopped_at = -1 << 62  # time of the last stop request, if there was no other request since

    def requested(self, now: int, act: ScenarioEvent) -> None:
        """Record a client request that stops or moves the robot."""
        self._stopped_at = now if act.kind in _STOPS else -1 << 62
        if act.kind in _LEADS:
            self._newest = act

    def applied(self, now: int, act: ScenarioEvent, goal: TrajectoryGoal) -> None:
        controller = self._robot.core.manager.get(act.target)
        tolerances = controller.params.tolerances()  # type: ignore[attr-defined]
        last = goal.trajectory.points[-1]
        allowed = dict(zip(controller.params.joints, tolerances.goal, strict=True))  # type: ignore[attr-defined]
        places = {
            joint: (place, allowed[joint].position)
            for joint, place in zip(goal.trajectory.joint_names, last.positions, strict=False)
            if joint in allowed and allowed[joint].position > 0.0
        }
        over = now + last.time + round(tolerances.goal_time * 1e9)
        self._core = self._robot.core
        self._open.append(_Open(act, goal, places, over))

    def on_sample(self, now: int) -> None:
        """Check open goals, and refused switches that had an effect."""
        for text in self._player.torn[self._torn :]:
            self._report("switch_torn", text)
        self._torn = len(self._player.torn)
        if not self._open:
            return
        if self._robot.core is not self._core:
            self._open.clear()
            return
        self._open = [item for item in self._open if self._is_open(item, now)]

    def _is_open(self, goal: _Open, now: int) -> bool:
        """Check a goal; return whether it must be checked again."""
        if goal.goal.state is GoalState.CANCELED:
            return self._comes_to_rest(goal, now)
        off = self._deviations(goal)
        if not goal.goal.ended:
            arrived = _all_within(off)
            goal.there_since = (goal.there_since or now) if arrived else 0
            if not (arrived and now > max(goal.over_ns, goal.there_since) + _LATE_NS):
                return now < goal.over_ns + 10 * _LATE_NS
            self._report("goal_wrong", f"the goal of {goal.act.target} was reached but does not end")
        elif goal.goal.state is GoalState.SUCCEEDED:
            for joint, (_, least) in off.items():
                if least > _GOAL_SLACK:
                    text = (
                        f"the goal of {goal.act.target} is reported as reached, but {joint} is off by {least:.4f} more"
                    )
                    self._report("goal_wrong", f"{text} than its tolerance")
        elif goal.goal.code is ResultCode.GOAL_TOLERANCE_VIOLATED and _all_within(off):
            self._report(
                "goal_wrong",
                f"the goal of {goal.act.target} is reported as missed, but all joints are within their tolerances",
            )
        elif goal.goal.code is ResultCode.INVALID_GOAL and off and self._hides_its_stop(goal, now):
            message = f"a stop has ended the goal of {goal.act.target}, whose result is: {goal.goal.text}"
            self._report("goal_wrong", message)
        return False

    def _hides_its_stop(self, goal: _Open, now: int) -> bool:
        """Whether a stop has just ended a goal whose result gives another reason."""
        return now - self._stopped_at < _STOPPED_NS and _STOP not in goal.goal.text

    def _comes_to_rest(self, goal: _Open, now: int) -> bool:
        """Check that joints stop after a cancelled goal; return whether it must be checked again.

        Nothing is checked if the position of a joint is unknown, with physics, or after a newer request.
        """
        ranges = {joint: self._status.true_place(joint) for joint in goal.places}
        travels = [
            (joint, high - low) for joint, (low, high) in ((name, span) for name, span in ranges.items() if span)
        ]
        if len(travels) < len(ranges) or self._newest is not goal.act or self._robot.floor is not None:
            return False
        if not goal.rests_ns:
            goal.rests_ns = now + _REST_NS + round(self._brake_s(goal, dict(travels)) * 1e9)
        if now < goal.rests_ns:
            return True
        for joint, way in travels:
            if way > _GOAL_SLACK:
                text = f"the goal of {goal.act.target} was cancelled, but {joint} still moves"
                self._report("goal_wrong", text)
        return False

    def _brake_s(self, goal: _Open, travels: dict[str, float]) -> float:
        """Return the braking time in s from the controller's parameters; `travels` are recent travels by joint."""
        params = self._robot.core.manager.get(goal.act.target).params  # type: ignore[attr-defined]
        slow = dict(
            zip(
                params.joints, (constraint.max_deceleration_on_cancel for constraint in params.constraints), strict=True
            )
        )
        times = [travel / (LAG_NS / 1e9) / slow[joint] for joint, travel in travels.items() if slow[joint] > 0.0]
        return max(times, default=0.0)

    def _deviations(self, goal: _Open) -> dict[str, tuple[float, float]]:
        """Return the largest and the smallest recent error of each joint, both minus the joint's tolerance.

        The result is empty if the position of a joint is unknown.
        """
        errors = {}
        for joint, (place, tolerance) in goal.places.items():
            between = self._status.true_place(joint)
            if between is None:
                return {}
            low, high = between[0] - place, between[1] - place
            least = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
            errors[joint] = max(abs(low), abs(high)) - tolerance, least - tolerance
        return errors


def _all_within(off: dict[str, tuple[float, float]]) -> bool:
    """Whether all joints are certainly within their tolerances; False with unknown errors."""
    return bool(off) and all(most < -_GOAL_SLACK for most, _ in off.values())
