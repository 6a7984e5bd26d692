"""Robots in virtual time for the tests of simulations."""

import functools

from support.observers import Watch

from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.simulation.event_player import EventPlayer
from canopen_control.simulation.robot_under_test import RobotUnderTest
from canopen_control.simulation.wire_view import DisturbedNodes, WireView
from canopen_control.virtual.scenario import ScenarioEvent

MS = 1_000_000
S = 1_000_000_000
FORWARD, BASE = "robby_forward_controller", "robby_base_controller"


@functools.cache
def setup_of(name="robby", *controllers):
    return read_robot(find_robot(name), controllers=controllers)


class Played:
    """A simulated robot that plays acts: `seconds` into its time, `kinds` of its events, `speed` of a drive's shaft."""

    def __init__(self, name="robby", seed=1):
        self.robot = RobotUnderTest(setup_of(name), seed)
        self.player = EventPlayer(self.robot)
        self.events = []
        self.robot.observers.append(Watch(event=self.events.append))
        self.robot.start()
        self.run(0.6)

    @property
    def kinds(self):
        return [event.kind for event in self.events]

    def run(self, seconds):
        self.robot.run_for(round(seconds * S))
        assert self.robot.errors == []
        return self

    def do(self, kind, target="", seconds=None, **more):
        self.player.play(
            ScenarioEvent(0, kind, str(target), for_ns=None if seconds is None else round(seconds * S), **more)
        )
        return self

    def drive(self, *values, seconds=2.0):
        return self.do("command", FORWARD, seconds, values=values)

    def speed(self, node_id):
        device = self.robot.drives[node_id].device
        return 0.0 if device is None else device.drives[0].mover.plant.velocity

    def close(self):
        self.robot.close()


class Judged(Played):
    """A simulated robot with one kind of rules alone: `collected` are its breaches, each the rule and what it says.

    `make(judged, views, tell)` makes the rules; they see every 20 ms of `run`, and what is asked and played.
    """

    def __init__(self, make, name="robby"):
        self.rules = None
        super().__init__(name)
        self.collected = []
        self.disturbed = DisturbedNodes(self.robot)
        views = {name: WireView(bus) for name, bus in self.robot.setup.buses.items()}
        for name, view in views.items():
            self.robot.wires[name].listeners.append(view.hear)
        self.rules = make(self, views, lambda rule, text: self.collected.append((rule, text)))
        self.blind = False
        self.robot.observers.append(Watch(requested=self._asked, played=self.disturbed.on_event))
        self.run(0.2)

    def _asked(self, now, act):
        if not self.blind and hasattr(self.rules, "requested"):
            self.rules.requested(now, act)

    @property
    def broken(self):
        return [rule for rule, _ in self.collected]

    def run(self, seconds):
        for _ in range(round(seconds / 0.02)):
            self.robot.run_for(20 * MS)
            if self.rules is not None:
                self.disturbed.on_sample(self.robot.now_ns)
                self.rules.on_sample(self.robot.now_ns)
        return self
