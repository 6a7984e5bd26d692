"""Nothing moves without an enabled axis and a live command newer than its enable, for any sequence of events.

A whole robot on the memory bus in simulated time; what is watched are the targets on the bus, cycle by cycle, and the
rule is told by a model that knows only what was asked for and what the drives themselves say.
"""

from __future__ import annotations

import contextlib
import itertools

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule
from support.observers import Observer
from support.properties import examples
from support.robots import FORWARD, LEFT, RIGHT, Bench, copy_robby

from canopen_control.errors import CanopenError
from canopen_control.hardware.axis_statechart import Action

NUMBERS = itertools.count()
TIMEOUTS = {"default": {"    command_timeout: 2.0 ": "    # "}, "for ever": {"timeout: 2.0": "timeout: 0.0"}}
LIFE_NS = {"default": 2_000_000_000, "for ever": 1 << 62}
CYCLE_NS = 20_000_000
BASE = "robby_base_controller"
BASE_LIFE_NS = 500_000_000
HOLDERS = st.sampled_from(["bridge", "page"])
SPEEDS = st.sampled_from([[5.0, 5.0], [-3.0, 8.0], [4.0, 1.0], [1e308, 0.0]])


class Commanding(RuleBasedStateMachine):
    """`alive_until` is until when the newest accepted command counts, by joint: a verb may end that of one alone."""

    bench = None

    @initialize(timeout=st.sampled_from(sorted(TIMEOUTS)))
    def start(self, timeout):
        self.folder = self.make_folder()
        config = copy_robby(self.folder, controllers=TIMEOUTS[timeout])
        self.bench = Bench(f"commands{next(NUMBERS)}", config=config)
        self.life = LIFE_NS[timeout]
        self.alive_until, self.holder, self.controller = {}, None, FORWARD
        self.aside = set()
        self.broken = []
        self.bench.start()
        self.bench.robot.observers.append(Observer(after_cycle=self.look))

    make_folder = None  # set by the test

    def look(self, now):
        """Judge the targets that have just left: a cycle after the end of a command they are zero, unless it ramps."""
        for joint in self.bench.robot.joints.values():
            target = joint.targets.current
            if target is None or target.output.value == 0:
                continue
            alive = now <= self.alive_until.get(joint.joint, -CYCLE_NS) + CYCLE_NS
            braking = self.controller == BASE and now <= self.brakes_until
            if not (alive or braking) or not joint.machine.enabled:
                self.broken.append((now, joint.joint, target.output.value, dict(self.alive_until), joint.machine.state))

    brakes_until = 0

    def pass_time(self, ms):
        self.bench.run(ms)
        assert not self.broken, self.broken[:3]

    def end(self):
        self.alive_until, self.holder = {}, None

    def takes_commands(self):
        """Whether all drives are enabled, but those that a user has taken out alone; one at least."""
        joints = self.bench.robot.joints.values()
        on = {joint.joint for joint in joints if joint.enabled and not joint.machine.halted}
        return bool(on) and on | self.aside >= {joint.joint for joint in joints}

    @rule(values=SPEEDS, holder=HOLDERS, ms=st.sampled_from([0, 100, 1900]))
    def command_and_wait(self, values, holder, ms):
        self.command(values, holder)
        self.pass_time(ms)

    @rule()
    def get_going(self):
        """Do all that it takes for the robot to follow commands again, and give none."""
        robot = self.bench.robot
        for node_id in (LEFT, RIGHT):
            if node_id not in self.bench.drives:
                self.bench.power_on(node_id)
        self.pass_time(1000)
        robot.latch.release("a test", self.bench.reactor.now())
        for action in (Action.FAULT_RESET, Action.ENABLE):
            self.axis(action, "all")
            self.pass_time(500)

    def command(self, values, holder):
        robot, now = self.bench.robot, self.bench.reactor.now()
        values = [0.05 * value for value in values] if self.controller == BASE else values
        enabled = self.takes_commands()
        try:
            robot.command(self.controller, values, "test", holder=holder)
        except CanopenError:
            if max(map(abs, values)) > 1e300:
                self.end()
            return
        assert enabled, "taken while a drive is off"
        assert max(map(abs, values)) < 1e300
        life = BASE_LIFE_NS if self.controller == BASE else self.life
        following = [joint.joint for joint in robot.joints.values() if joint.following]
        self.alive_until, self.holder = dict.fromkeys(following, now + life), holder
        self.aside -= set(following)
        self.brakes_until = now + BASE_LIFE_NS + 1_000_000_000

    @rule(ms=st.sampled_from([1, 20, 21, 100, 700, 2500]))
    def wait(self, ms):
        self.pass_time(ms)

    @rule(latched=st.booleans())
    def stop(self, latched):
        self.bench.robot.stop(lambda _error: None, "a test" if latched else None)
        self.end()

    @rule()
    def release(self):
        self.bench.robot.latch.release("a test", self.bench.reactor.now())

    @rule(
        action=st.sampled_from([Action.ENABLE, Action.DISABLE, Action.HALT, Action.QUICK_STOP, Action.FAULT_RESET]),
        node=st.sampled_from(["all", "left_drive", "right_drive"]),
    )
    def axis(self, action, node):
        with contextlib.suppress(CanopenError):
            self.bench.robot.axis(action, node, lambda _error: None)
            if action is Action.FAULT_RESET:
                return
            alone = [joint.joint for joint in self.bench.robot.joints.values() if joint.node.name == node]
            if alone and action is not Action.ENABLE and self.controller == FORWARD:
                self.aside.update(alone)
                for name in alone:
                    self.alive_until.pop(name, None)
            else:
                self.end()  # an enable too: it takes a command that is newer

    @rule(node_id=st.sampled_from([LEFT, RIGHT]))
    def fault(self, node_id):
        if node_id in self.bench.drives and self.alive_until:
            self.bench.drives[node_id].drives[0].fault(0x4310, self.bench.reactor.now())
            self.pass_time(41)  # until the master has heard of it
            self.end()

    @precondition(lambda self: self.alive_until)
    @rule(node_id=st.sampled_from([LEFT, RIGHT]))
    def power(self, node_id):
        if node_id in self.bench.drives:
            self.bench.power_off(node_id)
            self.pass_time(1000)
            self.end()
        else:
            self.bench.power_on(node_id)

    @rule(holder=HOLDERS)
    def connection_gone(self, holder):
        self.bench.robot.client_disconnected(holder)
        if self.holder == holder:
            self.end()
            self.pass_time(100)

    @precondition(lambda self: not self.bench.robot.latch.held)
    @rule()
    def switch(self):
        other = BASE if self.controller == FORWARD else FORWARD
        with contextlib.suppress(CanopenError):
            self.bench.robot.switch([other], [self.controller], strict=True)
            self.controller = other
            self.end()

    def teardown(self):
        if self.bench is not None:
            try:
                self.pass_time(3000)
            finally:
                self.bench.close()


def test_nothing_moves_without_an_enable_and_a_newer_command(tmp_path_factory):
    class OnDisk(Commanding):
        def make_folder(self):
            return tmp_path_factory.mktemp("robby")

    OnDisk.TestCase.settings = settings(
        max_examples=examples(30),
        stateful_step_count=20,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.explicit, Phase.reuse, Phase.generate],  # a whole robot is too slow to shrink
    )
    expect_no_counterexample = OnDisk.TestCase().runTest
    expect_no_counterexample()
