import pytest
from support.robots import copy_robby
from support.simulated import BASE, FORWARD, MS, Judged, S, setup_of

from canopen_control.controllers.update_loop import UpdateLoop
from canopen_control.runtime.core import RobotCore, RobotState
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.simulation.motion_invariants import MotionInvariants
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.simulation_run import SimulationRun
from canopen_control.testing.tested_robot import TestedRobot
from canopen_control.virtual.scenario import ScenarioEvent


@pytest.fixture
def judged():
    created = Judged(
        lambda judged, views, tell: MotionInvariants(judged.robot, views, motions_of(judged.robot.setup), tell)
    )
    yield created
    created.close()


def test_what_is_commanded_may_move_and_expires_in_time(judged):
    judged.drive(5.0, 5.0, seconds=1.0).run(5.0)
    assert judged.broken == []


def test_motion_without_a_command_is_reported_once(judged):
    judged.blind = True
    judged.drive(5.0, 5.0, seconds=2.0).run(2.0)
    assert judged.broken == ["motion_uncommanded"] * 2  # of each wheel


def test_motion_after_a_stop_that_was_asked_is_reported(judged):
    judged.drive(5.0, 5.0, seconds=4.0).run(1.0)
    judged.rules.requested(judged.robot.now_ns, ScenarioEvent(0, "stop"))
    judged.run(1.0)
    assert judged.broken == ["stop_late"] * 2 + ["enabled_still"] * 2


@pytest.mark.parametrize(
    ("act", "reported"),
    [
        (ScenarioEvent(0, "stop"), 2),
        (ScenarioEvent(0, "axis", name="disable"), 2),
        (ScenarioEvent(0, "axis", name="halt"), 0),
    ],
)
def test_a_drive_that_stands_and_is_kept_enabled_after_a_stop_is_reported(judged, act, reported):
    judged.rules.requested(judged.robot.now_ns, act)
    judged.run(0.4)
    assert judged.broken == []
    judged.run(1.0)
    assert judged.broken == ["enabled_still"] * reported


def test_an_enable_that_is_not_requested_is_reported(judged):
    judged.do("stop").run(0.5)
    judged.blind = True
    judged.do("axis", name="enable").run(0.5)
    assert judged.broken == ["enable_unasked"] * 2


@pytest.mark.sources
def test_a_command_older_than_the_enable_moves_nothing(judged, monkeypatch):
    monkeypatch.setattr(UpdateLoop, "_power_changed", lambda self, slot, part, now: None)
    judged.drive(5.0, 5.0, seconds=0.05).run(0.1).do("fault", 3, 0.1, name="drive_fault").run(0.7)
    judged.do("axis", name="fault-reset").run(0.2)
    assert judged.broken == []
    judged.do("axis", name="enable").run(0.5)
    assert judged.collected[0][1].endswith("without a command since its enable")


@pytest.mark.sources
def test_a_command_that_outlives_its_client_is_reported(judged, monkeypatch):
    judged.do("dead_man", FORWARD, 0.1, values=(5.0, 5.0)).run(2.5)
    assert judged.broken == []
    monkeypatch.setattr(RobotCore, "client_disconnected", lambda self, *who: None)
    judged.do("dead_man", FORWARD, 0.1, values=(5.0, 5.0)).run(2.5)
    assert judged.broken == ["motion_uncommanded"] * 2


def test_a_switch_to_a_controller_asks_for_an_enable(judged):
    judged.do("activate", BASE).run(0.3).do("stop").run(0.5).do("activate", FORWARD).run(0.5)
    assert judged.robot.core.state is RobotState.RUNNING
    assert judged.broken == []


def test_a_robot_that_is_started_while_its_drives_turn_stops_them(judged):
    judged.drive(5.0, 5.0, seconds=4.0).run(1.0).do("kill", seconds=0.1).run(1.5)
    assert judged.broken == []
    assert judged.speed(2) == 0.0


def test_an_enable_while_stop_is_latched_does_not_count(judged):
    judged.do("latch").run(0.3)
    judged.rules.requested(judged.robot.now_ns, ScenarioEvent(0, "axis", name="enable"))
    judged.robot.core.latch.by = None
    judged.blind = True
    judged.do("axis", name="enable").run(0.5)
    assert judged.broken == ["enable_unasked"] * 2


@pytest.mark.parametrize("kind", ["power", "cut", "stall"])
def test_a_drive_that_is_lost_stops_all_in_time(judged, kind):
    judged.drive(5.0, 5.0, seconds=4.0).run(1.0).do(kind, 3, 2.0).run(3.0)
    assert judged.broken == []


@pytest.mark.rest
def test_a_robot_that_is_killed_is_stopped_by_its_drives_and_its_start_enables(judged):
    judged.drive(5.0, 5.0, seconds=1.0).run(0.9).do("kill", seconds=2.0).run(4.0)
    judged.do("axis", name="fault-reset").run(0.3).do("axis", name="enable").run(0.5)
    judged.do("command", FORWARD, 1.0, values=(5.0, 5.0)).run(0.8)
    assert judged.broken == []
    assert judged.speed(2) > 1000


@pytest.mark.rest
def test_the_seed_of_a_drive_that_moved_while_it_was_booted_breaks_nothing():
    acts = (
        ScenarioEvent(614 * MS, "command", "forklift_base_controller", values=(-0.019, 0.672), for_ns=12 * MS),
        ScenarioEvent(634 * MS, "bus_off", "master", for_ns=3_400_000),
        ScenarioEvent(931 * MS, "axis", name="enable"),
    )
    run = SimulationRun(setup_of("forklift"), 683, acts, motions=motions_of(setup_of("forklift")))
    places = []
    run.robot.time.later(S, lambda: places.append(run.robot.drives[4].device.drives[0].mover.plant.position))
    run.run(2 * S)
    place = run.robot.drives[4].device.drives[0].mover.plant.position
    run.close()
    assert run.breaches == ()
    assert place == pytest.approx(places[0], abs=1.0)  # it was enabled where it stood


@pytest.mark.parametrize(("periods", "silence"), [(20, 1.5), (3, 0.2)])
def test_a_silent_master_counts_from_the_consumer_time_of_bus_yml(tmp_path, periods, silence):
    """The drives are configured with heartbeat_multiplier, 20 periods are 2 s."""
    edits = {"heartbeat_multiplier: 5": f"heartbeat_multiplier: {periods}"}
    robot = TestedRobot(read_robot(find_robot(str(copy_robby(tmp_path, bus=edits)))))
    try:
        robot.run(0.5)
        robot.command(FORWARD, 5.0, 5.0, seconds=4.0)
        robot.run(1.0)
        robot.stall(silence)
        robot.run(2.5)
        assert robot.drives[3].velocity
        assert robot.breaches == []
    finally:
        robot.close()
