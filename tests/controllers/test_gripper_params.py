from __future__ import annotations

import pytest

from canopen_control.controllers.gripper import EffortGripperParams, GripperParams, read_params
from canopen_control.controllers.params import Params
from canopen_control.errors import RobotConfigError


def read(cls=GripperParams, **params):
    return read_params(Params.of({"joint": "finger", **params}), "gripper", cls)


def test_the_gains_of_the_joint_stand_below_its_name():
    inputs = read(EffortGripperParams, gains={"finger": {"p": 20.0, "d": 0.5, "i_clamp_max": 3.0, "i_clamp_min": -3.0}})
    assert (inputs.gains.p, inputs.gains.i, inputs.gains.d) == (20.0, 0.0, 0.5)
    assert (inputs.gains.i_clamp_max, inputs.gains.i_clamp_min) == (3.0, -3.0)
    assert read(EffortGripperParams).gains.p == 0.0


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"joint": ""}, "no 'joint'; give it under"),
        ({"state_interfaces": ["position"]}, "state_interfaces lacks velocity"),
        ({"state_interfaces": ["position", "velocity", "position"]}, "contain an interface twice"),
        ({"max_effort_interface": "f/x", "max_velocity_interface": "f/x"}, "contain an interface twice"),
        ({"max_effort": -1.0}, "max_effort"),
        ({"goal_tolerance": -0.1}, "goal_tolerance"),
        ({"action_monitor_rate": 0.05}, "action_monitor_rate"),
    ],
)
def test_what_cannot_be_is_reported(params, words):
    with pytest.raises(RobotConfigError, match=words):
        read(**params)


def test_all_mistakes_are_reported_at_once_each_on_a_line():
    with pytest.raises(RobotConfigError) as refused:
        read(joint="", state_interfaces=["position"])
    assert len(str(refused.value).splitlines()) == 2
