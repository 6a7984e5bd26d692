import pytest
from support.mutants import MUTANTS
from support.simulated import BASE, FORWARD, MS, Judged, S, setup_of

from canopen_control.simulation.acts import Act
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.simulation_run import SimulationRun
from canopen_control.simulation.target_rules import TargetRules
from canopen_control.virtual.axis_limits import AxisLimits


def rules(judged, views, tell):
    return TargetRules(judged.robot, views, motions_of(judged.robot.setup), judged.disturbed, tell)


@pytest.fixture
def judged():
    made = Judged(rules)
    yield made
    made.close()


def test_what_follows_its_targets_is_no_news(judged):
    judged.drive(5.0, -5.0, seconds=1.0).run(0.6).drive(-7.0, 2.0, seconds=0.5).run(3.0).do("stop").run(1.0)
    judged.do("axis", name="enable").run(0.5).drive(3.0, 3.0, seconds=0.5).run(1.0)
    judged.do("activate", BASE).run(0.5).do("command", BASE, 0.5, values=(0.3, 0.4)).run(1.5)
    assert judged.told == []


def test_a_halt_and_a_fault_are_no_news(judged):
    judged.drive(5.0, 5.0, seconds=2.0).run(0.6).do("axis", name="halt").run(0.5)
    judged.do("fault", 3, 0.5, name="drive_fault").run(1.5)
    assert judged.told == []


@pytest.mark.sources
@pytest.mark.parametrize(
    ("mutant", "rule"),
    [
        ("targets_too_great", "target_wrong"),
        ("shafts_overshoot", "target_missed"),
        ("shafts_stay_behind", "target_missed"),
    ],
)
def test_targets_and_shafts_that_disagree_are_told_once_for_each_joint(judged, monkeypatch, mutant, rule):
    MUTANTS[mutant](monkeypatch)
    judged.drive(5.0, 5.0, seconds=1.0).run(0.9)
    assert judged.broken == [rule] * 2


def test_who_was_disturbed_is_judged_again_after_the_next_enable(judged, monkeypatch):
    judged.do("fault", 3, 0.1, name="hand_moved").run(0.3)
    MUTANTS["shafts_overshoot"](monkeypatch)
    judged.drive(5.0, 5.0, seconds=0.5).run(0.6)
    assert [text.split(" turns")[0] for _, text in judged.told] == ["the shaft of node 2"]
    judged.do("stop").run(1.0).do("axis", name="enable").run(0.5).drive(5.0, 5.0, seconds=0.5).run(0.6)
    assert "the shaft of node 3" in [text.split(" turns")[0] for _, text in judged.told]


@pytest.mark.sources
def test_a_place_at_every_sync_is_followed_within_the_window(monkeypatch):
    made = Judged(rules, "arm6")
    [motion] = [each for each in motions_of(made.robot.setup) if each.starts]
    made.do("trajectory", motion.controller, 1.0, values=(0.3,) * 6).run(1.5)
    assert made.told == []
    real = AxisLimits.position
    monkeypatch.setattr(AxisLimits, "position", lambda self, target: real(self, target + 1e6))
    made.do("trajectory", motion.controller, 1.0, values=(0.1,) * 6)
    made.run(0.3)
    made.close()
    assert made.broken == ["target_missed"] * 6


def test_the_controller_that_takes_values_joint_by_joint_says_where_they_go(judged):
    ends = {each.controller: each.ends for each in motions_of(judged.robot.setup)}
    assert ends == {FORWARD: ("left_wheel_joint/velocity", "right_wheel_joint/velocity"), BASE: ()}


def test_the_seed_of_a_twist_for_one_cycle_breaks_nothing():
    acts = (Act(5540 * MS, "command", "mecanum_base_controller", values=(-0.074, 0.066, -0.574), for_ns=15 * MS),)
    run = SimulationRun(setup_of("mecanum"), 120, acts, motions=motions_of(setup_of("mecanum")))
    run.run(6 * S)
    run.close()
    assert run.breaches == ()
