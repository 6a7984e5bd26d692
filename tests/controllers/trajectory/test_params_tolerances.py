import math

import pytest
from support.trajectories import cases, close, point

from canopen_control.controllers.params import Params
from canopen_control.controllers.trajectory.params import (
    GoalTolerances,
    JointTolerance,
    SegmentTolerances,
    StateTolerance,
    read_params,
    resolve,
    within,
)
from canopen_control.controllers.trajectory.point import Point

JOINTS = ("joint1", "joint2")
DEFAULT = SegmentTolerances((StateTolerance(0.1), StateTolerance(0.2)), (StateTolerance(0.01, 0.02),) * 2, 2.0)


def numbers(tolerances: SegmentTolerances):
    return {
        "path": [[each.position, each.velocity, each.acceleration] for each in tolerances.path],
        "goal": [[each.position, each.velocity, each.acceleration] for each in tolerances.goal],
        "goal_time": tolerances.goal_time,
    }


def of_goal(values) -> GoalTolerances:
    lists = {
        key: tuple(
            JointTolerance(*(each.get(name, 0.0) for name in ("position", "velocity", "acceleration")), each["name"])
            for each in values.get(f"{key}_tolerance", ())
        )
        for key in ("path", "goal")
    }
    return GoalTolerances(**lists, goal_time=values.get("goal_time_tolerance_ns", 0) / 1e9)


def agree(found, wanted) -> bool:
    lists = all(close(a, b, 1e-12) for key in ("path", "goal") for a, b in zip(found[key], wanted[key], strict=True))
    return lists and close([found["goal_time"]], [wanted["goal_time"]], 1e-12)


@pytest.mark.parametrize("case", cases("jtc_check_state_tolerance"), ids=lambda case: case["name"])
def test_errors_are_within_as_upstream_judges(case):
    given = case["in"]
    found = within(StateTolerance(*given["tolerance"]), point(given["error"]), given["joint_index"])
    assert found is case["expect"]["within"]


@pytest.mark.parametrize("case", cases("jtc_tolerance_resolution"), ids=lambda case: case["name"])
def test_tolerances_of_a_goal_are_resolved_as_upstream_does(case):
    given, expect = case["in"], case["expect"]
    params = read_params(Params.of(given["params"]), "arm")
    assert agree(numbers(params.tolerances()), expect["default"])
    found, why = resolve(of_goal(given["goal"]), params.joints, params.tolerances())
    assert agree(numbers(found), expect["active"])
    assert (why is not None) is expect["fell_back_to_default"]


def test_a_goal_that_names_a_strange_joint_is_told_whose():
    found, why = resolve(GoalTolerances(path=(JointTolerance(0.5, name="elbow"),)), JOINTS, DEFAULT)
    assert found == DEFAULT
    assert "'elbow'" in why
    assert "joint1, joint2" in why


def test_minus_one_is_no_tolerance_and_zero_the_parameters():
    given = GoalTolerances(path=(JointTolerance(-1.0, name="joint1"), JointTolerance(0.0, 0.3, name="joint2")))
    found, why = resolve(given, JOINTS, DEFAULT)
    assert why is None
    assert found.path == (StateTolerance(), StateTolerance(0.2, 0.3))


def test_what_the_parameters_do_not_know_is_off():
    default = SegmentTolerances((StateTolerance(math.nan),) * 2, (StateTolerance(),) * 2)
    found, _ = resolve(GoalTolerances(), JOINTS, default)
    assert within(found.path[0], Point([9.0], [], []), 0)
