from __future__ import annotations

import pytest
from support.bases import OMNI, PARAMS

from canopen_control.controllers.base_params import OmniParams, read_checked
from canopen_control.controllers.params import Params
from canopen_control.errors import RobotConfigError


def read(**changes):
    return read_checked(Params.of({**PARAMS[OMNI], **changes}, "base"), OmniParams)


def test_covariances_have_upstreams_keys():
    inputs = read(**{"diagonal_covariance.pose": [0.1] * 6, "diagonal_covariance.twist": [0.2] * 6})
    assert (inputs.pose_covariance_diagonal, inputs.twist_covariance_diagonal) == ((0.1,) * 6, (0.2,) * 6)


def test_it_reports_all_that_is_missing_at_once():
    with pytest.raises(RobotConfigError) as error:
        read_checked(Params.of({}, "base"), OmniParams)
    assert len(str(error.value).splitlines()) == 4


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"wheel_names": ["a", "b"]}, "wheel_names has 2 joints; give 3 or more"),
        ({"wheel_names": ["a", "b", "a"]}, "contains a name twice: a"),
        ({"robot_radius": 0.0}, "robot_radius is missing or 0"),
        ({"cmd_vel_timeout": -0.1}, "out of range"),
    ],
)
def test_it_refuses_what_cannot_be(changes, text):
    with pytest.raises(RobotConfigError, match=text):
        read(**changes)
