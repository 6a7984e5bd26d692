import pytest
from support.simulated import S

from canopen_control.runtime.shared_world import read_shared
from canopen_control.simulation.random_schedule import known_faults
from canopen_control.simulation.simulation_run import SharedSimulation

pytest.importorskip("mujoco")

HALL = """robots:
  - {name: robby1, robot: robby, at: [0, 0], heading: 0}
  - {name: robby2, robot: robby, at: [1, 0], heading: 180}
"""


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    path = tmp_path_factory.mktemp("world") / "hall.yml"
    path.write_text(HALL)
    return path, [robot.setup for robot in read_shared(path)]


def simulated(hall, faults=(), seconds=3):
    world, setups = hall
    shared_simulation = SharedSimulation(setups, world, 5, seconds * S, faults)
    shared_simulation.run()
    return shared_simulation


@pytest.mark.rest
def test_each_robot_has_its_place_its_schedule_and_its_outcome(hall):
    created = simulated(hall)
    outcome = created.outcome
    places = {name: run.robot.floor.describe().base for name, run in created.runs.items()}
    created.close()
    assert {name: each.seed for name, each in outcome.robots.items()} == {"robby1": 5, "robby2": 6}
    assert outcome.breaches == ()
    assert outcome.frames == sum(item.frames for item in outcome.robots.values()) > 1000
    assert outcome.robot_s == 3.0
    assert places["robby1"].x < 0.5 < places["robby2"].x


@pytest.mark.rest
def test_the_same_seed_does_the_same_again_with_faults_too(hall):
    digests = set()
    for _ in range(2):
        created = simulated(hall, known_faults(physics=True), 5)
        digests.add(created.outcome.sha256)
        created.close()
    assert len(digests) == 1


@pytest.mark.rest
def test_a_robot_that_is_killed_leaves_the_other_alone(hall):
    world, setups = hall
    shared_simulation = SharedSimulation(setups, world, 5, 3 * S, ())
    first, second = shared_simulation.runs.values()
    shared_simulation.time.later(S, first.robot.kill)
    shared_simulation.run()
    states = first.robot.up, second.robot.running
    breaches = second.breaches
    shared_simulation.close()
    assert states == (False, True)
    assert breaches == ()
