import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import same
from support.trajectories import cases, close, differences, message

from canopen_control.controllers.trajectory.point import Arrangement, Point, shortest_angular_distance, whole_turns

#: upstream appends nothing then, and commands every joint what was meant for another one
UNKNOWN = "missing command value is NaN: nothing appended, rows not remapped"
PARTIAL = cases("jtc_partial_goal")


@pytest.mark.parametrize("case", [item for item in PARTIAL if item["name"] != UNKNOWN], ids=lambda case: case["name"])
def test_it_fills_up_and_sorts_as_upstream_does(case):
    inputs, expect = case["in"], case["expect"]
    joints, created = inputs["params"]["joints"], message(inputs["trajectory"])
    commands = [inputs.get("command", {}).get(f"{joint}/position", math.nan) for joint in joints]
    states = [inputs.get("state", {}).get(f"{joint}/position", 0.0) for joint in joints]
    arrangement = Arrangement(created.joint_names, joints, commands, states)
    assert arrangement.names == expect["joint_names_after_fill"]
    for result, expected in zip(created.points, expect["points_after_sort"], strict=True):
        arrangement.apply(result)
        assert not differences(result, expected)
        assert result.time == expected["t_ns"]


def test_a_point_takes_the_values_of_another_in_its_own_lists():
    one, other = Point([0.0], time=1), Point([1.0, 2.0], [3.0, 4.0], time=5)
    positions = one.positions
    one.assign(other)
    assert (one.positions, one.velocities, one.accelerations, one.time) == ([1.0, 2.0], [3.0, 4.0], [], 5)
    assert one.positions is positions
    other.positions[0] = 9.0
    assert one.positions == [1.0, 2.0]


ANGLES = st.floats(-1e3, 1e3)


@pytest.mark.parametrize("case", cases("shortest_angular_distance"), ids=lambda case: case["name"])
def test_the_shortest_way_is_upstreams(case):
    inputs = case["in"]
    assert same(shortest_angular_distance(inputs["from"], inputs["to"]), case["expect"]["distance"])


@pytest.mark.parametrize("case", cases("jtc_wraparound"), ids=lambda case: case["name"])
def test_the_turns_between_start_and_first_point_are_upstreams(case):
    """Upstream moves the start by them, the trajectory is shifted by them here."""
    inputs = case["in"]
    pairs = zip(inputs["current"], inputs["next"], inputs["wrap"], strict=False)
    moved = [begin - whole_turns(begin, end) if wrap else begin for begin, end, wrap in pairs]
    assert close(moved, case["expect"]["current_after"][: len(moved)])


@given(ANGLES, ANGLES)
def test_the_way_is_half_a_turn_at_most_and_ends_where_it_should(begin, end):
    way = shortest_angular_distance(begin, end)
    assert -math.pi < way <= math.pi
    assert math.cos(begin + way) == pytest.approx(math.cos(end), abs=1e-9)


@given(ANGLES, ANGLES)
def test_a_point_is_shifted_by_whole_turns_to_within_half_a_turn(begin, first):
    turns = whole_turns(begin, first)
    assert abs(first + turns - begin) <= math.pi + 1e-9
    assert turns / math.tau == pytest.approx(round(turns / math.tau), abs=1e-9)
