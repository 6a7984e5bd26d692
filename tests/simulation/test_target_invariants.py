import pytest
from support.generic import write_generic
from support.mutants import MUTANTS
from support.simulated import BASE, FORWARD, MS, Judged, S, setup_of

from canopen_control.controllers.update_loop import UpdateLoop
from canopen_control.hardware.axis import AxisObjectLimits as AxisLimitsOfMaster
from canopen_control.hardware.joint_targets import JointTargets
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.simulation.answer_invariants import AnswerInvariants
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.robot_under_test import RobotUnderTest
from canopen_control.simulation.simulation_run import SimulationRun
from canopen_control.simulation.target_invariants import TargetInvariants, _Followed
from canopen_control.virtual.power_machine import DriveLimits
from canopen_control.virtual.scenario import ScenarioEvent


def rules(judged, views, tell):
    motions = motions_of(judged.robot.setup)
    answers = AnswerInvariants(judged.robot, views, motions, judged.disturbed, tell)
    return TargetInvariants(judged.robot, views, motions, judged.disturbed, answers, tell)


@pytest.fixture
def judged():
    created = Judged(rules)
    yield created
    created.close()


@pytest.mark.rest
def test_what_follows_its_targets_is_not_reported(judged):
    judged.drive(5.0, -5.0, seconds=1.0).run(0.6).drive(-7.0, 2.0, seconds=0.5).run(3.0).do("stop").run(1.0)
    judged.do("axis", name="enable").run(0.5).drive(3.0, 3.0, seconds=0.5).run(1.0)
    judged.do("activate", BASE).run(0.5).do("command", BASE, 0.5, values=(0.3, 0.4)).run(1.5)
    assert judged.collected == []


def test_a_halt_and_a_fault_are_not_news(judged):
    judged.drive(5.0, 5.0, seconds=2.0).run(0.6).do("axis", name="halt").run(0.5)
    judged.do("fault", 3, 0.5, name="drive_fault").run(1.5)
    assert judged.collected == []


def test_a_drive_that_stops_at_its_software_limit_before_its_statusword_shows_that_is_not_reported(judged):
    for drive in judged.robot.drives.values():
        drive.device.store.set(0x607D, 1, -100_000)
        drive.device.store.set(0x607D, 2, 300 + 17 * drive.node_id)
    judged.drive(5.0, 5.0, seconds=1.0).run(1.2)
    assert judged.collected == []


def test_a_group_that_stands_because_of_the_limit_of_one_drive_has_lost_no_command(judged):
    device = judged.robot.drives[3].device
    for subindex, way in ((1, -6_000), (2, 6_000)):
        device.store.set(0x607D, subindex, device.drives[0].objects.number(0x6064) + way)
    judged.run(3.0).drive(5.0, 5.0, seconds=7.0).run(7.0)
    assert "limit" in judged.kinds
    assert judged.collected == []


QUICK_STOP = "- {index: 0x6007, sub_index: 0, value: 3}"  # of a lost master


def test_no_drive_is_commanded_against_its_limit_after_the_death_of_the_robot(tmp_path):
    setup = read_robot(
        find_robot(str(write_generic(tmp_path, sdo=QUICK_STOP, extra="counts_per_revolution: 65536"))),
        controllers=["velocity"],
    )
    robot = RobotUnderTest(setup)
    for drive in robot.drives.values():
        drive.quirks = ["internal_limit_always"]
    enable, kill = ScenarioEvent(1 * S, "axis", name="enable"), ScenarioEvent(3 * S, "kill")
    command = ScenarioEvent(2 * S, "command", "velocity", values=(-2.0, -2.0), for_ns=3 * S)
    simulation = SimulationRun(setup, 1, [enable, command, kill], robot=robot)
    simulation.run(5 * S)
    simulation.close()
    assert simulation.breaches == ()


