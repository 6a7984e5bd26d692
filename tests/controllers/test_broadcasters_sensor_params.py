from __future__ import annotations

import pytest

from canopen_control.controllers.broadcasters import AXES, ForceTorqueParams, ImuParams, PoseParams, RangeParams
from canopen_control.controllers.params import Params, refuse
from canopen_control.errors import RobotConfigError

SENSOR = {"sensor_name": "s", "frame_id": "link"}
NAMED = {"frame_id": "link", "interface_names": {"force": {"z": "scale/load"}}}


def read(cls, **params):
    inputs = Params.of(params).read(cls)
    refuse("b", inputs.mistakes())
    return inputs


def test_the_six_names_of_a_sensor_and_those_that_are_named_one_by_one():
    assert read(ForceTorqueParams, **SENSOR).names == [f"s/{axis}" for axis in AXES]
    assert read(ForceTorqueParams, **NAMED).names == ["", "", "scale/load", "", "", ""]


@pytest.mark.parametrize(
    ("cls", "params", "words"),
    [
        (ImuParams, {"frame_id": "link"}, "b: no 'sensor_name'; give it"),
        (RangeParams, {"sensor_name": "s"}, "b: no 'frame_id'; give it"),
        (ImuParams, {**SENSOR, "static_covariance_orientation": [0.0] * 8}, "static_covariance_orientation has 8 numb"),
        (RangeParams, {**SENSOR, "radiation_type": 2}, "radiation_type"),
        (RangeParams, {**SENSOR, "field_of_view": -0.1}, "field_of_view"),
        (ForceTorqueParams, {"frame_id": "l"}, "neither 'sensor_name' nor interface_names"),
        (ForceTorqueParams, {**SENSOR, **NAMED}, "both 'sensor_name' and interface_names"),
        (ForceTorqueParams, {**SENSOR, "offset": {"force": {"w": 1.0}}}, "offset.force.w (did you mean 'force."),
        (PoseParams, {"frame_id": "map"}, "neither 'pose_name' nor interface_names"),
        (PoseParams, {"pose_name": "gps"}, "no 'frame_id'; give it"),
        (
            PoseParams,
            {"frame_id": "map", "pose_name": "p", "interface_names": {"position": {"x": "a/x"}}},
            "both 'pose",
        ),
        (PoseParams, {"frame_id": "map", "interface_names": {"position": {"x": "a/x"}}}, "position.y is missing"),
        (PoseParams, {"frame_id": "map", "interface_names": {"position": {"w": "a/x"}}}, "position.w (did you mean"),
        (ForceTorqueParams, {**SENSOR, "multiplier": {"force": {"x": float("inf")}}}, "multiplier.force.x is inf"),
    ],
)
def test_what_cannot_be_is_reported_with_its_name(cls, params, words):
    with pytest.raises(RobotConfigError) as caught:
        read(cls, **params)
    assert words in str(caught.value)
