import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.trajectories import cases, close, point

from canopen_control.controllers.trajectory.point import Point
from canopen_control.controllers.trajectory.upsampling import fill_velocities, time_points

S = 1_000_000_000


@pytest.mark.parametrize("case", cases("jtc_upsampling_master"), ids=lambda case: case["name"])
def test_the_velocities_are_upstreams(case):
    points = [point(each) for each in case["in"]["points"]]
    before = [list(each.velocities) for each in points]
    assert fill_velocities(points) is case["expect"]["filled"]
    wanted = case["expect"]["velocities"] if case["expect"]["filled"] else before
    assert all(close(each.velocities, want) for each, want in zip(points, wanted, strict=True))


def test_points_of_a_policy_get_its_times_and_others_keep_theirs():
    points = [Point([0.0]), Point([1.0]), Point([2.0])]
    time_points(points, 0.0)
    assert [each.time for each in points] == [0, 0, 0]
    time_points(points, 10.0)
    assert [each.time for each in points] == [S // 10, S // 5, 3 * S // 10]
    time_points(points, 5.0)
    assert points[0].time == S // 10


@given(st.lists(st.tuples(st.floats(-3.0, 3.0), st.integers(S // 100, S)), min_size=3, max_size=20))
def test_accelerations_are_continuous_at_the_inner_points(steps):
    time, points = 0, list[Point]()
    for position, step in steps:
        time += step
        points.append(Point([position], time=time))
    assert fill_velocities(points)
    for a, b, c in zip(points, points[1:], points[2:], strict=False):
        h, k = (b.time - a.time) / S, (c.time - b.time) / S
        (p0,), (p1,), (p2,) = a.positions, b.positions, c.positions
        (v0,), (v1,), (v2,) = a.velocities, b.velocities, c.velocities
        before = (6 * (p0 - p1) + (2 * v0 + 4 * v1) * h) / h**2
        after = (6 * (p2 - p1) - (4 * v1 + 2 * v2) * k) / k**2
        assert before == pytest.approx(after, rel=1e-6, abs=1e-3)
