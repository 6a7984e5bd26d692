"""All invariants of a simulation, including the rules of installed packages.

A user's rule is a function of the entry point group `canopen_control.invariants`. It is called with the
`RobotUnderTest` every 20 ms of virtual time; it returns a sentence about a violation, or None.
"""

from __future__ import annotations

import functools
import importlib.metadata
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.hardware.interfaces import TARGET
from canopen_control.runtime.core import RobotState
from canopen_control.simulation.answer_invariants import AnswerInvariants
from canopen_control.simulation.fault_coverage import FaultCoverage, StateCoverage
from canopen_control.simulation.motion_invariants import MotionInvariants
from canopen_control.simulation.robot_under_test import SimulationObserver
from canopen_control.simulation.status_invariants import GoalInvariants, StatusInvariants
from canopen_control.simulation.target_invariants import TargetInvariants
from canopen_control.simulation.wire_invariants import ConfigurationInvariants, WireInvariants
from canopen_control.simulation.wire_view import DisturbedNodes, WireView

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.controllers.trajectory.goal import TrajectoryGoal
    from canopen_control.master.event_log import Event
    from canopen_control.simulation.event_player import EventPlayer
    from canopen_control.simulation.motions import SampleMotion
    from canopen_control.simulation.robot_under_test import RobotUnderTest
    from canopen_control.simulation.simulated_clients import SimulatedClient, SimulatedClients
    from canopen_control.simulation.wire_view import ObservedNode
    from canopen_control.virtual.scenario import ScenarioEvent

    Rule = Callable[[RobotUnderTest], str | None]


# Invariants of the runtime: reported states are true, memory is bounded, no program error occurs. Reports of the robot
# (state, axes, velocities) are compared with the bus and the shafts, and the STOP latch with the requests of clients,
# across disconnections and restarts. Times are in ns.


_MS: Final = 1_000_000
_SECOND: Final = 1_000_000_000
_SOON_NS: Final = 400 * _MS  # time allowed for reporting an event
_FRESH_NS: Final = 100 * _MS
_MEMORY_NS: Final = 60 * _SECOND
_BLOCKS: Final = 60_000  # allowed increase of memory blocks since shortly after the start