@pytest.mark.sources
@pytest.mark.parametrize(
    ("mutant", "rule"),
    [
        ("targets_too_great", "target_wrong"),
        ("shafts_overshoot", "target_missed"),
        ("shafts_stay_behind", "target_missed"),
    ],
)
def test_targets_and_shafts_that_disagree_are_reported_once_for_each_joint(judged, monkeypatch, mutant, rule):
    MUTANTS[mutant](monkeypatch)
    judged.drive(5.0, 5.0, seconds=1.0).run(0.9)
    assert judged.broken == [rule] * 2


def test_a_disturbed_node_is_checked_again_after_the_next_enable(judged, monkeypatch):
    judged.do("fault", 3, 0.1, name="hand_moved").run(0.3)
    MUTANTS["shafts_overshoot"](monkeypatch)
    judged.drive(5.0, 5.0, seconds=0.5).run(0.6)
    assert [text.split(" turns")[0] for _, text in judged.collected] == ["the shaft of node 2"]
    judged.do("stop").run(1.0).do("axis", name="enable").run(0.5).drive(5.0, 5.0, seconds=0.5).run(0.6)
    assert "the shaft of node 3" in [text.split(" turns")[0] for _, text in judged.collected]


@pytest.mark.rest
@pytest.mark.sources
def test_a_place_at_every_sync_is_followed_within_the_window(monkeypatch):
    created = Judged(rules, "arm6")
    [motion] = [item for item in motions_of(created.robot.setup) if item.starts]
    created.do("trajectory", motion.controller, 1.0, values=(0.3,) * 6).run(1.5)
    assert created.collected == []
    real = DriveLimits.position
    monkeypatch.setattr(DriveLimits, "position", lambda self, target: real(self, target + 1e6))
    created.do("trajectory", motion.controller, 1.0, values=(0.1,) * 6)
    created.run(0.3)
    created.close()
    assert created.broken == ["target_missed"] * 6


@pytest.mark.sources
def test_the_range_of_a_speed_grows_only_with_the_time_of_the_shaft():
    followed = _Followed(view=None)
    followed.ramp(-3000.0, -3000.0, 13000.0, S, speed=0.0)
    followed.ramp(-3000.0, -3000.0, 13000.0, S + 20 * MS, speed=-260.0)
    assert (followed.low, followed.high) == (-3000.0, pytest.approx(-260.0))
    followed.ramp(-3000.0, -3000.0, 13000.0, S + 20 * MS, speed=-260.0)  # the drive has not computed since
    assert (followed.low, followed.high) == (-3000.0, pytest.approx(-260.0))


@pytest.mark.sources
def test_a_drive_that_computes_late_is_compared_with_the_speed_of_its_own_time(judged, monkeypatch):
    times = []
    ramp = _Followed.ramp

    def recorded(self, low, high, slope, now, speed):
        times.append(now)
        ramp(self, low, high, slope, now, speed)

    monkeypatch.setattr(_Followed, "ramp", recorded)
    judged.drive(3.0, 3.0, seconds=1.0).run(0.5)
    drives = [node.device.drives[0] for node in judged.robot.drives.values()]
    judged.rules.on_sample(judged.robot.now_ns + 15 * MS)  # no drive has computed for 15 ms
    assert times[-2:] == [drive.mover.time for drive in drives]


def test_the_controller_that_takes_values_joint_by_joint_reports_where_they_go(judged):
    ends = {item.controller: item.interfaces for item in motions_of(judged.robot.setup)}
    assert ends == {FORWARD: ("left_wheel_joint/velocity", "right_wheel_joint/velocity"), BASE: ()}


@pytest.mark.rest
def test_the_seed_of_a_twist_for_one_cycle_breaks_nothing():
    acts = (
        ScenarioEvent(5540 * MS, "command", "mecanum_base_controller", values=(-0.074, 0.066, -0.574), for_ns=15 * MS),
    )
    run = SimulationRun(setup_of("mecanum"), 120, acts, motions=motions_of(setup_of("mecanum")))
    run.run(6 * S)
    run.close()
    assert run.breaches == ()


