from __future__ import annotations

import math

import pytest
from support.bases import MECANUM, PARAMS
from support.control import vectors

from canopen_control.controllers.base_params import MecanumParams, TwistAxisLimits, read_checked, read_params, tf_prefix
from canopen_control.controllers.limiters import RateLaw, VelocityLimits
from canopen_control.controllers.params import Params
from canopen_control.errors import RobotConfigError


def test_limits_are_those_of_the_limiter():
    limits = TwistAxisLimits(max_velocity=1.0, max_deceleration=-2.0).limits()
    assert (limits.max_velocity, limits.max_deceleration) == (1.0, -2.0)
    assert math.isnan(limits.max_jerk)
    assert TwistAxisLimits(max_jerk=0.0).freezes
    assert not TwistAxisLimits().freezes


# -- diff drive params


WHEELS = {"left_wheel_names": ["l"], "right_wheel_names": ["r"], "wheel_separation": 0.24, "wheel_radius": 0.035}
LIFECYCLE = vectors("diff_drive_lifecycle")[:7]
DIALECTS = {case["name"]: case for case in vectors("config_dialects")}
OLD = "humble: limits given but has_* absent are NOT applied"


@pytest.mark.parametrize("case", LIFECYCLE, ids=lambda case: case["name"])
def test_it_refuses_what_upstream_refuses(case):
    with pytest.raises(RobotConfigError):
        read_params(Params.of(case["params"]))


def test_a_jerk_limit_of_0_freezes_its_axis_unless_it_is_switched_off():
    frozen = {"linear.x.max_jerk": 0.0, "angular.z.max_jerk": 0.0, "angular.z.has_jerk_limits": False}
    assert read_params(Params.of({**WHEELS, **frozen})).frozen == ("linear.x",)
    assert read_params(Params.of(WHEELS)).frozen == ()


def effective(limits: VelocityLimits) -> dict[str, float]:
    """What the limiter makes of limits: equal dictionaries limit equally."""
    limiter = RateLaw(limits)
    return {
        name: value
        for name, value in vars(limiter).items()
        if not (name.endswith(("_v",)) and not limiter._has_v)
        and not (name.startswith(("_acc", "_dec")) and not limiter._has_a)
        and not (name.endswith("_j") and not limiter._has_j)
    }


@pytest.mark.sources
@pytest.mark.parametrize(
    "name", [name for name, case in DIALECTS.items() if "canonical_linear" in case and name != OLD]
)
def test_the_limits_of_every_dialect_are_those_of_jazzy(name):
    case = DIALECTS[name]
    params = read_params(Params.of({**WHEELS, **case["input"]}))
    for axis in ("linear", "angular"):
        if f"canonical_{axis}" in case:
            assert effective(getattr(params, axis).limits()) == effective(VelocityLimits(**case[f"canonical_{axis}"]))


def test_a_declared_limit_is_applied_in_every_dialect():
    params = read_params(Params.of({**WHEELS, **DIALECTS[OLD]["input"]}))  # humble would ignore it without has_*
    assert params.linear.limits().max_velocity == 1.0


def test_lists_and_single_wheels_of_ros_1_are_taken_and_its_multiplier_overrides():
    case = DIALECTS["ros1 skid steer lists"]
    wheels = {"wheel_separation": 0.5, "wheel_radius": 0.1}
    params = Params.of({**wheels, **case["input"]})
    inputs = read_params(params)
    canonical = case["canonical"]
    assert list(inputs.left) == canonical["left_wheel_names"]
    assert list(inputs.right) == canonical["right_wheel_names"]
    assert inputs.left_wheel_radius_multiplier == canonical["left_wheel_radius_multiplier"]
    assert inputs.right_wheel_radius_multiplier == canonical["right_wheel_radius_multiplier"]
    assert read_params(Params.of({**wheels, "left_wheel": "a", "right_wheel": "b"})).left == ("a",)
    assert any("'left_wheel' is read as 'left_wheel_names'" in warning for warning in params.warnings)


def test_an_integer_is_taken_for_a_double_where_upstream_rejects_it():
    assert read_params(Params.of({**WHEELS, "publish_rate": 50})).publish_rate == 50.0


def test_every_error_is_reported_at_once():
    with pytest.raises(RobotConfigError) as caught:
        read_params(
            Params.of({"publish_rate": "fast", "linear.x.max_velocity": -1.0, "pose_covariance_diagonal": [1.0]})
        )
    text = str(caught.value)
    assert "publish_rate: expected a number, got the text 'fast'" in text
    assert "linear.x.max_velocity: -1.0 is out of range 0.0.." in text
    assert "pose_covariance_diagonal: expected a list of 6 values, got a list of 1" in text
    with pytest.raises(RobotConfigError) as caught:
        read_params(Params.of({"left_wheel_names": ["a", "b"], "right_wheel_names": ["a"]}))
    assert "2 left wheels and 1 right wheels" in str(caught.value)
    assert "a is a wheel of both sides" in str(caught.value)
    assert "wheel_separation is missing or 0" in str(caught.value)


def test_min_acceleration_is_the_reverse_acceleration_unless_that_is_given_too():
    params = read_params(Params.of({**WHEELS, "linear.x.max_acceleration": 1.0, "linear.x.min_acceleration": -2.0}))
    assert params.linear.max_acceleration_reverse == -2.0
    both = {"linear.x.min_acceleration": -2.0, "linear.x.max_acceleration_reverse": -3.0}
    assert read_params(Params.of({**WHEELS, **both})).linear.max_acceleration_reverse == -3.0
    assert math.isnan(read_params(Params.of(WHEELS)).linear.max_acceleration_reverse)


@pytest.mark.parametrize("case", vectors("tf_prefix"))
def test_the_frame_prefix_is_upstreams(case):
    result = tf_prefix(case["prefix"], case["ns"], enable=case.get("enable", True))
    if case["distro"] == "jazzy" and case["prefix"] == "~":
        assert result == "x/"  # jazzy gives the useless frame name "~/odom"; this package follows rolling
    elif case["distro"] == "rolling" and not case["prefix"]:
        assert result == "ns/"  # rolling's function gives "", and its caller then takes the namespace
    else:
        assert result == case["expect"]


class Urdf:
    def separation(self, left, right):
        return 0.5 if (tuple(left), tuple(right)) == (("l",), ("r",)) else None

    def radius(self, wheels):
        return 0.1 if tuple(wheels) == ("l", "r") else None


def test_wheel_sizes_that_are_not_given_are_those_of_the_description():
    reports: list[str] = []
    params = read_params(Params.of({"left_wheel": "l", "right_wheel": "r"}), Urdf(), reports.append)
    assert (params.wheel_separation, params.wheel_radius) == (0.5, 0.1)
    assert reports == [
        "wheel_separation is not given; the value of the description is used: 0.5 m",
        "wheel_radius is not given; the value of the description is used: 0.1 m",
    ]
    assert read_params(Params.of(WHEELS), Urdf(), reports.append).wheel_separation == 0.24
    assert len(reports) == 2
    with pytest.raises(RobotConfigError, match="wheel_radius is missing or 0"):
        read_params(Params.of({"left_wheel": "a", "right_wheel": "b"}), Urdf())


# -- mecanum


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


def test_a_misspelt_section_is_reported_with_the_key_that_is_meant():
    params = Params.of({**WHEELS, "lineer": {"x": {"max_velocity": 1.0}}})
    read_params(params)
    assert any(
        "unknown key 'lineer.x.max_velocity' (did you mean 'linear.x.max_velocity'?)" in text
        for text in params.warnings
    )
