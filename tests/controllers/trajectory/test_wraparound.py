import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import same
from support.trajectories import cases, close

from canopen_control.controllers.trajectory.wraparound import shortest_angular_distance, wrap_around

ANGLES = st.floats(-1e3, 1e3)


@pytest.mark.parametrize("case", cases("shortest_angular_distance"), ids=lambda case: case["name"])
def test_the_shortest_way_is_upstreams(case):
    given = case["in"]
    assert same(shortest_angular_distance(given["from"], given["to"]), case["expect"]["distance"])


@pytest.mark.parametrize("case", cases("jtc_wraparound"), ids=lambda case: case["name"])
def test_the_start_moves_by_whole_turns_as_upstreams_does(case):
    current = list(case["in"]["current"])
    wrap_around(current, case["in"]["next"], case["in"]["wrap"])
    assert close(current, case["expect"]["current_after"])


@given(ANGLES, ANGLES)
def test_the_way_is_half_a_turn_at_most_and_ends_where_it_should(begin, end):
    way = shortest_angular_distance(begin, end)
    assert -math.pi < way <= math.pi
    assert math.cos(begin + way) == pytest.approx(math.cos(end), abs=1e-9)


@given(ANGLES, ANGLES)
def test_a_joint_without_end_starts_within_half_a_turn_on_the_turn_of_the_first_point(begin, first):
    current = [begin, begin]
    wrap_around(current, [first, first], [True, False])
    assert abs(current[0] - first) <= math.pi + 1e-9
    turns = (current[0] - begin) / (2 * math.pi)
    assert turns == pytest.approx(round(turns), abs=1e-6)
    assert current[1] == begin
