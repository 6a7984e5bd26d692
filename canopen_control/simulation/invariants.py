"""What must hold in every simulation, watched by an observer on the wire and at the shafts; and what users add.

A rule of a user is a function of the entry point group `canopen_control.invariants`: it is called with the
`RobotUnderTest` every 20 ms of its time and returns a sentence where something is wrong, else None.
"""

from __future__ import annotations

import functools
import importlib.metadata
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.hardware.interfaces import TARGET
from canopen_control.runtime.core import RobotState
from canopen_control.simulation.disturbed_nodes import DisturbedNodes
from canopen_control.simulation.fault_coverage import FaultCoverage, StateCoverage
from canopen_control.simulation.motion_invariants import MotionInvariants
from canopen_control.simulation.robot_under_test import SimulationObserver
from canopen_control.simulation.status_invariants import GoalInvariants, StatusInvariants
from canopen_control.simulation.target_invariants import TargetInvariants
from canopen_control.simulation.wire_invariants import ConfigurationInvariants, WireInvariants
from canopen_control.simulation.wire_view import WireView

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.controllers.trajectory.goal import TrajectoryGoal
    from canopen_control.simulation.event_player import EventPlayer
    from canopen_control.simulation.motions import SampleMotion
    from canopen_control.simulation.robot_under_test import RobotUnderTest
    from canopen_control.simulation.scenario_events import ScenarioEvent
    from canopen_control.simulation.simulated_clients import SimulatedClient, SimulatedClients
    from canopen_control.simulation.wire_view import ObservedNode

    Rule = Callable[[RobotUnderTest], str | None]


# Invariants of the runtime itself: the state told is the state that is, memory is bounded, the program has no error.
#
# What a face of the robot claims (state, axes, velocities) is held against the wire and the shafts, and the STOP latch
# against what clients have asked for, whoever has left or restarted since. Times in ns.


_MS: Final = 1_000_000
_SECOND: Final = 1_000_000_000
_SOON_NS: Final = 400 * _MS  # in which what has happened is told
_FRESH_NS: Final = 100 * _MS
_MEMORY_NS: Final = 60 * _SECOND
_BLOCKS: Final = 60_000  # of memory, that a robot may have more than a while after its start


