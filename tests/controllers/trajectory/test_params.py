import math

import pytest
from support.trajectories import cases, close, point

from canopen_control.controllers.params import Params
from canopen_control.controllers.trajectory.params import (
    POINT_LIMITER,
    GoalTolerances,
    JointConstraints,
    JointGains,
    JointTolerance,
    SegmentTolerances,
    StateTolerance,
    read_params,
    resolve,
    within,
    wrong_commands,
    wrong_joints,
    wrong_states,
    wrong_together,
)
from canopen_control.controllers.trajectory.point import Point
from canopen_control.errors import ConfigError, RobotConfigError
from canopen_control.urdf.joint_element import HardLimits

JOINTS = ("joint1", "joint2")
DEFAULT = SegmentTolerances((StateTolerance(0.1), StateTolerance(0.2)), (StateTolerance(0.01, 0.02),) * 2, 2.0)


def numbers(tolerances: SegmentTolerances):
    return {
        "path": [[item.position, item.velocity, item.acceleration] for item in tolerances.path],
        "goal": [[item.position, item.velocity, item.acceleration] for item in tolerances.goal],
        "goal_time": tolerances.goal_time,
    }


def of_goal(values) -> GoalTolerances:
    lists = {
        key: tuple(
            JointTolerance(*(item.get(name, 0.0) for name in ("position", "velocity", "acceleration")), item["name"])
            for item in values.get(f"{key}_tolerance", ())
        )
        for key in ("path", "goal")
    }
    return GoalTolerances(**lists, goal_time=values.get("goal_time_tolerance_ns", 0) / 1e9)


def agree(found, wanted) -> bool:
    lists = all(close(a, b, 1e-12) for key in ("path", "goal") for a, b in zip(found[key], wanted[key], strict=True))
    return lists and close([found["goal_time"]], [wanted["goal_time"]], 1e-12)


@pytest.mark.parametrize("case", cases("jtc_check_state_tolerance"), ids=lambda case: case["name"])
def test_errors_are_within_as_upstream_judges(case):
    inputs = case["in"]
    result = within(StateTolerance(*inputs["tolerance"]), point(inputs["error"]), inputs["joint_index"])
    assert result is case["expect"]["within"]


@pytest.mark.parametrize("case", cases("jtc_tolerance_resolution"), ids=lambda case: case["name"])
def test_tolerances_of_a_goal_are_resolved_as_upstream_does(case):
    inputs, expect = case["in"], case["expect"]
    params = read_params(Params.of(inputs["params"]), "arm")
    assert agree(numbers(params.tolerances()), expect["default"])
    result, why = resolve(of_goal(inputs["goal"]), params.joints, params.tolerances())
    assert agree(numbers(result), expect["active"])
    assert (why is not None) is expect["fell_back_to_default"]


def test_a_goal_that_names_a_strange_joint_is_reported_with_whose():
    result, why = resolve(GoalTolerances(path=(JointTolerance(0.5, name="elbow"),)), JOINTS, DEFAULT)
    assert result == DEFAULT
    assert "'elbow'" in why
    assert "joint1, joint2" in why


def test_minus_one_is_not_a_tolerance_and_zero_the_parameters():
    goal_tolerances = GoalTolerances(
        path=(JointTolerance(-1.0, name="joint1"), JointTolerance(0.0, 0.3, name="joint2"))
    )
    result, why = resolve(goal_tolerances, JOINTS, DEFAULT)
    assert why is None
    assert result.path == (StateTolerance(), StateTolerance(0.2, 0.3))


def test_parameters_that_are_missing_are_off():
    default = SegmentTolerances((StateTolerance(math.nan),) * 2, (StateTolerance(),) * 2)
    result, _ = resolve(GoalTolerances(), JOINTS, default)
    assert within(result.path[0], Point([9.0], [], []), 0)


@pytest.mark.parametrize("case", cases("jtc_interface_combinations"), ids=lambda case: case["name"])
def test_upstream_s_combinations_are_taken_and_no_others(case):
    judge = {"command": wrong_commands, "state": wrong_states}[case["in"]["kind"]]
    assert (judge(case["in"]["interfaces"]) is None) is case["expect"]["accept"]