class ReportInvariants:
    """Checks that the runtime reports the true states; violations are passed to `report(rule, text)`.

    The owner calls `requested`, `applied` and `on_sample` as time passes.
    """

    def __init__(
        self, robot: RobotUnderTest, views: Mapping[str, WireView], report: Callable[[str, str], None]
    ) -> None:
        self._robot, self._report = robot, report
        self._nodes = [node for view in views.values() for node in view.nodes.values()]
        self._wrong_since: dict[tuple[str, str], int] = {}  # (rule, node): since when
        self._names = {node.node_id: f"node {node.node_id}" for node in self._nodes}
        self._errors = 0
        self._blocks: int | None = None
        self._memory_check_at = robot.now_ns + _MEMORY_NS
        # state requested by clients; None if it is unknown, because a request may have been lost
        self._latched: bool | None = False
        self._latch_requested = self._latch_received = 0

    def requested(self, now: int, act: ScenarioEvent) -> None:
        """Record a client's latch or release request, which a stalled process receives after the stall."""
        if act.kind in ("latch", "release"):
            self._latched = act.kind == "latch"
            self._latch_requested, self._latch_received = now, max(now, self._robot.host.stalled_until)

    def applied(self, now: int, act: ScenarioEvent) -> None:
        """Report a command that was accepted although all its drives have been disabled for a while."""
        core = self._robot.core
        joints = [core.joints.get(command.joint) for command in core.manager.get(act.target).commands]
        moved = {joint.node.node_id for joint in joints if joint is not None}
        axes = [node for node in self._nodes if node.node_id in moved]
        if axes and all(_is_off(node, now) for node in axes):
            self._report("command_taken", f"a command to {act.target} was accepted although its drives are disabled")

    def on_sample(self, now: int) -> None:
        """Check the robot's current reports against the bus; report errors of the program and growing memory."""
        robot = self._robot
        for error in robot.errors[self._errors :]:
            self._report("program_error", f"{type(error).__name__}: {error}")
        self._errors = len(robot.errors)
        if now >= self._memory_check_at:
            self._check_memory(now)
        if now <= self._latch_received + _FRESH_NS and not (robot.up and robot.started_ns <= self._latch_requested):
            self._latched = None
        if not robot.up or now < robot.host.stalled_until:
            self._wrong_since.clear()
            return
        self._judge_latch(now)
        troubled = False
        for node in self._nodes:
            troubled = self._judge_state(node, now) or troubled
        for node in self._nodes:
            self._judge_axes(node, now, troubled=troubled)

    def _judge_latch(self, now: int) -> None:
        """Check that STOP is latched from a latch request to a release request, and at no other time."""
        latch_held, latched = self._robot.core.latch.held, self._latched
        if latch_held is not latched or self._wrong_since:
            self._hold(
                "STOP is not latched any more, though {} has latched it",
                "a client",
                latched is True and not latch_held,
                now,
            )
            self._hold("STOP is latched, though {} has requested it", "no client", latched is False and latch_held, now)

    def _judge_state(self, node: ObservedNode, now: int) -> bool:
        """Report the state RUNNING while this node is silent or in fault; return whether it is either."""
        limit = node.timeout_ns
        silent = limit > 0 and node.alive_at > 0 and now - node.alive_at > limit
        fault = node.in_fault and now - node.status_at < _FRESH_NS
        if not (silent or fault or self._wrong_since):
            return False
        name, running = self._names[node.node_id], self._robot.core.state is RobotState.RUNNING
        self._hold("the state is RUNNING although {} is silent", name, running and silent, now)
        self._hold("the state is RUNNING although {} is in fault", name, running and fault, now)
        return silent or fault

    def _judge_axes(self, node: ObservedNode, now: int, *, troubled: bool) -> None:
        """Check that axes reported as enabled, or claimed in the state RUNNING, are enabled according to the bus."""
        wrong = now - node.status_at < _FRESH_NS and not node.enabled
        if not (wrong or self._wrong_since):
            return
        for joint in self._robot.core.joints.values():
            if joint.node.node_id == node.node_id:
                reported = wrong and joint.enabled
                self._hold(
                    "{} is reported as enabled, but its statusword shows another state", joint.joint, reported, now
                )
                claimed = wrong and not troubled and not joint.axis.number and joint.claimed not in (None, TARGET)
                off = claimed and self._robot.core.state is RobotState.RUNNING
                self._hold(
                    "the state is RUNNING although {} is claimed by a controller and disabled", joint.joint, off, now
                )

    def _hold(self, text: str, subject: str, wrong: bool, now: int) -> None:
        """Report a violation once if it lasts longer than the time allowed for a report."""
        since, key = self._wrong_since, (text, subject)
        if not wrong:
            if since:
                since.pop(key, None)
        elif now - since.setdefault(key, now) > _SOON_NS and since[key] >= 0:
            since[key] = 1 << 62  # only once
            self._report("state_told", text.format(subject))

    def _check_memory(self, now: int) -> None:
        blocks = sys.getallocatedblocks()
        self._memory_check_at = now + _MEMORY_NS
        if self._blocks is None:
            self._blocks = blocks
        elif blocks - self._blocks > _BLOCKS:
            self._report("memory", f"{blocks - self._blocks} more memory blocks than a minute after the start")
            self._blocks = blocks


def _is_off(node: ObservedNode, now: int) -> bool:
    """Whether the statusword has shown a disabled drive for a while."""
    return not node.enabled and node.shown_enabled_at < now - _SOON_NS and now - node.status_at < _FRESH_NS


# Invariants of clients: a blocked client delays neither the robot nor other clients, and is disconnected in the end.
# That commands end with their client and after their timeout is checked at the shafts (`motion_invariants`).
# Times are in ns.


# time allowed for an answer despite blocked clients: new connections may be idle for half of it
_ANSWER_NS: Final = 1000 * _MS
_DEAF_NS: Final = 5000 * _MS  # after this time a client that does not read has exceeded its buffer


class ClientInvariants:
    """Checks that the robot answers its clients, waits for none, and drops clients that never read.

    The owner calls `on_sample` as time passes.
    """

    def __init__(self, robot: RobotUnderTest, clients: SimulatedClients, report: Callable[[str, str], None]) -> None:
        self._robot, self._clients, self._report = robot, clients, report
        self._blocked = 0
        self._reports: set[SimulatedClient] = set()

    def on_sample(self, now: int) -> None:
        if self._clients.blocked > self._blocked:
            self._blocked = self._clients.blocked
            self._report("client_blocks", "the robot waits for a client that does not read")
        host = self._robot.host
        if not self._robot.up or now < host.stalled_until:
            return
        for client in self._clients.all:
            if client.here and client not in self._reports:
                self._judge(client, now, max(host.stalled_until, self._robot.started_ns))

    def _judge(self, client: SimulatedClient, now: int, since: int) -> None:
        if client.reads and client.waits_since is not None and now - max(client.waits_since, since) > _ANSWER_NS:
            self._report_once(client, "client_waits", f"a client has waited for an answer for {_ANSWER_NS // _MS} ms")
        elif not client.reads and client.asks and not client.dropped and now - max(client.came_ns, since) > _DEAF_NS:
            self._report_once(
                client, "client_kept", f"a client that never reads stays connected for {_DEAF_NS // _MS} ms"
            )

    def _report_once(self, client: SimulatedClient, rule: str, text: str) -> None:
        self._reports.add(client)
        self._report(rule, text)


