import pytest
from support.simulated import Played, S, setup_of

from canopen_control.runtime.core import RobotState
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.random_schedule import draw_schedule, known_faults
from canopen_control.simulation.robot_under_test import RobotUnderTest, Timings, dictionary_of
from canopen_control.simulation.simulation_run import SimulationRun
from canopen_control.simulation.virtual_time import Timing


def digest_of(seed, name="robby"):
    robot = RobotUnderTest(setup_of(name), seed)
    robot.start()
    robot.run_for(2 * S)
    digest = robot.digest.hex
    assert robot.errors == []
    assert robot.running
    robot.close()
    return digest


@pytest.mark.rest
@pytest.mark.parametrize("name", ["robby", "arm6", "forklift"])
def test_a_robot_boots_in_virtual_time_and_the_same_seed_does_the_same(name):
    assert digest_of(3, name) == digest_of(3, name) != digest_of(4, name)


def test_two_robots_at_once_do_not_hear_each_other():
    first, second = RobotUnderTest(setup_of(), 1), RobotUnderTest(setup_of(), 1)
    for robot in (first, second):
        robot.start()
    for _ in range(20):
        first.run_for(S // 10)
        second.run_for(S // 10)
    assert first.digest.hex == second.digest.hex == digest_of(1)
    first.close()
    second.close()


def test_a_commanded_robot_turns_its_shafts(played):
    played.drive(5.0, 5.0).run(1.5)
    assert played.speed(2) == pytest.approx(5.0 * 254.648, rel=0.01)
    assert played.speed(3) == pytest.approx(-5.0 * 254.648, rel=0.01)


def test_a_killed_robot_is_restarted_and_boots_again(played):
    played.drive(5.0, 5.0).run(1.0)
    played.robot.kill()
    played.run(2.0)
    assert played.speed(2) == 0.0  # the drives have missed its heartbeat
    played.robot.restart()
    played.run(3.0)
    assert played.robot.running


def test_a_drive_without_supply_is_lost_and_comes_back(played):
    played.robot.drives[3].power_off()
    played.robot.drives[3].power_off()
    played.run(1.5)
    assert played.robot.core.state is RobotState.FAULT
    played.robot.drives[3].power_on()
    played.robot.drives[3].power_on()
    played.run(3.0)
    assert played.robot.core.state is not RobotState.FAULT


def test_clocks_and_lateness_can_be_ideal():
    robot = RobotUnderTest(setup_of(), 1, Timings(Timing(), Timing(), 0.0))
    robot.start()
    robot.run_for(2 * S)
    assert robot.core.pacer.late_max == 0
    assert robot.running
    robot.close()


def test_an_eds_is_read_once():
    path = setup_of().bus.eds_paths["left_drive"]
    assert dictionary_of(path) is dictionary_of(path)


def test_a_robot_that_was_closed_does_nothing_any_more():
    played = Played()
    played.close()
    frames = played.robot.frames
    played.robot.run_for(S)
    assert played.robot.frames == frames


def test_a_robot_that_a_plugin_simulates_has_no_drives_whatever_its_folder_holds():
    setup = setup_of("diffbot_sim")
    assert list(setup.buses)
    run = SimulationRun(setup, 1, draw_schedule(1, 10 * S, motions_of(setup), (), known_faults()))
    assert (run.robot.wires, run.robot.drives) == ({}, {})
    run.run(10 * S)
    assert run.robot.running
    assert (run.breaches, run.robot.errors, run.player.refused) == ((), [], 0)
    assert any(act.kind == "command" for act in run.player.played)
    run.close()