@pytest.mark.sources
def test_a_drive_that_is_off_is_commanded_to_stand(judged, monkeypatch):
    judged.run(1.2).do("stop").run(2.0)
    assert judged.collected == []
    monkeypatch.setattr(JointTargets, "hold", lambda self: None)
    judged.robot.core.joints["left_wheel_joint"].axis.output(0x60FF).set(500)
    judged.run(0.5)
    assert judged.collected == [("target_disabled", "node 3 is commanded to move at 500 while disabled")]


def limits(*steps):
    setup = read_robot(find_robot("tools/campaigner/robots/limits"))
    acts = [ScenarioEvent(round(at * S), *words, **more) for at, words, more in steps]
    run = SimulationRun(setup, 1, acts)
    run.run(6 * S)
    run.close()
    return {breach.rule for breach in run.invariants.breaches}, run


PUSH = (
    (1.5, ("command", "velocity_controller"), {"values": (6.0,), "for_ns": S}),
    (3.0, ("activate", "position_controller"), {}),
    (3.5, ("command", "position_controller"), {"values": (0.5,), "for_ns": S}),
)


def test_limits_of_the_drive_hold_in_every_mode():
    assert limits(*PUSH)[0] == set()


@pytest.mark.sources
@pytest.mark.parametrize("verb", ["of_velocity", "of_position"])
def test_a_target_beyond_the_limits_of_the_drive_is_reported(monkeypatch, verb):
    monkeypatch.setattr(AxisLimitsOfMaster, verb, lambda self, raw: raw)
    assert limits(*PUSH)[0] == {"limit_ignored"}


@pytest.mark.rest
@pytest.mark.sources
def test_a_target_against_a_limit_switch_is_reported(monkeypatch):
    steps = (
        (1.0, ("command", "velocity_controller"), {"values": (1.5,), "for_ns": 5 * S}),
        (2.0, ("fault", "2", "limit_switch"), {}),
    )
    assert limits(*steps)[0] == set()
    monkeypatch.setattr(AxisLimitsOfMaster, "of_velocity", lambda self, raw: raw)
    assert "limit_ignored" in limits(*steps)[0]


@pytest.mark.sources
def test_a_command_dropped_while_it_is_being_renewed_is_reported(judged, monkeypatch):
    judged.run(3.0).drive(5.0, 5.0, seconds=2.0).run(0.6).do("ask", seconds=0.25).run(0.6)
    assert judged.collected == []
    monkeypatch.setattr(UpdateLoop, "client_disconnected", lambda self, *who: self.forget(self.now, "somebody left"))
    judged.do("ask", seconds=0.25).run(0.6)
    assert set(judged.broken) == {"command_lost"}


@pytest.mark.sources
@pytest.mark.parametrize("lost", [False, True])
def test_a_command_that_ends_with_an_earlier_client_is_reported(judged, monkeypatch, lost):
    if lost:
        monkeypatch.setattr(
            UpdateLoop, "client_disconnected", lambda self, *who: self.forget(self.now, "somebody left")
        )
    judged.run(2.5).do("dead_man", FORWARD, 0.55, values=(2.0, 2.0)).run(0.1).drive(5.0, 5.0, seconds=2.0).run(1.0)
    assert set(judged.broken) == ({"command_lost"} if lost else set())


def test_the_same_command_long_after_the_last_one_is_a_new_one(judged):
    judged.run(2.5).drive(5.0, 5.0, seconds=0.5).run(6.0).drive(5.0, 5.0, seconds=0.5).run(1.0)
    assert judged.collected == []


def test_a_command_that_leaves_with_its_client_is_not_reported(judged):
    judged.run(2.5).drive(2.0, 2.0, seconds=1.0).run(0.92).do("dead_man", FORWARD, 0.06, values=(2.0, 2.0)).run(1.0)
    assert judged.collected == []
