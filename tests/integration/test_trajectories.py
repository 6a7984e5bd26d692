"""arm6 follows trajectories as MoveIt plans them: six virtual drives, the bus and the runtime, in simulated time."""

import math

import pytest
from support.arm6 import ENDS, JOINTS, copy_arm, copy_looped_arm, planned
from support.robots import Bench

from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.trajectory.goal import ResultCode, TrajectoryGoal
from canopen_control.errors import ControlError
from canopen_control.hardware.axis_statechart import Action

MS = 1_000_000


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    """arm6 with a trajectory controller in the place of the one that takes positions."""
    return copy_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture
def arm(config):
    bench = Bench("trajectories", config=config, drives=(2, 3, 4, 5, 6, 7))
    bench.start()
    bench.until(lambda: all(joint.enabled for joint in bench.robot.joints.values()))
    bench.run(100)
    yield bench
    bench.close()


def controller(arm):
    return arm.robot.manager.get("arm_controller")


def positions(arm):
    return [arm.robot.registry.state(f"{joint}/position").value for joint in JOINTS]


def send(arm, end, **how):
    goal = TrajectoryGoal(planned(positions(arm), end, **how))
    controller(arm).send_goal(goal, arm.reactor.now())
    return goal


def fault_of_joint_3(arm):
    drive = arm.drives[4]
    drive.drives[0].fault(0x4310, arm.reactor.now())
    arm.hosts[4].wake(drive)


def holds_after_an_enable_and_follows_again(arm, within):
    """Reset the fault, enable, and see that no joint moves by more than `within` rad before the next goal."""
    answers = []
    arm.robot.axis(Action.FAULT_RESET, "all", answers.append)
    arm.until(lambda: answers)
    arm.robot.axis(Action.ENABLE, "all", answers.append)
    arm.until(lambda: len(answers) == 2, 10000)
    assert answers == [None, None]
    where = positions(arm)
    arm.run(1000)
    assert positions(arm) == pytest.approx(where, abs=within)
    again = send(arm, ENDS)
    arm.until(lambda: again.ended, 5000)
    assert again.state is GoalState.SUCCEEDED


def lag(begin, end, seconds=2.0):
    """How far each joint may be behind at its peak speed, 15/8 of the mean of a minimum-jerk profile: one SYNC.

    A set-point is on the bus a period before it is due; the drive moves to it between two SYNCs, and what it tells of
    itself at one is read in the cycle after.
    """
    return [1.875 * abs(b - a) / seconds * 0.02 for a, b in zip(begin, end, strict=True)]


@pytest.mark.parametrize("count", [50, 500])
def test_it_follows_a_planned_trajectory_within_its_tolerances(arm, count):
    begin = positions(arm)
    goal = send(arm, ENDS, count=count)
    worst = [0.0] * 6
    start = arm.reactor.now()
    expected = planned(begin, ENDS).points
    while not goal.ended:
        arm.run(20)
        assert arm.reactor.now() - start < 4000 * MS
        worst = [max(each, abs(error)) for each, error in zip(worst, controller(arm).error.positions, strict=True)]
    assert (goal.state, goal.code) == (GoalState.SUCCEEDED, ResultCode.SUCCESSFUL)
    assert worst == pytest.approx(lag(begin, ENDS), rel=0.02)
    assert 1900 * MS < arm.reactor.now() - start < 2200 * MS
    arm.run(500)
    assert positions(arm) == pytest.approx(ENDS, abs=1e-3)
    assert expected[-1].positions == ENDS


@pytest.mark.parametrize("factor", [0.1, 0.5])
def test_its_speed_can_be_scaled(arm, factor):
    controller(arm).set_speed_scaling(factor)
    start, goal = arm.reactor.now(), send(arm, ENDS, seconds=1.5)
    arm.until(lambda: goal.ended, 20000)
    assert goal.state is GoalState.SUCCEEDED
    assert (arm.reactor.now() - start) / 1e9 == pytest.approx(1.5 / factor, rel=0.05)


def test_another_goal_on_the_way_is_followed_without_a_jump(arm):
    first = send(arm, ENDS)
    arm.run(1000)
    second = send(arm, [0.0] * 6)
    assert (first.state, first.code) == (GoalState.ABORTED, ResultCode.INVALID_GOAL)
    before = positions(arm)
    while not second.ended:
        arm.run(20)
        now = positions(arm)
        assert max(abs(a - b) for a, b in zip(now, before, strict=True)) < 2.1 * 0.02
        before = now
    assert second.state is GoalState.SUCCEEDED
    arm.run(500)
    assert positions(arm) == pytest.approx([0.0] * 6, abs=1e-3)