class ReportInvariants:
    """Holds the runtime's words against what is; `tell(rule, text)` takes breaches.

    `asked`, `taken` and `sampled` are called as time passes.
    """

    def __init__(self, robot: RobotUnderTest, views: Mapping[str, WireView], tell: Callable[[str, str], None]) -> None:
        self._robot, self._tell = robot, tell
        self._nodes = [node for view in views.values() for node in view.nodes.values()]
        self._wrong_since: dict[tuple[str, str], int] = {}  # what of whom
        self._names = {node.node_id: f"node {node.node_id}" for node in self._nodes}
        self._errors = 0
        self._blocks: int | None = None
        self._weigh_at = robot.now_ns + _MEMORY_NS
        self._latched: bool | None = False  # as clients have asked for it; None: nobody knows whether that was heard
        self._latch_asked = self._latch_heard = 0

    def asked(self, now: int, act: ScenarioEvent) -> None:
        """Take what a client asks for; a process that is stalled hears it when it goes on."""
        if act.kind in ("latch", "release"):
            self._latched = act.kind == "latch"
            self._latch_asked, self._latch_heard = now, max(now, self._robot.host.stalled_until)

    def taken(self, now: int, act: ScenarioEvent) -> None:
        """Judge a command that was taken: one all of whose drives have been off for a while must not be."""
        core = self._robot.core
        joints = [core.joints.get(each.joint) for each in core.manager.get(act.target).commands]
        moved = {joint.node.node_id for joint in joints if joint is not None}
        axes = [node for node in self._nodes if node.node_id in moved]
        if axes and all(_is_off(node, now) for node in axes):
            self._tell("command_taken", f"a command to {act.target} is taken, and its drives are off")

    def sampled(self, now: int) -> None:
        """Judge what is told now."""
        robot = self._robot
        for error in robot.errors[self._errors :]:
            self._tell("program_error", f"{type(error).__name__}: {error}")
        self._errors = len(robot.errors)
        if now >= self._weigh_at:
            self._weigh(now)
        if now <= self._latch_heard + _FRESH_NS and not (robot.up and robot.started_ns <= self._latch_asked):
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
        """Judge that STOP is latched from when a client has latched it until one releases it, and at no other time."""
        held, latched = self._robot.core.latch.held, self._latched
        if held is not latched or self._wrong_since:
            self._hold("STOP was latched by {}, and is not any more", "a client", latched is True and not held, now)
            self._hold("STOP is latched, and {} asked for it", "nobody", latched is False and held, now)

    def _judge_state(self, node: ObservedNode, now: int) -> bool:
        """Judge that RUNNING means that every node is there and no drive is in fault; return whether it is not so."""
        limit = node.timeout_ns
        silent = limit > 0 and node.alive_at > 0 and now - node.alive_at > limit
        fault = node.in_fault and now - node.status_at < _FRESH_NS
        if not (silent or fault or self._wrong_since):
            return False
        name, running = self._names[node.node_id], self._robot.core.state is RobotState.RUNNING
        self._hold("running, and {} is silent", name, running and silent, now)
        self._hold("running, and {} is in fault", name, running and fault, now)
        return silent or fault

    def _judge_axes(self, node: ObservedNode, now: int, *, troubled: bool) -> None:
        """Judge that an axis told as enabled shows it on the wire, and while RUNNING each that is claimed."""
        wrong = now - node.status_at < _FRESH_NS and not node.enabled
        if not (wrong or self._wrong_since):
            return
        for joint in self._robot.core.joints.values():
            if joint.node.node_id == node.node_id:
                told = wrong and joint.enabled
                self._hold("{} is told enabled, and its statusword says no", joint.joint, told, now)
                claimed = wrong and not troubled and not joint.axis.number and joint.claimed not in (None, TARGET)
                off = claimed and self._robot.core.state is RobotState.RUNNING
                self._hold("running, and {} is claimed by a controller and off", joint.joint, off, now)

    def _hold(self, text: str, who: str, wrong: bool, now: int) -> None:
        """Tell what has been wrong for longer than it takes to be told."""
        since, what = self._wrong_since, (text, who)
        if not wrong:
            if since:
                since.pop(what, None)
        elif now - since.setdefault(what, now) > _SOON_NS and since[what] >= 0:
            since[what] = 1 << 62  # once
            self._tell("state_told", text.format(who))

    def _weigh(self, now: int) -> None:
        blocks = sys.getallocatedblocks()
        self._weigh_at = now + _MEMORY_NS
        if self._blocks is None:
            self._blocks = blocks
        elif blocks - self._blocks > _BLOCKS:
            self._tell("memory", f"{blocks - self._blocks} blocks of memory more than after a minute")
            self._blocks = blocks


def _is_off(node: ObservedNode, now: int) -> bool:
    """Whether a drive shows that it is not enabled, and has for a while."""
    return not node.enabled and node.shown_enabled_at < now - _SOON_NS and now - node.status_at < _FRESH_NS


# Invariants of clients: one that hangs holds up neither the robot nor other clients, and is not kept for ever.
#
# That a command ends with its client, and with its time-out, is judged by the motion of the shafts
# (`motion_invariants`). Times in ns.


_ANSWER_NS: Final = 1000 * _MS  # in which an answer comes, though others hang: newcomers may stay idle for half of it
_DEAF_NS: Final = 5000 * _MS  # after which who reads nothing has got more than is kept for anybody


class ClientInvariants:
    """Judges how a robot serves its clients; `tell(rule, text)` takes breaches. `sampled` is called as time passes."""

    def __init__(self, robot: RobotUnderTest, clients: SimulatedClients, tell: Callable[[str, str], None]) -> None:
        self._robot, self._clients, self._tell = robot, clients, tell
        self._blocked = 0
        self._told: set[SimulatedClient] = set()

    def sampled(self, now: int) -> None:
        """Judge how clients fare now."""
        if self._clients.blocked > self._blocked:
            self._blocked = self._clients.blocked
            self._tell("client_blocks", "the robot waits for a client that does not read")
        host = self._robot.host
        if not self._robot.up or now < host.stalled_until:
            return
        for client in self._clients.all:
            if client.here and client not in self._told:
                self._judge(client, now, max(host.stalled_until, self._robot.started_ns))

    def _judge(self, client: SimulatedClient, now: int, since: int) -> None:
        if client.reads and client.waits_since is not None and now - max(client.waits_since, since) > _ANSWER_NS:
            self._say(client, "client_waits", f"a client has waited for an answer for {_ANSWER_NS // _MS} ms")
        elif not client.reads and client.asks and not client.dropped and now - max(client.came_ns, since) > _DEAF_NS:
            self._say(client, "client_kept", f"a client that reads nothing is kept for {_DEAF_NS // _MS} ms")

    def _say(self, client: SimulatedClient, rule: str, text: str) -> None:
        self._told.add(client)
        self._tell(rule, text)


