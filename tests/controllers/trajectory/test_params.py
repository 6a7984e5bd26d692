import pytest

from canopen_control.controllers.params import Params
from canopen_control.controllers.pid import AntiWindup
from canopen_control.controllers.trajectory.params import POINT_LIMITER, JointConstraints, JointGains, read_params
from canopen_control.errors import ConfigError, RobotConfigError
from canopen_control.urdf.joint_element import HardLimits

LEAST = {"joints": ["a", "b"], "command_interfaces": ["position"], "state_interfaces": ["position", "velocity"]}


def read(**more):
    return read_params(Params.of({**LEAST, **more}), "arm")


def test_the_defaults_are_upstreams():
    found = read()
    assert found.commanded == ("a", "b")
    assert (found.initial_scaling_factor, found.action_monitor_rate, found.interpolation_method) == (
        1.0,
        20.0,
        "splines",
    )
    assert (found.stopped_velocity_tolerance, found.goal_time, found.cmd_timeout) == (0.01, 0.0, 0.0)
    off = (found.allow_partial_joints_goal, found.open_loop_control, found.decelerate_on_cancel)
    assert off == (False, False, False)
    assert found.set_last_command_interface_value_as_state_on_activation
    assert found.gains == (JointGains(),) * 2
    assert found.constraints == (JointConstraints(),) * 2
    assert found.gains[0].pid().anti_windup is AntiWindup.LEGACY


def test_gains_and_constraints_are_those_of_each_joint():
    found = read(
        gains={"b": {"p": 2, "i_clamp": 3.0}},
        constraints={"goal_time": 1.5, "a": {"trajectory": 0.1}, "b": {"goal": 0.2, "max_deceleration_on_cancel": 4}},
        **{"speed_scaling.state_interface": "robot/speed"},
    )
    assert found.gains[1].p == 2.0
    assert (found.gains[1].pid().i_min, found.gains[1].pid().i_max) == (-3.0, 3.0)
    assert found.constraints == (JointConstraints(0.1), JointConstraints(0.0, 0.2, 4.0))
    assert (found.goal_time, found.scaling_state) == (1.5, "robot/speed")
    tolerances = found.tolerances()
    assert [each.position for each in tolerances.path] == [0.1, 0.0]
    assert [(each.position, each.velocity) for each in tolerances.goal] == [(0.0, 0.01), (0.2, 0.01)]


def test_a_finite_clamp_of_one_side_wins_over_the_deprecated_one():
    gains = JointGains(i_clamp=3.0, i_clamp_max=1.0).pid()
    assert (gains.i_min, gains.i_max) == (-3.0, 1.0)


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"joints": []}, "no 'joints'"),
        ({"joints": ["a", "a"]}, "joints names one twice"),
        ({"command_joints": ["a", "a"]}, "command_joints names one twice"),
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


def test_all_that_cannot_be_is_told_at_once_and_where_it_stands():
    with pytest.raises(RobotConfigError) as error:
        read(joints=["a", "a"], command_interfaces=["torque"], state_interfaces=["velocity"])
    lines = str(error.value).splitlines()
    assert {line.split(": ")[1] for line in lines[:3]} == {"joints", "command_interfaces", "state_interfaces"}
    assert lines[3] == "3 errors"


@pytest.mark.parametrize("key", ["constraints.c.goal", "gains.c.p", "constraints.goal_tim", "joint"])
def test_what_nobody_reads_is_told(key):
    params = Params.of({**LEAST, key: 1.0})
    read_params(params, "arm")
    assert any(repr(key) in text for text in params.warnings)


def test_limits_of_the_point_limiter_are_those_given_else_of_the_description():
    found = read(
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
    a, b = (each.hard(-1.0, 1.0, 4.0) for each in found.joint_limits)
    assert a == HardLimits(-1.0, 1.0, 0.5, max_acceleration=2.0)
    assert b == HardLimits(max_velocity=4.0, max_deceleration=3.0)
    assert read().joint_limiter_type == ""


def test_an_unknown_limiter_is_refused_with_those_there_are():
    with pytest.raises(ConfigError, match=POINT_LIMITER):
        read(joint_limiter_type="joint_limits/Magic")