@pytest.mark.parametrize("commands", [["velocity"], ["effort"], ["position", "effort"], ["effort", "position"]])
def test_a_loop_needs_position_and_velocity(commands):
    assert "[position, velocity]" in wrong_together(commands, ["position"])
    assert wrong_together(commands, ["position", "velocity"]) is None


def test_joints_of_another_hardware_are_as_many_and_fewer_are_some_of_them():
    assert wrong_joints(["a", "b"], ["x", "y"]) is None
    assert wrong_joints(["a", "b"], ["b"]) is None
    assert "x" in wrong_joints(["a", "b"], ["x"])
    assert "more" in wrong_joints(["a"], ["a", "b"])


@pytest.mark.parametrize(
    ("inputs", "word"), [([], "empty"), (["position", "position"], "twice"), (["torque"], "torque")]
)
def test_a_list_that_is_none_is_reported(inputs, word):
    assert word in wrong_commands(inputs)
    assert word in wrong_states(inputs)


MIN = {"joints": ["a", "b"], "command_interfaces": ["position"], "state_interfaces": ["position", "velocity"]}


def read(**more):
    return read_params(Params.of({**MIN, **more}), "arm")


def test_gains_and_constraints_are_those_of_each_joint():
    result = read(
        gains={"b": {"p": 2, "i_clamp": 3.0}},
        constraints={"goal_time": 1.5, "a": {"trajectory": 0.1}, "b": {"goal": 0.2, "max_deceleration_on_cancel": 4}},
        **{"speed_scaling.state_interface": "robot/speed"},
    )
    assert result.gains[1].p == 2.0
    assert (result.gains[1].pid().i_min, result.gains[1].pid().i_max) == (-3.0, 3.0)
    assert result.constraints == (JointConstraints(0.1), JointConstraints(0.0, 0.2, 4.0))
    assert (result.goal_time, result.scaling_state) == (1.5, "robot/speed")
    tolerances = result.tolerances()
    assert [item.position for item in tolerances.path] == [0.1, 0.0]
    assert [(item.position, item.velocity) for item in tolerances.goal] == [(0.0, 0.01), (0.2, 0.01)]


def test_a_finite_clamp_of_one_side_wins_over_the_deprecated_one():
    gains = JointGains(i_clamp=3.0, i_clamp_max=1.0).pid()
    assert (gains.i_min, gains.i_max) == (-3.0, 1.0)


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"joints": []}, "no 'joints'"),
        ({"joints": ["a", "a"]}, "joints contains a name twice"),
        ({"command_joints": ["a", "a"]}, "command_joints contains a name twice"),
        ({"command_joints": ["c"]}, "command_joints: c"),
        ({"command_interfaces": []}, "command_interfaces is empty"),
        ({"command_interfaces": ["velocity", "acceleration"]}, "add position"),
        ({"state_interfaces": ["velocity"]}, "add position"),
        ({"command_interfaces": ["velocity"], "state_interfaces": ["position"]}, "position and velocity"),
        ({"interpolation_method": "spline"}, "not one of splines, none"),
        ({"action_monitor_rate": 0.0}, "out of range"),
        ({"constraints.goal_time": -1.0}, "out of range"),
        ({"constraints.a.max_deceleration_on_cancel": -1.0}, "out of range"),
        ({"speed_scaling.initial_scaling_factor": -0.1}, "out of range"),
        ({"gains.a.antiwindup_strategy": "some"}, "is not one of"),
        ({"gains.a.u_clamp_max": -1.0, "gains.a.u_clamp_min": 1.0}, "u_min < u_max"),
        ({"joints": "a"}, "expected a list"),
    ],
)
def test_what_cannot_be_is_refused(wrong, text):
    with pytest.raises(RobotConfigError, match=text):
        read(**wrong)


def test_all_that_cannot_be_is_reported_at_once_and_where_it_stands():
    with pytest.raises(RobotConfigError) as error:
        read(joints=["a", "a"], command_interfaces=["torque"], state_interfaces=["velocity"])
    lines = str(error.value).splitlines()
    assert {line.split(": ")[1] for line in lines[:3]} == {"joints", "command_interfaces", "state_interfaces"}
    assert lines[3] == "3 errors"


