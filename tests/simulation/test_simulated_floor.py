import dataclasses

import pytest
from support.simulated import FORWARD, MS, S, setup_of

from canopen_control.rpc.messages.drive import BlockJoint, PushRobot
from canopen_control.simulation.simulation_run import SimulationRun
from canopen_control.virtual.scenario import ScenarioEvent

pytest.importorskip("mujoco")
DRIVE = ScenarioEvent(1 * S, "command", FORWARD, values=(5.0, 5.0), for_ns=2 * S)


def simulated(*acts, seconds=3.0, name="robby"):
    run = SimulationRun(dataclasses.replace(setup_of(name), physics=True), 4, acts, motions=())
    run.run(round(seconds * S))
    return run


def pose(run):
    return run.robot.floor.describe().base


@pytest.mark.rest
def test_the_wheels_move_the_robot_over_the_floor_and_the_same_seed_does_it_again():
    ends = []
    for _ in range(2):
        run = simulated(DRIVE)
        ends.append((pose(run), run.outcome.sha256))
        run.close()
    assert ends[0] == ends[1]
    assert ends[0][0].x == pytest.approx(0.35, abs=0.05)
    assert abs(ends[0][0].y) < 0.02


def test_a_drive_without_supply_releases_its_wheel_and_returns():
    run = simulated(DRIVE, ScenarioEvent(1500 * MS, "power", "2", for_ns=500 * MS), seconds=1.6)
    assert run.robot.drives[2].device is None
    moved = pose(run).x
    run.robot.run_for(1 * S)
    assert run.robot.drives[2].device is not None
    assert run.robot.errors == []
    assert pose(run).x > moved - 0.01
    run.close()


def test_what_the_floor_turns_is_not_a_motion_of_a_drive():
    run = simulated(seconds=0.5, name="forklift")  # it settles before its drives are enabled
    assert run.breaches == ()
    assert any(note.startswith("the robot stands on wheels") for note in run.robot.floor.notes)
    run.close()


@pytest.mark.rest
@pytest.mark.parametrize("twist", [(0.3, 0.15), (0.5, 0.3), (-0.3, 0.2)])
def test_wheels_that_strain_against_each_other_relax(twist):
    """A forklift that begins to turn while its steered wheel is still on the way strains its two driven wheels."""
    command = ScenarioEvent(1 * S, "command", "forklift_base_controller", values=twist, for_ns=5 * S)
    run = simulated(command, seconds=5.5, name="forklift")
    axes = [node.device.drives[0] for node in run.robot.drives.values()]
    heading = pose(run).heading
    states = {axis.state.name for axis in axes}
    torques = [abs(axis.mover.plant.torque) for axis in axes]
    run.close()
    assert states == {"OPERATION_ENABLED"}
    assert max(torques) < 500.0  # of 1000, and falling
    assert heading == pytest.approx(twist[1] * 4.4, abs=0.15)


@pytest.mark.rest
def test_what_happens_in_the_world_happens_to_the_robot_and_is_undone_in_time():
    pushed = ScenarioEvent(1 * S, "world", world=PushRobot(force=(0.0, 400.0, 0.0), seconds=0.5))
    run = simulated(pushed, seconds=2.0)
    assert pose(run).y > 0.05
    run.close()
    blocked = ScenarioEvent(1500 * MS, "world", for_ns=300 * MS, world=BlockJoint(joint="left_wheel_joint"))
    run = simulated(DRIVE, blocked, seconds=1.7)
    shaft = run.robot.drives[3].device.drives[0].mover.plant
    assert (shaft.stalled, abs(shaft.velocity)) == (True, pytest.approx(0.0, abs=10.0))
    run.robot.run_for(300 * MS)
    assert not shaft.stalled
    run.close()
