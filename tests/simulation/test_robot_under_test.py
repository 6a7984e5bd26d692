import re

import pytest
from support import makers
from support.robots import copy_robby, split_robby
from support.simulated import Played, S, setup_of

from canopen_control.errors import RobotConfigError
from canopen_control.runtime.core import RobotState
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.random_schedule import draw_schedule, known_faults
from canopen_control.simulation.robot_under_test import RobotUnderTest, Timings, dictionary_of
from canopen_control.simulation.simulation_run import SimulationRun
from canopen_control.simulation.virtual_time import Timing
from canopen_control.testing.tested_robot import TestedRobot


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


def test_two_robots_at_once_do_not_receive_each_other():
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


def test_a_drive_without_supply_is_lost_and_returns(played):
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


def test_the_drives_have_the_velocity_unit_of_bus_yml(tmp_path):
    """A wheel in mm/s (210 counts and 32.5 units a radian): its position moves as fast as it is commanded."""
    text = "\n".join(f"scale_{key}" for key in ("pos_to_dev: 210.0", "pos_from_dev: 0.00476190", "vel_to_dev: 32.5",
                                                "vel_from_dev: 0.03076923"))  # fmt: skip
    bus = makers.folder(tmp_path, "csv", keys=text) / "bus.yml"
    bus.write_text(re.sub("  (counts_per_revolution|gear_ratio): .*\n", "", bus.read_text()))
    robot = TestedRobot(read_robot(find_robot(str(tmp_path))))
    robot.command("vel", 1.0, 0.0, seconds=3)
    robot.run(3)
    assert not [event.sentence for event in robot.events if "velocities are in" in event.sentence]
    assert 1.5 < robot.position("pan") < 3.1
    robot.close()


def test_a_node_id_on_two_buses_is_refused_because_drives_are_named_by_it(tmp_path):
    config = split_robby(tmp_path)
    path = config / "bus_right.yml"
    path.write_text(path.read_text().replace("node_id: 2", "node_id: 3"))
    setup = read_robot(find_robot(str(config)))
    with pytest.raises(RobotConfigError, match="right_drive on bus right and a node on bus can are both node 3"):
        RobotUnderTest(setup)


def test_drives_have_the_identity_that_bus_yml_requires(tmp_path):
    """They had that of the EDS, so that the boot ended with error D, M, N, O or G of CiA 302-2."""
    numbers = {"vendor_id": 0x287, "product_code": 1, "revision_number": 5, "serial_number": 77, "software_version": 3}
    keys = "".join(f"    {key}: {number}\n" for key, number in numbers.items())
    played = Played(str(copy_robby(tmp_path, bus={"right_drive:\n": f"right_drive:\n{keys}"})))
    assert played.run(1.0).robot.running
    drive = played.robot.drives[2]
    assert [drive.device.store.number(0x1018, part) for part in (1, 2, 3, 4)] == [0x287, 1, 5, 77]
    assert played.robot.drives[3].device.store.number(0x1018, 4) == 3
    drive.power_off()
    played.run(1.0)
    drive.objects = {**drive.objects, (0x1018, 4): 78}
    drive.power_on()
    played.run(3.0)
    assert [event.text for event in played.events if "serial number 0x1018:04" in event.text]
    played.robot.close()
