import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.controllers.trajectory.follower import Stop
from canopen_control.controllers.trajectory.point import Point

S = 1_000_000_000
JOINTS = st.lists(st.tuples(st.floats(-3.0, 3.0), st.floats(-2.0, 2.0), st.floats(0.1, 10.0)), min_size=1, max_size=3)


def stop(joints) -> Stop:
    positions, velocities, decelerations = zip(*joints, strict=True)
    made = Stop(decelerations)
    made.set_before(5 * S, Point(positions, velocities), [False] * len(joints))
    return made


def course(made: Stop, ms: int) -> list[Point]:
    points = []
    for index in range(ms):
        points.append(Point())
        assert made.sample(5 * S + index * S // 1000, points[-1])
    return points


def test_a_joint_comes_to_rest_with_its_deceleration():
    made = stop([(1.0, 2.0, 4.0), (0.0, -1.0, 4.0)])
    begin, middle, end = (course(made, 701)[index] for index in (0, 250, 700))
    assert (begin.positions, begin.velocities, begin.accelerations) == ([1.0, 0.0], [2.0, -1.0], [-4.0, 4.0])
    assert middle.positions == pytest.approx([1.375, -0.125])
    assert middle.velocities == [1.0, 0.0]
    assert (end.positions, end.velocities, end.accelerations) == ([1.5, -0.125], [0.0, 0.0], [0.0, 0.0])
    assert (made.is_over, made.time_of(0), end.time) == (True, S // 2, 700 * S // 1000)


def test_at_rest_it_holds():
    made = stop([(1.0, 0.0, 4.0)])
    assert {each.positions[0] for each in course(made, 10)} == {1.0}


@given(JOINTS)
def test_no_joint_jumps_turns_back_or_goes_faster_than_before(joints):
    points = course(stop(joints), 200)
    for index, (position, velocity, _) in enumerate(joints):
        assert points[0].positions[index] == pytest.approx(position, abs=1e-9)
        way = [each.positions[index] for each in points]
        for a, b in itertools.pairwise(way):
            assert abs(b - a) <= abs(velocity) / 1000 + 1e-9
            assert (b - a) * velocity >= -1e-9


def test_a_joint_whose_speed_nobody_knows_stays_where_it_is():
    assert course(stop([(1.0, math.nan, 4.0), (0.0, 1.0, 4.0)]), 500)[-1].positions == pytest.approx([1.0, 0.125])
