"""Statistics of set-points from the drives of an arm that follows a trajectory, in simulated time."""

import pytest
from support.arm6 import ENDS, JOINTS, copy_arm, planned
from support.robots import Bench

from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.trajectory.goal import TrajectoryGoal

DRIVES = (2, 3, 4, 5, 6, 7)


def followed(folder, change=lambda text: text, fault=None):
    """Let an arm follow a trajectory; return what each drive tells of its set-points."""
    config = copy_arm(folder)
    bus = config / "bus.yml"
    bus.write_text(change(bus.read_text()))
    arm = Bench("setpoints", config=config, drives=DRIVES)
    try:
        arm.start()
        arm.until(lambda: all(joint.enabled for joint in arm.robot.joints.values()))
        arm.run(100)
        for drive in arm.drives.values():
            drive.drives[0].meter.restart()
            if fault is not None:
                drive.fault_switches.set(fault, True, arm.reactor.now())
        begin = [arm.robot.registry.state(f"{item}/position").value for item in JOINTS]
        goal = TrajectoryGoal(planned(begin, ENDS))
        arm.robot.manager.get("arm_controller").send_goal(goal, arm.reactor.now())
        arm.until(lambda: goal.ended, 5000)
        assert goal.state is GoalState.SUCCEEDED
        return [arm.drives[node].drives[0].describe().set_points for node in DRIVES]
    finally:
        arm.close()


@pytest.fixture(scope="module")
def quiet(tmp_path_factory):
    return followed(tmp_path_factory.mktemp("quiet"))


def test_of_a_robot_in_time_no_set_point_is_missed_or_doubled(quiet):
    for reported in quiet:
        assert reported.taken >= 100  # two seconds of 20 ms
        assert (reported.missed, reported.doubled, reported.overwritten) == (0, 0, 0)
        assert reported.phase_us.min == pytest.approx(reported.phase_us.max)
        assert reported.acceleration_ripple < 0.05


def test_an_interpolation_time_that_was_left_at_a_tenth_grinds(quiet, tmp_path):
    ground = followed(tmp_path, lambda text: text.replace("sub_index: 1, value: 20}", "sub_index: 1, value: 2}"))
    for reported, healthy in zip(ground, quiet, strict=True):
        assert reported.acceleration > 20 * healthy.acceleration
        assert reported.velocity_ripple > 2.9
        assert (reported.missed, reported.doubled) == (0, 0)


def test_lost_rpdos_are_missed_set_points(quiet, tmp_path):
    lossy = followed(tmp_path, fault="rpdo_lost")
    assert sum(reported.missed for reported in lossy) > 0
    worst = max(reported.acceleration / healthy.acceleration for reported, healthy in zip(lossy, quiet, strict=True))
    assert worst > 1.1
