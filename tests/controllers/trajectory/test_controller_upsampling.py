import itertools
import math
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.trajectories import cases, close, point

from canopen_control.controllers.trajectory.controller import PolicyTimes, UpsampledPoints, positions_alone, upsampled
from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.controllers.trajectory.validation import PointBuffer
from canopen_control.rpc.messages.samples import TrajectoryPoint

S = 1_000_000_000


def made(points, frequency=0.0):
    width = len(points[0].positions) if points else 0
    return upsampled(JointTrajectory([str(number) for number in range(width)], points), frequency)


@pytest.mark.parametrize("case", cases("jtc_upsampling_master"), ids=lambda case: case["name"])
def test_the_velocities_are_upstreams(case):
    points = [point(item) for item in case["in"]["points"]]
    result = made(points)
    if not case["expect"]["filled"]:
        assert result is None or not any(item.velocities for item in result)
        return
    assert result is not None
    assert all(close(each.velocities, want) for each, want in zip(result, case["expect"]["velocities"], strict=True))


def test_points_of_a_policy_get_its_times_and_others_keep_theirs():
    points = [Point([0.0]), Point([1.0]), Point([2.0])]
    assert made(points) is None  # their times do not increase
    result = made(points, 10.0)
    assert [item.time for item in result] == list(result.times) == [S // 10, S // 5, 3 * S // 10]
    timed = [Point([0.0], time=S), Point([1.0], time=3 * S)]
    assert [item.time for item in made(timed, 10.0)] == [S, 3 * S]


def test_what_reports_more_than_positions_is_left_as_it_is():
    assert not positions_alone(JointTrajectory("a", [Point([0.0], time=1), Point([1.0], [0.0], time=2)]))
    assert positions_alone(JointTrajectory("a", [Point([0.0], time=1), Point([1.0], time=2)]))
    assert made([Point([0.0, 1.0], time=1), Point([1.0], time=2)]) is None
    assert made([Point(time=1), Point(time=2)]) is None
    assert made([]) is None


def test_the_times_of_a_policy_are_those_of_a_list():
    times = PolicyTimes(4, 8.0)
    assert (len(times), times[-1], times[0]) == (4, S // 2, S // 8)
    with pytest.raises(IndexError):
        times[4]


def smooth(points):
    """Assert that the accelerations to and from each inner point are the same."""
    for a, b, c in zip(points, points[1:], points[2:], strict=False):
        h, k = (b.time - a.time) / S, (c.time - b.time) / S
        (p0,), (p1,), (p2,) = a.positions, b.positions, c.positions
        (v0,), (v1,), (v2,) = a.velocities, b.velocities, c.velocities
        before = (6 * (p0 - p1) + (2 * v0 + 4 * v1) * h) / h**2
        after = (6 * (p2 - p1) - (4 * v1 + 2 * v2) * k) / k**2
        assert before == pytest.approx(after, rel=1e-6, abs=1e-3)


steps = st.tuples(st.floats(-3.0, 3.0), st.integers(S // 100, S))


@given(st.lists(steps, min_size=3, max_size=20), st.integers(1, 12))
def test_accelerations_are_continuous_at_the_inner_points_across_blocks_too(steps, times):
    time, points = 0, list[Point]()
    for position, step in steps * times:
        time += step
        points.append(Point([position], time=time))
    result = list(made(points))
    assert result[0].velocities == result[-1].velocities == [0.0]
    smooth(result)


def packed(count):
    points = PointBuffer()
    points.add(
        [TrajectoryPoint(positions=[math.sin(i / 9.0)] * 6, time_from_start=0.01 * (i + 1)) for i in range(count)]
    )
    return JointTrajectory("abcdef", points)


def test_of_a_long_one_nothing_is_worked_out_before_the_joints_come_there():
    """What the acceptance calls does not grow with the points, nor does a step along them."""
    calls = []

    def count_calls(message):
        before = 0
        sys.setprofile(lambda frame, event, argument: calls.append(event))
        try:
            result = upsampled(message, 0.0)
            before = len(calls)
            result[500]
        finally:
            sys.setprofile(None)
        counts = before, len(calls) - before
        calls.clear()
        return counts

    short, long = (count_calls(packed(count)) for count in (1000, 20_000))
    assert long == pytest.approx(short, rel=0.05)
    assert long[0] < 50


def test_two_blocks_are_kept():
    result = made([Point([float(i)], time=i * S) for i in range(100)])
    assert isinstance(result, UpsampledPoints)
    assert [result[i].velocities for i in (15, 16, 99, -1)] == [
        item.velocities for item in itertools.chain(list(result)[15:17], [result[99], result[99]])
    ]
    assert len(result._blocks) == 2
