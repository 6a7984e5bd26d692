import math

import pytest

from canopen_control.controllers.params import Params, read_pid_params
from canopen_control.controllers.pid import AntiWindup
from canopen_control.errors import RobotConfigError

GIVEN = {
    "dof_names": ["a", "b"],
    "command_interface": "effort",
    "reference_and_state_interfaces": ["position", "velocity"],
    "gains": {"b": {"p": 3.0, "i": 1.0, "i_clamp_max": 2.0, "antiwindup_strategy": "none", "feedforward_gain": 0.5}},
}


def read(**changes):
    return read_pid_params(Params.of({**GIVEN, **changes}), "pid")


def test_gains_are_those_of_each_degree_of_freedom():
    a, b = read().gains
    assert (a.p, a.pid().anti_windup, a.save_i_term, a.error_deadband) == (0.0, AntiWindup.LEGACY, True, 1e-16)
    assert (b.p, b.i, b.feedforward_gain, b.pid().i_max, b.pid().i_min) == (3.0, 1.0, 0.5, 2.0, -math.inf)
    assert b.pid().anti_windup is AntiWindup.NONE


def test_references_and_states_may_have_other_names():
    assert read().measured == ("a", "b")
    assert read(reference_and_state_dof_names=["x", "y"]).measured == ("x", "y")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"dof_names": []}, "no 'dof_names'"),
        ({"dof_names": ["a", "a"]}, "contains a name twice"),
        ({"reference_and_state_dof_names": ["x"]}, "1 for 2 dof_names"),
        ({"command_interface": ""}, "no 'command_interface'"),
        ({"reference_and_state_interfaces": []}, "give one, or two as in"),
        ({"reference_and_state_interfaces": ["position", "velocity", "effort"]}, "has 3"),
        ({"reference_and_state_interfaces": ["position", "position"]}, "contains an interface twice"),
        ({"gains": {"a": {"u_clamp_max": -1.0, "u_clamp_min": 1.0}}}, "u_min < u_max"),
        ({"gains": {"a": {"antiwindup_strategy": "some"}}}, "antiwindup_strategy"),
    ],
)
def test_what_cannot_be_is_refused_with_the_key(changes, text):
    with pytest.raises(RobotConfigError, match=text):
        read(**changes)


def test_gains_of_a_stranger_are_reported():
    params = Params.of({**GIVEN, "gains.c.p": 1.0}, "pid")
    read_pid_params(params, "pid")
    assert any("gains.c.p" in warning for warning in params.warnings)


def test_all_mistakes_are_reported_at_once_each_on_a_line():
    wrong = {"dof_names": [], "command_interface": "", "reference_and_state_interfaces": []}
    with pytest.raises(RobotConfigError) as refused:
        read(**wrong)
    assert [line.partition(";")[0] for line in str(refused.value).splitlines()] == [
        "pid: no 'dof_names'",
        "pid: no 'command_interface'",
        "pid: reference_and_state_interfaces has 0",
    ]