@pytest.mark.parametrize("key", ["constraints.c.goal", "gains.c.p", "constraints.goal_tim", "joint"])
def test_unread_entries_are_reported(key):
    params = Params.of({**MIN, key: 1.0})
    read_params(params, "arm")
    assert any(f": {key}: " in text for text in params.warnings)


def test_limits_of_the_point_limiter_are_those_given_else_of_the_description():
    result = read(
        joint_limiter_type=POINT_LIMITER,
        joint_limits={
            "a": {
                "has_velocity_limits": True,
                "max_velocity": 0.5,
                "has_acceleration_limits": True,
                "max_acceleration": 2,
            },
            "b": {"has_position_limits": False, "max_deceleration": 3.0},
        },
    )
    a, b = (limit.hard(-1.0, 1.0, 4.0) for limit in result.joint_limits)
    assert a == HardLimits(-1.0, 1.0, 0.5, max_acceleration=2.0)
    assert b == HardLimits(max_velocity=4.0, max_deceleration=3.0)
    assert read().joint_limiter_type == ""


def test_an_unknown_limiter_is_refused_with_those_there_are():
    with pytest.raises(ConfigError, match=POINT_LIMITER):
        read(joint_limiter_type="joint_limits/Magic")


def test_sections_of_a_joint_that_is_not_listed_are_one_warning_for_each_joint():
    strange = {"constraints": {"d": {"goal": 1.0, "trajectory": 1.0}}, "gains": {"d": {"p": 1.0}}}
    params = Params.of({**MIN, **strange})
    read_params(params, "arm")
    assert [text.partition(": no effect")[2][:24] for text in params.warnings] == [", since 'd' is not one o"] * 2
    without = Params.of({**MIN, **strange, "joints": []})
    with pytest.raises(RobotConfigError, match="no 'joints'"):
        read_params(without, "arm")
    assert without.warnings == []


POINTS = {"joint_limiter_type": "joint_limits/JointTrajectoryPointSaturationLimiter"}
LOOPS = {"command_interfaces": ["velocity"]}


@pytest.mark.parametrize(
    ("more", "texts"),
    [
        (POINTS | {"joint_limits": {"a": {"max_velocity": 0.0}}}, ["joint_limits.a.max_velocity is 0, so a does not"]),
        (POINTS | {"joint_limits": {"b": {"max_acceleration": 0.0}}}, ["joint_limits.b.max_acceleration is 0, so b"]),
        (POINTS | {"joint_limits": {"a": {"has_velocity_limits": False, "max_velocity": 0.0}}}, []),
        (POINTS | {"joint_limits": {"a": {"min_position": 0.0, "max_position": 0.0}}}, ["joint_limits.a.max_position"]),
        ({"joint_limits": {"a": {"max_velocity": 0.0}}}, []),  # no limiter uses it
        ({"speed_scaling.initial_scaling_factor": 0.0}, ["speed_scaling.initial_scaling_factor is 0, so trajectories"]),
        (LOOPS | {"gains": {"a": {"p": 1.0}}}, ["gains.b.p, i, d and ff_velocity_scale are 0, so b does not move"]),
        (LOOPS | {"gains": {"a": {"ff_velocity_scale": 1.0}, "b": {"i": 1.0}}}, []),
        (LOOPS | {"open_loop_control": True}, []),
        ({}, []),
    ],
)
def test_parameters_of_zero_with_which_a_joint_does_not_move(more, texts):
    reported = list(read(**more).immobile())
    assert len(reported) == len(texts)
    assert all(text in item for item, text in zip(reported, texts, strict=True)), reported


def test_a_deceleration_limit_of_zero_is_refused():
    limits = {"joint_limits": {"a": {"max_deceleration": 0.0}}}
    with pytest.raises(
        RobotConfigError, match=r"joint_limits\.a\.max_deceleration is 0, so a moving joint would never"
    ):
        read(**POINTS, **limits)
    assert read(**limits).joint_limits[0].max_deceleration == 0.0
