"""What must hold in every simulation, watched by an observer on the wire and at the shafts; and what users add.

A rule of a user is a function of the entry point group `canopen_control.invariants`: it is called with the
`SimulatedRobot` every 20 ms of its time and returns a sentence where something is wrong, else None.
"""

from __future__ import annotations

import functools
import importlib.metadata
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.simulation.client_rules import ClientRules
from canopen_control.simulation.configuration_rules import ConfigurationRules
from canopen_control.simulation.disturbed_nodes import DisturbedNodes
from canopen_control.simulation.face_rules import FaceRules
from canopen_control.simulation.fault_coverage import FaultCoverage
from canopen_control.simulation.goal_rules import GoalRules
from canopen_control.simulation.motion_rules import MotionRules
from canopen_control.simulation.state_coverage import StateCoverage
from canopen_control.simulation.target_rules import TargetRules
from canopen_control.simulation.told_rules import ToldRules
from canopen_control.simulation.wire_rules import WireRules
from canopen_control.simulation.wire_view import WireView

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.simulation.act_player import ActPlayer
    from canopen_control.simulation.acts import Act
    from canopen_control.simulation.motions import Motion
    from canopen_control.simulation.simulated_robot import SimulatedRobot

    Rule = Callable[[SimulatedRobot], str | None]

__all__ = ["GROUP", "Breach", "Invariants", "user_rules"]

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


class Invariants:
    """Watches a robot from now on; `breaches` grows, up to a hundred, `coverage` counts the edges that it walks.

    `troubled` counts the troubles by the states that they hit.
    """

    def __init__(
        self,
        robot: SimulatedRobot,
        player: ActPlayer,
        motions: Sequence[Motion],
        rules: Sequence[tuple[str, Rule]] = (),
    ) -> None:
        self.breaches: list[Breach] = []
        self._robot, self._began = robot, robot.now_ns
        views = {name: WireView(bus) for name, bus in robot.setup.joined.items()}
        self._motion = MotionRules(robot, views, motions, self._tell)
        self._disturbed = DisturbedNodes(robot)
        self._targets = TargetRules(robot, views, motions, self._disturbed, self._tell)
        self._told = ToldRules(robot, views, self._tell)
        self._faces = FaceRules(robot, views, self._disturbed, self._tell)
        self._clients = ClientRules(robot, player.clients, self._tell)
        self._goals = GoalRules(robot, player, self._faces, self._tell)
        plans = [plan for bus in robot.setup.joined.values() for plan in bus.plans.values()]
        self._configured = ConfigurationRules(robot, plans, self._disturbed, self._tell)
        self._wires = [WireRules(robot, robot.wires[name], view, self._tell) for name, view in views.items()]
        self.coverage, self.troubled = StateCoverage(robot, views.values()), FaultCoverage(robot)
        self._rules = list(rules)
        self._broken: set[str] = set()
        for (name, view), wire in zip(views.items(), self._wires, strict=True):
            robot.wires[name].observe(view.hear, view.wants)
            robot.wires[name].observe(wire.heard, wire.wants)
        player.on_asked, player.on_played, player.on_goal = self._asked, self._played, self._goals.taken
        player.on_taken = self._told.taken
        robot.time.later(_LOOK_NS, self._look)

    def _tell(self, rule: str, text: str) -> None:
        if len(self.breaches) < _MOST:
            self.breaches.append(Breach((self._robot.now_ns - self._began) / 1e9, rule, text))

    def _asked(self, now: int, act: Act) -> None:
        self._motion.asked(now, act)
        self._targets.asked(now, act)
        self._told.asked(now, act)
        self._goals.asked(now, act)

    def _played(self, now: int, act: Act) -> None:
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
