from __future__ import annotations

import pytest
from support.bases import ACKERMANN, BICYCLE, PARAMS, TRICYCLE

from canopen_control.controllers.params import Params
from canopen_control.controllers.steering_params import AckermannParams, BicycleParams, TricycleParams, read_params
from canopen_control.errors import RobotConfigError

KINDS = {BICYCLE: BicycleParams, TRICYCLE: TricycleParams, ACKERMANN: AckermannParams}


def read(kind, **changes):
    return read_params(Params.of({**PARAMS[kind], **changes}, "base"), KINDS[kind])


@pytest.mark.parametrize("kind", list(KINDS))
def test_it_reports_all_that_is_missing_at_once(kind):
    with pytest.raises(RobotConfigError) as error:
        read_params(Params.of({}, "base"), KINDS[kind])
    text = str(error.value)
    for key in (
        "traction_joints_names has 0",
        "steering_joints_names has 0",
        "wheelbase is missing",
        "radius is missing",
    ):
        assert key in text
    assert ("traction_track_width is missing" in text) is (kind != BICYCLE)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"traction_joints_names": ["r"]}, "traction_joints_names has 1 joints; give 2, from right to left"),
        ({"traction_joints_names": ["r", "r"]}, "contains a name twice: r; list"),
        ({"traction_joints_state_names": ["r"]}, "give 2 or none"),
        ({"wheelbase": -1.0}, "out of range"),
        ({"reference_timeout": -1.0}, "out of range"),
        ({"twist_covariance_diagonal": [0.1]}, "6"),
    ],
)
def test_it_refuses_what_cannot_be(changes, text):
    with pytest.raises(RobotConfigError, match=text):
        read(TRICYCLE, **changes)


def test_states_may_be_of_other_joints():
    inputs = read(TRICYCLE, traction_joints_state_names=["mr", "ml"])
    assert (inputs.traction_states, inputs.steering_states) == (("mr", "ml"), ("s",))


def test_steered_wheels_are_as_far_apart_as_the_others_unless_that_is_given():
    assert read(ACKERMANN).tracks == (0.8, 0.8)
    assert read(ACKERMANN, steering_track_width=0.5).tracks == (0.8, 0.5)


OLD = {
    "front_wheels_names": ["f1", "f2"],
    "rear_wheels_names": ["r1", "r2"],
    "front_wheels_radius": 0.2,
    "rear_wheels_radius": 0.3,
    "front_wheel_track": 0.7,
    "rear_wheel_track": 0.9,
    "wheelbase": 1.2,
}


@pytest.mark.parametrize(
    ("front", "traction", "steering", "radius", "tracks"),
    [(True, ("r1", "r2"), ("f1", "f2"), 0.3, (0.9, 0.7)), (False, ("f1", "f2"), ("r1", "r2"), 0.2, (0.7, 0.9))],
)
def test_names_by_front_and_rear_are_those_of_what_the_wheels_do(front, traction, steering, radius, tracks):
    params = Params.of({**OLD, "front_steering": front, "use_stamped_vel": False}, "base")
    inputs = read_params(params, AckermannParams)
    assert (inputs.traction_joints_names, inputs.steering_joints_names) == (traction, steering)
    assert (inputs.radius, inputs.tracks) == (radius, tracks)
    assert any("'rear_wheels_names' is read as" in warning for warning in params.warnings)
    assert any("'use_stamped_vel' has no effect" in warning for warning in params.warnings)


def test_the_tricycle_and_the_bicycle_have_keys_of_their_own():
    old = {"front_wheels_names": ["s"], "rear_wheels_names": ["r", "l"], "wheelbase": 1.2, "wheel_track": 0.8}
    params = read_params(Params.of({**old, "rear_wheels_radius": 0.3}, "base"), TricycleParams)
    assert (params.radius, params.tracks) == (0.3, (0.8, 0.0))
    old = {"front_wheels_names": ["s"], "rear_wheels_names": ["w"], "wheelbase": 1.2, "rear_wheel_radius": 0.3}
    assert read_params(Params.of(old, "base"), BicycleParams).radius == 0.3


def test_the_newer_name_counts_where_both_are_given():
    assert read(TRICYCLE, rear_wheels_radius=9.0).radius == 0.1