GROUP: Final = "canopen_control.invariants"
_CHECK_NS: Final = 20_000_000
_MAX: Final = 100


@dataclass(frozen=True, slots=True)
class Breach:
    """Violation of the invariant `rule`, `at_s` seconds after the start."""

    at_s: float
    rule: str
    text: str

    @property
    def sentence(self) -> str:
        return f"{self.at_s:.3f} s: {self.rule}: {self.text}"


def user_rules() -> list[tuple[str, Rule]]:
    """Return the rules of the entry point group `canopen_control.invariants`, with their names."""
    return [(entry_point.name, entry_point.load()) for entry_point in _entry_points()]


@functools.cache
def _entry_points() -> tuple[importlib.metadata.EntryPoint, ...]:
    """Return the entry points; cached, since each search reads a file of every installed package."""
    return tuple(importlib.metadata.entry_points(group=GROUP))


class Invariants(SimulationObserver):
    """Observer that checks all invariants of a robot; `breaches` has at most 100 items.

    `coverage` counts state transitions, `fault_coverage` the faults by the states in which they occurred.
    """

    def __init__(
        self,
        robot: RobotUnderTest,
        player: EventPlayer,
        motions: Sequence[SampleMotion],
        rules: Sequence[tuple[str, Rule]] = (),
    ) -> None:
        self.breaches: list[Breach] = []
        self._robot, self._began = robot, robot.now_ns
        views = {name: WireView(bus) for name, bus in robot.setup.joined.items()}
        self._motion = MotionInvariants(robot, views, motions, self._report)
        self._disturbed = DisturbedNodes(robot)
        self._answers = AnswerInvariants(robot, views, motions, self._disturbed, self._report)
        self._targets = TargetInvariants(robot, views, motions, self._disturbed, self._answers, self._report)
        self._reports = ReportInvariants(robot, views, self._report)
        self._status = StatusInvariants(robot, views, self._disturbed, self._report)
        self._clients = ClientInvariants(robot, player.clients, self._report)
        self._goals = GoalInvariants(robot, player, self._status, self._report)
        plans = [plan for bus in robot.setup.joined.values() for plan in bus.plans.values()]
        self._configured = ConfigurationInvariants(robot, plans, self._disturbed, self._answers, self._report)
        self._wires = [WireInvariants(robot, robot.wires[name], view, self._report) for name, view in views.items()]
        self.coverage, self.fault_coverage = StateCoverage(robot, views.values()), FaultCoverage(robot)
        self._rules = list(rules)
        self._broken: set[str] = set()
        for (name, view), wire in zip(views.items(), self._wires, strict=True):
            robot.wires[name].observe(view)
            robot.wires[name].observe(wire)
        robot.observers.append(self)
        robot.time.later(_CHECK_NS, self._observe)

    def _report(self, rule: str, text: str) -> None:
        if len(self.breaches) < _MAX:
            self.breaches.append(Breach((self._robot.now_ns - self._began) / 1e9, rule, text))

    def requested(self, now: int, act: ScenarioEvent) -> None:
        self._motion.requested(now, act)
        self._targets.requested(now, act)
        self._answers.requested(now, act)
        self._reports.requested(now, act)
        self._goals.requested(now, act)

    def event(self, event: Event) -> None:
        self._answers.event(self._robot.now_ns, event)

    def goal(self, now: int, act: ScenarioEvent, goal: TrajectoryGoal) -> None:
        self._goals.applied(now, act, goal)

    def applied(self, now: int, act: ScenarioEvent) -> None:
        self._answers.applied(now, act)
        self._reports.applied(now, act)

    def played(self, now: int, act: ScenarioEvent) -> None:
        self._disturbed.on_event(now, act)
        self.fault_coverage.on_event(act)

    def _observe(self) -> None:
        now = self._robot.now_ns
        self._disturbed.on_sample(now)
        self._motion.on_sample(now)
        self._targets.on_sample(now)
        self._answers.on_sample(now)
        self._reports.on_sample(now)
        self._status.on_sample(now)
        self._clients.on_sample(now)
        self._goals.on_sample(now)
        self._configured.on_sample(now)
        self.coverage.on_sample()
        for wire in self._wires:
            wire.on_sample(now)
        for name, rule in self._rules:
            self._ask(name, rule)
        self._robot.time.later(_CHECK_NS, self._observe)

    def _ask(self, name: str, rule: Rule) -> None:
        text = rule(self._robot)
        if text is None:
            self._broken.discard(name)
        elif name not in self._broken:
            self._broken.add(name)
            self._report(name, text)
