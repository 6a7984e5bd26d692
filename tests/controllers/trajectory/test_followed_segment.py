import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.trajectories import cases, differences, point

from canopen_control.controllers.trajectory.followed import Segment
from canopen_control.controllers.trajectory.point import Point

S = 1_000_000_000
VALUES = st.floats(-10.0, 10.0)


def between(a: Point, b: Point, t: float, duration: float = 1.0) -> Point:
    segment, out = Segment(), Point()
    segment.fit(0, a, round(duration * S), b)
    segment.evaluate(round(t * S), out)
    return out


def goes_to_zero(given) -> bool:
    """Accelerations in both points and velocities not: upstream commands zeros, wherever the joint is."""
    a, b = given["a"], given["b"]
    has_v = a.get("velocities") and b.get("velocities")
    within = given["ta_ns"] <= given["t_ns"] <= given["tb_ns"]
    return bool(a.get("accelerations") and b.get("accelerations") and not has_v and within)


@pytest.mark.parametrize("case", cases("jtc_interpolate_between_points"), ids=lambda case: case["name"])
def test_it_interpolates_as_upstream_does(case):
    given, segment, out = case["in"], Segment(), Point()
    segment.fit(given["ta_ns"], point(given["a"]), given["tb_ns"], point(given["b"]))
    segment.evaluate(given["t_ns"], out)
    wrong = differences(out, case["expect"])
    assert set(wrong) <= {"positions", "velocities"} if goes_to_zero(given) else not wrong, wrong


def test_accelerations_without_velocities_are_a_line_and_not_a_jump_to_zero():
    half = between(Point([1.0], accelerations=[0.5]), Point([2.0], accelerations=[0.5]), 0.5)
    assert (half.positions, half.velocities) == ([1.5], [1.0])


@given(st.lists(VALUES, min_size=6, max_size=6), st.floats(0.01, 10.0))
def test_a_quintic_begins_and_ends_as_its_points_say(values, duration):
    p0, v0, a0, p1, v1, a1 = values
    a, b = Point([p0], [v0], [a0]), Point([p1], [v1], [a1])
    for t, wanted in ((0.0, (p0, v0, a0)), (duration, (p1, v1, a1))):
        found = between(a, b, t, round(duration * S) / S)
        for values_found, value in zip((found.positions, found.velocities), wanted[:2], strict=True):
            assert values_found[0] == pytest.approx(value, rel=1e-6, abs=1e-4)


def test_beyond_its_ends_it_stands():
    a, b = Point([1.0], [3.0]), Point([2.0], [3.0])
    assert between(a, b, -1.0).positions == [1.0]
    assert between(a, b, 2.0).positions == [2.0]


def test_points_in_the_wrong_order_are_joined_as_upstream_joins_them():
    segment, out = Segment(), Point()
    segment.fit(2 * S, Point([1.0], [3.0]), S, Point([2.0], [3.0]))
    segment.evaluate(S, out)
    assert out.positions == [2.0]


def test_nothing_is_said_of_joints_whose_position_is_not_known():
    assert between(Point(velocities=[1.0], accelerations=[1.0]), Point([], [1.0], [1.0]), 0.5).positions == []
