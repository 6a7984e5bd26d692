from __future__ import annotations

import pytest
from support.bases import MECANUM, PARAMS

from canopen_control.controllers.base_params import MecanumParams, read_checked
from canopen_control.controllers.params import Params
from canopen_control.errors import RobotConfigError


def read(**changes):
    return read_checked(Params.of({**PARAMS[MECANUM], **changes}, "base"), MecanumParams)


def test_keys_are_dotted_as_upstreams():
    inputs = read(
        **{
            "kinematics.base_frame_offset.x": 0.1,
            "kinematics.base_frame_offset.y": 0.2,
            "kinematics.base_frame_offset.theta": 0.3,
            "linear.y.max_velocity": 0.7,
            "rear_left_wheel_state_joint_name": "encoder",
        }
    )
    assert inputs.offset == (0.1, 0.2, 0.3)
    assert inputs.linear_y.limits().max_velocity == 0.7
    assert inputs.measured[3] == "encoder"


def test_it_reports_all_that_is_missing_at_once():
    with pytest.raises(RobotConfigError) as error:
        read_checked(Params.of({}, "base"), MecanumParams)
    lines = str(error.value).splitlines()
    assert len(lines) == 6
    assert all(line.startswith("base: ") for line in lines)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"rear_left_wheel_command_joint_name": "front_left"}, "front_left is the joint of several wheels"),
        ({"kinematics.wheels_radius": -1.0}, "out of range"),
        ({"linear.x.min_velocity": 1.0}, "out of range"),
        ({"angular.z.max_jerk": -1.0}, "out of range"),
    ],
)
def test_it_refuses_what_cannot_be(changes, text):
    with pytest.raises(RobotConfigError, match=text):
        read(**changes)
