import math

import pytest
from support.trajectories import cases, message

from canopen_control.controllers.params import Params
from canopen_control.controllers.trajectory.params import read_params
from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.controllers.trajectory.validation import (
    JointLimits,
    Rules,
    beyond,
    broken_rule,
    far_start,
    lost_start,
    survey_of,
    unreachable,
)

S = 1_000_000_000
LIMITS = {"a": JointLimits(-1.0, 1.0, 2.0), "b": JointLimits(continuous=True)}


@pytest.mark.parametrize("case", cases("jtc_validate_trajectory"), ids=lambda case: case["name"])
def test_the_first_rule_that_is_broken_is_upstreams(case):
    given = case["in"]
    params = read_params(Params.of(given["params"]), "arm")
    rules = Rules(
        params.joints,
        params.allow_partial_joints_goal,
        params.allow_nonzero_velocity_at_trajectory_end,
        params.allow_integration_in_goal_trajectories,
        "effort" in params.command_interfaces,
    )
    made = message(given["trajectory"])
    refused = broken_rule(made, survey_of(made), rules, given["now_ns"])
    assert (refused is None) is case["expect"]["accept"]
    if refused is not None:
        assert refused.rule.name == case["expect"]["reason"]
        assert ";" in refused.text or "did you mean" in refused.text or "there" in refused.text, refused.text


def to(*positions: float, time: float = 1.0, **more: list[float]) -> JointTrajectory:
    return JointTrajectory(["a", "b"][: len(positions)], [Point(positions, time=round(time * S), **more)])


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (to(math.nan, 0.0), "point 0: the position of a is nan; give finite numbers"),
        (to(0.0, math.inf), "point 0: the position of b is inf"),
        (to(0.0, 0.0, velocities=[0.0, math.nan]), "the velocity of b is nan"),
        (to(0.0, 0.0, accelerations=[math.nan, 0.0]), "the acceleration of a is nan"),
        (to(0.0, 0.0, effort=[math.nan]), "the effort of a is nan"),
        (to(1.1, 0.0), "point 0: a at 1.1 is beyond its limits of -1 to 1"),
        (to(0.0, 0.0, velocities=[-2.1, 0.0]), "point 0: a with a velocity of -2.1 is beyond its limit of 2"),
        (JointTrajectory(["a", "a"], [Point([0.0, 0.0])]), "names a twice"),
    ],
)
def test_what_no_joint_can_bear_is_named_with_its_joint(given, text):
    assert text in beyond(given, survey_of(given), LIMITS)


def through(*points):
    """Return a trajectory through (time, a, b)."""
    return JointTrajectory(["a", "b"], [Point([a, b], time=round(time * S)) for time, a, b in points])


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (through((0.0, -0.9, 0.0), (1.0, 0.9, 0.0), (2.0, 0.9, 40.0)), None),
        (through((0.0, -0.9, 0.0), (0.895, 0.9, 0.0)), None),  # 2.01 rad/s: times are written with few digits
        (
            through((0.0, 0.0, 0.0), (0.5, 0.9, 0.0), (1.0, 0.9, 0.0), (1.5, -0.9, 0.0)),
            "point 3: a would have to go -1.8 in 0.5 s, faster than its limit of 2; give it 0.9 s, or set unreachable",
        ),
    ],
)
def test_a_point_that_cannot_be_reached_in_time_is_named_with_the_time_it_needs(given, told):
    found = unreachable(given, survey_of(given), LIMITS)
    assert (found is None) is (told is None)
    assert told is None or told in found


def test_a_joint_that_may_not_move_reaches_nothing_and_points_without_positions_say_nothing_of_the_way():
    given = through((0.0, 0.0, 0.0), (0.001, 1.0, 0.0))
    found = unreachable(given, survey_of(given), {"a": JointLimits(velocity=0.0)})
    assert "faster than its limit of 0; leave it where it is, or set unreachable_points" in found
    mixed = JointTrajectory(["a"], [Point([0.0]), Point(velocities=[0.0], time=1), Point([1.0], time=2)])
    assert unreachable(mixed, survey_of(mixed), LIMITS) is None


def test_limits_bear_the_rounding_of_a_planner_and_turns_without_end():
    given = to(1.0 + 1e-7, 100.0)
    assert beyond(given, survey_of(given), LIMITS) is None


@pytest.mark.parametrize(
    ("position", "time", "far"),
    [(0.05, 0.0, False), (0.2, 0.0, True), (0.9, 0.5, False), (0.9, 0.3, True)],
)
def test_a_start_is_far_that_the_joint_cannot_reach_by_then(position, time, far):
    text = far_start(to(position, time=time), {"a": 0.0}, LIMITS, 0.1)
    assert (text is not None) is far
    if text is not None:
        assert f"begins with a at {position:g}" in text
        assert "allowed_start_tolerance" in text


def test_a_start_is_judged_by_the_short_way_round_and_not_at_all_with_a_tolerance_of_zero():
    here = {"a": 0.0, "b": math.pi - 0.01}
    assert far_start(to(0.0, 0.01 - math.pi, time=0.0), here, LIMITS, 0.1) is None
    assert far_start(to(0.0, 1.0, time=0.0), here, LIMITS, 0.1) is not None
    assert far_start(to(0.0, 1.0, time=0.0), here, LIMITS, 0.0) is None


@pytest.mark.parametrize(
    ("point", "stamp", "lost"),
    [
        (Point([0.0], time=0), 0, False),
        (Point(velocities=[1.0], time=S), 0, False),
        (Point(velocities=[1.0], time=0), 0, True),
        (Point(velocities=[1.0], time=S), 5 * S, True),
        (Point(velocities=[1.0], time=S), 9 * S + 1, False),
    ],
)
def test_nothing_leads_to_a_first_point_of_velocities_that_is_past(point, stamp, lost):
    text = lost_start(JointTrajectory(["a"], [point], stamp), 10 * S)
    assert (text is not None) is lost
    assert text is None or "give it positions" in text


@pytest.mark.parametrize(("now", "word"), [(12 * S, "1 s ago"), (100_000 * S, "1 days (by another clock?) ago")])
def test_how_long_ago_it_ended_is_said(now, word):
    given = JointTrajectory(["a"], [Point([0.0], time=S)], 10 * S)
    assert word in broken_rule(given, survey_of(given), Rules(("a",)), now).text