def test_a_drive_that_faults_ends_the_goal_with_its_joint_and_a_new_enable_moves_nothing(arm):
    goal = send(arm, ENDS)
    arm.run(1000)
    fault_of_joint_3(arm)
    arm.until(lambda: goal.ended, 500)
    assert (goal.state, goal.code) == (GoalState.ABORTED, ResultCode.INVALID_GOAL)
    assert goal.text.startswith("joint_3 (joint_3_drive): in fault; canopen-control axis fault-reset all, then ")
    assert any(goal.text in text for text in arm.texts("goal_aborted"))
    with pytest.raises(ControlError, match="joint_3_drive"):
        send(arm, ENDS)
    arm.run(2000)
    holds_after_an_enable_and_follows_again(arm, 1e-3)


def test_a_drive_that_is_lost_ends_the_goal_with_its_joint(arm):
    goal = send(arm, ENDS)
    arm.run(1000)
    arm.power_off(6)
    arm.until(lambda: goal.ended, 2000)
    assert goal.text.startswith("joint_5 (joint_5_drive): lost; ")


def test_a_stop_ends_the_goal_and_everything_rests(arm):
    goal = send(arm, ENDS)
    arm.run(1000)
    answers = []
    arm.robot.stop(answers.append, by="the operator")
    assert goal.ended
    assert goal.text.startswith("stop was commanded by the operator, so the command of ")
    arm.until(lambda: answers)
    where = positions(arm)
    arm.run(1000)
    assert positions(arm) == pytest.approx(where, abs=1e-3)


def test_a_cancelled_goal_brakes(arm):
    goal = send(arm, ENDS)
    arm.run(1000)
    controller(arm).cancel(goal)
    arm.run(1500)
    where = positions(arm)
    assert not any(math.isclose(a, b, abs_tol=0.01) for a, b in zip(where, ENDS, strict=True))
    arm.run(500)
    assert positions(arm) == pytest.approx(where, abs=1e-4)


def test_what_it_reports_is_its_sample(arm):
    send(arm, ENDS)
    arm.run(1000)
    reported = arm.robot.manager.running.samples(0)["arm_controller"]
    assert reported.joints == tuple(JOINTS)
    assert reported.executing
    assert not reported.holding
    assert reported.reference.time_from_start == pytest.approx(1.0, abs=0.05)
    assert reported.error.positions == pytest.approx([0.0] * 6, abs=1.02 * max(lag([0.0] * 6, ENDS)))


GAINS = {
    "velocity": {"p": 6.0, "feedforward_gain": 1.0},
    "effort": {"p": 200.0, "i": 50.0, "d": 2.0, "feedforward_gain": 26.0},  # per mille of the rated torque
}


@pytest.fixture(params=GAINS)
def looped(tmp_path, request):
    """arm6 whose drives take velocities or torques, by PIDs under a trajectory controller."""
    config = copy_looped_arm(tmp_path, request.param, **GAINS[request.param])
    controllers = ["loops", "arm_controller"]
    bench = Bench("loops", config=config, drives=(2, 3, 4, 5, 6, 7), controllers=controllers)
    for drive in bench.drives.values():
        drive.drives[0].mover.plant.rated_velocity = 4e7  # 38 rad/s at rated torque
    bench.start()
    bench.until(lambda: all(joint.enabled for joint in bench.robot.joints.values()))
    bench.run(100)
    yield bench
    bench.close()


def test_joints_that_take_velocities_or_efforts_follow_by_loops_below_the_trajectory(looped):
    goal, worst = send(looped, ENDS), 0.0
    while not goal.ended:
        looped.run(20)
        worst = max([worst, *map(abs, controller(looped).error.positions)])
    assert (goal.state, goal.code) == (GoalState.SUCCEEDED, ResultCode.SUCCESSFUL)
    assert worst < 1.5 * max(lag([0.0] * 6, ENDS))  # the loops add half a period to what positions have
    looped.run(1000)
    assert positions(looped) == pytest.approx(ENDS, abs=2e-3)
    reported = looped.robot.manager.running.samples(0)["loops"]
    assert [dof.reference for dof in reported.dofs] == pytest.approx(ENDS)
    looped.robot.manager.get("loops").set_feed_forward(False)
    assert max(abs(dof.error) for dof in reported.dofs) < 2e-3


def test_a_fault_below_the_loops_ends_the_goal_and_an_enable_holds_the_joints_where_they_are(looped):
    goal = send(looped, ENDS)
    looped.run(1000)
    fault_of_joint_3(looped)
    looped.until(lambda: goal.ended, 500)
    assert (goal.state, goal.code) == (GoalState.ABORTED, ResultCode.INVALID_GOAL)
    assert goal.text.startswith("joint_3 (joint_3_drive): in fault; ")
    looped.run(2000)
    holds_after_an_enable_and_follows_again(looped, 2e-3)
