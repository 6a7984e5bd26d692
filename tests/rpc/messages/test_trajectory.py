import msgspec
import pytest

from canopen_control.rpc.messages.robot import ROBOT
from canopen_control.rpc.messages.trajectory import (
    FollowTrajectory,
    ScaleTrajectory,
    SendTrajectory,
    SetTrajectory,
    TrajectoryVerdict,
)
from canopen_control.rpc.wire import convert

TRAJECTORY = {"controller": "arm", "joints": ["a"], "points": [{"positions": [1.0], "time_from_start": 1.0}]}


def names(kind):
    return {field.name for field in msgspec.structs.fields(kind)}


def test_a_goal_that_is_accepted_at_once_reports_all_that_one_that_is_followed_reports():
    assert names(SendTrajectory) == names(FollowTrajectory)
    assert ROBOT.of(SendTrajectory).answer is TrajectoryVerdict


def test_a_trajectory_that_is_not_a_goal_has_no_tolerances():
    assert not any("tolerance" in name for name in names(SetTrajectory))
    with pytest.raises(ValueError, match="unknown field"):
        convert({**TRAJECTORY, "goal_time_tolerance": 1.0}, SetTrajectory)


def test_it_ends_with_its_connection_by_default():
    for kind in (SetTrajectory, SendTrajectory, FollowTrajectory):
        assert convert(TRAJECTORY, kind).dead_man is True
        assert convert({**TRAJECTORY, "dead_man": False}, kind).dead_man is False


def test_time_does_not_run_backwards():
    with pytest.raises(ValueError, match=r"at `\$\.factor`"):
        convert({"controller": "arm", "factor": -0.5}, ScaleTrajectory)