GROUP: Final = "canopen_control.invariants"
_LOOK_NS: Final = 20_000_000
_MOST: Final = 100


@dataclass(frozen=True, slots=True)
class Breach:
    """An invariant that did not hold, `at_s` after the start; `rule` is its short name."""

    at_s: float
    rule: str
    text: str

    @property
    def sentence(self) -> str:
        """The breach in a line."""
        return f"{self.at_s:.3f} s: {self.rule}: {self.text}"


def user_rules() -> list[tuple[str, Rule]]:
    """Return the rules that installed packages add, by name."""
    return [(each.name, each.load()) for each in _entry_points()]


@functools.cache
def _entry_points() -> tuple[importlib.metadata.EntryPoint, ...]:
    """Return the entry points, read once: the metadata of each package is a file."""
    return tuple(importlib.metadata.entry_points(group=GROUP))


class Invariants(SimulationObserver):
    """Watches a robot from now on; `breaches` grows, up to a hundred, `coverage` counts the edges that it walks.

    `troubled` counts the troubles by the states that they hit.
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
        self._motion = MotionInvariants(robot, views, motions, self._tell)
        self._disturbed = DisturbedNodes(robot)
        self._targets = TargetInvariants(robot, views, motions, self._disturbed, self._tell)
        self._told = ReportInvariants(robot, views, self._tell)
        self._faces = StatusInvariants(robot, views, self._disturbed, self._tell)
        self._clients = ClientInvariants(robot, player.clients, self._tell)
        self._goals = GoalInvariants(robot, player, self._faces, self._tell)
        plans = [plan for bus in robot.setup.joined.values() for plan in bus.plans.values()]
        self._configured = ConfigurationInvariants(robot, plans, self._disturbed, self._tell)
        self._wires = [WireInvariants(robot, robot.wires[name], view, self._tell) for name, view in views.items()]
        self.coverage, self.troubled = StateCoverage(robot, views.values()), FaultCoverage(robot)
        self._rules = list(rules)
        self._broken: set[str] = set()
        for (name, view), wire in zip(views.items(), self._wires, strict=True):
            robot.wires[name].observe(view)
            robot.wires[name].observe(wire)
        robot.observers.append(self)
        robot.time.later(_LOOK_NS, self._look)

    def _tell(self, rule: str, text: str) -> None:
        if len(self.breaches) < _MOST:
            self.breaches.append(Breach((self._robot.now_ns - self._began) / 1e9, rule, text))

    def asked(self, now: int, act: ScenarioEvent) -> None:
        """Take what a client asks for."""
        self._motion.asked(now, act)
        self._targets.asked(now, act)
        self._told.asked(now, act)
        self._goals.asked(now, act)

    def goal(self, now: int, act: ScenarioEvent, goal: TrajectoryGoal) -> None:
        """Take a goal that was taken."""
        self._goals.taken(now, act, goal)

    def taken(self, now: int, act: ScenarioEvent) -> None:
        """Take a command that was taken."""
        self._told.taken(now, act)

    def played(self, now: int, act: ScenarioEvent) -> None:
        """Take an act that begins."""
        self._disturbed.troubled(now, act)
        self.troubled.troubled(act)

    def _look(self) -> None:
        now = self._robot.now_ns
        self._disturbed.sampled(now)
        self._motion.sampled(now)
        self._targets.sampled(now)
        self._told.sampled(now)
        self._faces.sampled(now)
        self._clients.sampled(now)
        self._goals.sampled(now)
        self._configured.sampled(now)
        self.coverage.sampled()
        for wire in self._wires:
            wire.sampled(now)
        for name, rule in self._rules:
            self._ask(name, rule)
        self._robot.time.later(_LOOK_NS, self._look)

    def _ask(self, name: str, rule: Rule) -> None:
        text = rule(self._robot)
        if text is None:
            self._broken.discard(name)
        elif name not in self._broken:
            self._broken.add(name)
            self._tell(name, text)
