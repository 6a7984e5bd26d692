import pytest

from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.trajectory.controller import ToleranceMonitor
from canopen_control.controllers.trajectory.goal import ResultCode
from canopen_control.controllers.trajectory.joint_group import JointGroup
from canopen_control.controllers.trajectory.params import SegmentTolerances, StateTolerance

pytestmark = pytest.mark.sources  # a stand-in takes the follower's place
JOINTS = ("a", "b")
TOLERANCES = SegmentTolerances(
    (StateTolerance(0.1), StateTolerance()), (StateTolerance(0.01), StateTolerance(0.01)), 0.5
)


class Followed:
    holding, fresh = False, False


def found(*errors, over=False, past=0.0, **state):
    """Return what is judged of two joints that are off by so much."""
    group = JointGroup(JOINTS, JOINTS, ("position",), ("position",))
    group.error.positions[:] = errors
    follower = Followed()
    vars(follower).update(state)
    tolerance_monitor = ToleranceMonitor(group)
    tolerance_monitor.check(TOLERANCES, follower, over=over, time_since_end=past)
    return tolerance_monitor


def test_on_the_way_the_path_counts_and_at_the_end_the_goal():
    assert not found(0.1, 9.0).stops
    assert found(0.11, 0.0).left == 0
    assert found(0.11, 0.0, over=True).left == -1
    assert found(0.11, 0.0, over=True, fresh=True).left == 0
    assert found(0.0, 0.02, over=True).outside == 1


@pytest.mark.parametrize(("past", "late"), [(0.4, False), (0.6, True)])
def test_a_goal_that_is_missed_is_late_after_its_time(past, late):
    judged = found(0.0, -0.02, over=True, past=past)
    assert judged.late is judged.stops is late
    verdict = judged.verdict(TOLERANCES)
    if late:
        assert verdict.code is ResultCode.GOAL_TOLERANCE_VIOLATED
        assert verdict.text == "b is -0.02 off its goal 0.5 s after the end; check what blocks the joint"
    else:
        assert verdict is None


def test_a_joint_that_left_its_path_is_named_with_its_tolerance():
    verdict = found(0.2, 0.0).verdict(TOLERANCES)
    assert (verdict.state, verdict.code) == (GoalState.ABORTED, ResultCode.PATH_TOLERANCE_VIOLATED)
    assert verdict.text == "a is 0.2 off its path, with a tolerance of 0.1; check what blocks the joint"


def test_within_all_at_the_end_is_reached_and_on_the_way_nothing_is_reported():
    assert found(0.0, 0.0, over=True).verdict(TOLERANCES).state is GoalState.SUCCEEDED
    assert found(0.0, 0.0).verdict(TOLERANCES) is None


def test_what_is_held_is_not_judged():
    assert not found(9.0, 9.0, holding=True).stops
