import pytest
from support.simulated import BASE, FORWARD, Played

from canopen_control.runtime.core import RobotState
from canopen_control.simulation.acts import Act
from canopen_control.simulation.motion_rules import MotionRules
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.wire_view import WireView


class Judged(Played):
    """A simulated robot with the rules of motion alone; `lie` keeps what is asked from them."""

    def __init__(self):
        super().__init__()
        setup = self.robot.setup
        views = {name: WireView(bus) for name, bus in setup.buses.items()}
        self.told = []
        self.rules = MotionRules(self.robot, views, motions_of(setup), lambda rule, text: self.told.append(rule))
        for name, view in views.items():
            self.robot.wires[name].heard.append(view.hear)
        self.player.on_asked = self.rules.asked
        self.run(0.2)

    def run(self, seconds):
        for _ in range(round(seconds / 0.02)):
            super().run(0.02)
            if hasattr(self, "rules"):
                self.rules.sampled(self.robot.now_ns)
        return self


@pytest.fixture
def judged():
    made = Judged()
    yield made
    made.close()


def test_what_is_commanded_may_move_and_runs_out_in_time(judged):
    judged.drive(5.0, 5.0, seconds=1.0).run(5.0)
    assert judged.told == []


def test_motion_without_a_command_is_told_once(judged):
    judged.player.on_asked = lambda now, act: None
    judged.drive(5.0, 5.0, seconds=2.0).run(2.0)
    assert judged.told == ["motion_uncommanded"] * 2  # of each wheel


def test_motion_after_a_stop_that_was_asked_is_told(judged):
    judged.drive(5.0, 5.0, seconds=4.0).run(1.0)
    judged.rules.asked(judged.robot.now_ns, Act(0, "stop"))
    judged.run(1.0)
    assert judged.told == ["stop_late"] * 2 + ["enabled_still"] * 2


@pytest.mark.parametrize(
    ("act", "told"),
    [(Act(0, "stop"), 2), (Act(0, "axis", name="disable"), 2), (Act(0, "axis", name="halt"), 0)],
)
def test_a_drive_that_stands_and_is_kept_enabled_after_a_stop_is_told(judged, act, told):
    judged.rules.asked(judged.robot.now_ns, act)
    judged.run(0.4)
    assert judged.told == []
    judged.run(1.0)
    assert judged.told == ["enabled_still"] * told


def test_an_enable_that_nobody_asked_for_is_told(judged):
    judged.do("stop").run(0.5)
    judged.player.on_asked = lambda now, act: None
    judged.do("axis", name="enable").run(0.5)
    assert judged.told == ["enable_unasked"] * 2


def test_a_switch_to_a_controller_asks_for_an_enable(judged):
    judged.do("activate", BASE).run(0.3).do("stop").run(0.5).do("activate", FORWARD).run(0.5)
    assert judged.robot.core.state is RobotState.RUNNING
    assert judged.told == []


def test_a_robot_that_is_started_while_its_drives_turn_stops_them(judged):
    judged.drive(5.0, 5.0, seconds=4.0).run(1.0).do("kill", seconds=0.1).run(1.5)
    assert judged.told == []
    assert judged.speed(2) == 0.0


def test_an_enable_while_stop_is_latched_does_not_count(judged):
    judged.do("latch").run(0.3)
    judged.rules.asked(judged.robot.now_ns, Act(0, "axis", name="enable"))
    judged.robot.core.latch.by = None
    judged.player.on_asked = lambda now, act: None
    judged.do("axis", name="enable").run(0.5)
    assert judged.told == ["enable_unasked"] * 2


@pytest.mark.parametrize("kind", ["power", "cut", "stall"])
def test_a_drive_that_is_lost_stops_all_in_time(judged, kind):
    judged.drive(5.0, 5.0, seconds=4.0).run(1.0).do(kind, 3, 2.0).run(3.0)
    assert judged.told == []


def test_a_robot_that_is_killed_is_stopped_by_its_drives_and_its_start_enables(judged):
    judged.drive(5.0, 5.0, seconds=1.0).run(0.9).do("kill", seconds=2.0).run(4.0)
    judged.do("axis", name="fault-reset").run(0.3).do("axis", name="enable").run(0.5)
    judged.do("command", FORWARD, 1.0, values=(5.0, 5.0)).run(0.8)
    assert judged.told == []
    assert judged.speed(2) > 1000
