import pytest
from support.generic import write_generic
from support.simulated import S, setup_of

from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.random_schedule import draw_schedule
from canopen_control.simulation.simulation_run import SimulationRun


def test_a_base_takes_twists_and_wheels_take_speeds():
    forward, base = motions_of(setup_of())
    assert (forward.controller, forward.kind, forward.starts) == ("robby_forward_controller", "command", True)
    assert forward.ranges == ((-8.0, 8.0),) * 2
    assert (base.controller, base.kind, base.starts) == ("robby_base_controller", "command", False)
    assert len(base.ranges) == 2


def test_an_arm_takes_positions_and_trajectories_within_its_joints():
    positions, trajectories = motions_of(setup_of("arm6"))
    assert (positions.kind, trajectories.kind) == ("command", "trajectory")
    assert len(positions.ranges) == len(trajectories.ranges) == 6
    limits = [joint.limits for joint in setup_of("arm6").description.joints.values() if not joint.fixed]
    for (low, high), limit in zip(positions.ranges, limits, strict=True):
        assert limit.lower <= low < high <= limit.upper


@pytest.mark.parametrize("name", ["forklift", "mecanum", "diffbot_sim", "mobile_base_ros1"])
def test_every_bundled_robot_can_be_commanded(name):
    assert any(item.starts for item in motions_of(setup_of(name)))


@pytest.mark.parametrize("name", ["forklift", "mecanum", "mobile_base_ros1"])
def test_a_bundled_robot_follows_what_is_drawn_without_a_breach(name):
    """The wheels of the last one are behind transmissions."""
    setup = setup_of(name)
    nodes = [node.node_id for bus in setup.joined.values() for node in bus.nodes.values()]
    run = SimulationRun(setup, 2, draw_schedule(2, 3 * S, motions_of(setup), nodes, ()))
    run.run(3 * S)
    assert run.outcome.breaches == ()
    assert any(joint.states["velocity"].value for joint in run.robot.core.joints.values())
    run.close()


def test_a_velocity_limit_of_zero_is_unknown_and_not_a_standstill(tmp_path):
    """Exporters write 0 for an unknown limit; commands are not limited by it."""
    setup = read_robot(find_robot(str(write_generic(tmp_path, velocity=0))))
    (velocities,) = [item.ranges for item in motions_of(setup) if item.controller == "velocity"]
    assert velocities == ((-8.0, 8.0),) * 2
