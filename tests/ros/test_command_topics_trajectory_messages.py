from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.host.lineclient import MAX_REQUEST, MAX_VALUES
from canopen_control.ros.command_topics import goal_refusal, is_one_piece, pieces_of, point_of, stamp_of, tolerances_of
from canopen_control.ros.sample_topics import TRAJECTORY_FEEDBACK, fill
from canopen_control.rpc.messages.samples import TrajectorySample
from canopen_control.rpc.messages.trajectory import MAX_POINTS, TrajectoryData
from canopen_control.rpc.wire import request_line


def duration(sec=0, nanosec=0):
    return SimpleNamespace(sec=sec, nanosec=nanosec)


def ros_point(positions=(), velocities=(), accelerations=(), effort=(), time=None):
    return SimpleNamespace(
        positions=positions,
        velocities=velocities,
        accelerations=accelerations,
        effort=effort,
        time_from_start=time or duration(),
    )


def trajectory(points, names=("a", "b"), stamp=None):
    header = SimpleNamespace(stamp=stamp or duration())
    return SimpleNamespace(header=header, joint_names=list(names), points=points)


def goal(**parts):
    whole = {"multi_dof_trajectory": SimpleNamespace(points=[]), "component_path_tolerance": [],
             "component_goal_tolerance": []}  # fmt: skip
    return SimpleNamespace(**{**whole, **parts})


def test_a_stamp_of_zero_is_at_once():
    assert stamp_of(trajectory([])) is None
    assert stamp_of(trajectory([], stamp=duration(12, 500_000_000))) == 12.5


class Messages:
    floats = staticmethod(list)


@given(st.floats(-1e6, 1e6), st.lists(st.floats(allow_nan=False), max_size=3))
def test_a_point_goes_there_and_back(time, values):
    whole = math.floor(time)
    given_time = duration(whole, min(int((time - whole) * 1e9), 999_999_999))
    point = point_of(ros_point(positions=tuple(values), effort=tuple(values), time=given_time))
    sample = TrajectorySample(time=1.0, joints=(), executing=False, holding=False, reference=point, feedback=point,
                              error=point, output=point)  # fmt: skip
    feedback = SimpleNamespace(joint_names=[], desired=ros_point(), actual=ros_point(), error=ros_point())
    fill(Messages(), feedback, TRAJECTORY_FEEDBACK, sample)
    back = feedback.actual
    assert (back.positions, back.velocities, back.effort) == (values, [], values)
    there = back.time_from_start
    assert 0 <= there.nanosec < 1_000_000_000
    assert abs((there.sec - given_time.sec) * 1_000_000_000 + there.nanosec - given_time.nanosec) < 1000


def test_500_points_of_six_joints_go_in_pieces_that_fit_into_requests():
    values = [-1.2345678901234567e-05] * 6
    points = [ros_point(values, values, values, time=duration(index)) for index in range(500)]
    pieces = list(pieces_of(trajectory(points)))
    assert not is_one_piece(trajectory(points))
    assert [item.time_from_start for piece in pieces for item in piece] == list(range(500))
    for piece in pieces:
        assert len(request_line(1, "trajectory_data", TrajectoryData(points=piece))) <= MAX_REQUEST
        assert sum(19 for _ in piece) + len(piece) < MAX_VALUES
    assert len(pieces) < 15


def test_a_trajectory_without_points_is_a_piece_without_any():
    assert list(pieces_of(trajectory([]))) == [[]]
    assert is_one_piece(trajectory([]))


@pytest.mark.parametrize(
    ("point", "sentence"),
    [
        (ros_point([0.0, math.nan]), "point 1: the position of b is nan; give finite numbers"),
        (ros_point([0.0, 0.0], [math.inf, 0.0]), "point 1: the velocity of a is inf; give finite numbers"),
        (ros_point(effort=[0.0, 0.0, -math.inf]), "point 1: the effort of value 2 is -inf; give finite numbers"),
    ],
)
def test_what_is_not_a_number_is_named_with_its_joint(point, sentence):
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        list(pieces_of(trajectory([ros_point([0.0, 0.0]), point])))


def test_too_many_points_are_reported_before_anything_is_made_of_them():
    points = [ros_point([0.0, 0.0])] * 100_000
    with pytest.raises(ValueError, match=f"the trajectory has 100000 points, and the limit is {MAX_POINTS}"):
        next(pieces_of(trajectory(points)))


def test_tolerances_are_those_of_the_goal_and_nan_is_the_parameters():
    (reported,) = tolerances_of([SimpleNamespace(name="a", position=0.1, velocity=-1.0, acceleration=math.nan)])
    assert (reported.joint, reported.position, reported.velocity, reported.acceleration) == ("a", 0.1, -1.0, 0.0)


@pytest.mark.parametrize(
    ("parts", "what"),
    [
        ({"multi_dof_trajectory": SimpleNamespace(points=[1])}, "multi_dof_trajectory"),
        ({"component_path_tolerance": [1]}, "component_path_tolerance"),
        ({"component_goal_tolerance": [1]}, "component_goal_tolerance"),
    ],
)
def test_an_interface_without_a_follower_is_refused_and_not_omitted(parts, what):
    assert goal_refusal(goal()) is None
    assert goal_refusal(goal(**parts)) == f"{what} is not supported (joints have one degree of freedom); leave it empty"
