from __future__ import annotations

from dataclasses import dataclass

import pytest

from canopen_control.controllers.params import RENAMES, BroadcasterParams, LoopGains, Params, refuse, repeated
from canopen_control.errors import RobotConfigError
from canopen_control.yamlfile.convert import derived, setting


def test_a_value_is_read_from_the_interface_that_the_map_names():
    inputs = Params.of({"map_interface_to_joint_state": {"position": "kf_position"}}).read(BroadcasterParams)
    assert (inputs.position, inputs.velocity, inputs.effort) == ("kf_position", "velocity", "effort")


def test_the_key_of_ros_1_is_the_rate():
    assert Params.of({"publish_rate": 50}).read(BroadcasterParams, RENAMES).update_rate == 50


@pytest.mark.parametrize(
    ("inputs", "text"),
    [
        ({"i": 1.0, "antiwindup_strategy": "back_calculation"}, "give tracking_time_constant"),
        ({"p": 1.0, "i": 1.0, "d": -1.0, "antiwindup_strategy": "back_calculation"}, "give tracking_time_constant"),
        ({"p": float("nan")}, "p is nan; give a finite number"),
        ({"u_clamp_max": -1.0, "u_clamp_min": 1.0}, "give u_min < u_max"),
    ],
)
def test_gains_that_make_a_command_of_no_number_are_refused(inputs, text):
    with pytest.raises(RobotConfigError, match=text):
        Params.of(inputs).read(LoopGains)
    assert Params.of({"p": 1.0, "i": 1.0, "antiwindup_strategy": "back_calculation"}).read(LoopGains).p == 1.0


@dataclass(frozen=True)
class Axis:
    speed: float = 0.0


@dataclass(frozen=True)
class Some:
    rate: float = 1.0
    x: Axis = setting(Axis(), key="linear.x", section=True)


def test_sections_gather_dotted_names():
    assert Params.of({"linear.x.speed": 2, "rate": 3}).read(Some) == Some(3.0, Axis(2.0))
    assert Params.of({"linear": {"x": {"speed": 2}}}).read(Some) == Some(1.0, Axis(2.0))
    assert Params.of({}).read(Some) == Some()


def test_a_renamed_key_is_reported_once_and_one_without_effect_too():
    params = Params.of({"pace": 4, "colour": "red"}, "c")
    renames = {"pace": "rate", "colour": ""}
    for _ in range(2):
        assert params.read(Some, renames).rate == 4.0
    assert params.warnings == [
        "c: colour: 'colour' has no effect and can be removed",
        "c: pace: 'pace' is read as 'rate'",
    ]


def test_every_mistake_is_reported_with_the_controller():
    refuse("base", [])
    with pytest.raises(RobotConfigError, match="base: two\nbase: three"):
        refuse("base", ["two", "three"])


def test_a_repeated_name_is_a_mistake():
    assert not list(repeated("joints", ("a", "b")))
    assert list(repeated("joints", ("a", "b", "a"))) == ["joints contains a name twice: a; list each name once"]


@dataclass(frozen=True)
class Gain:
    p: float = setting(1.0)


@dataclass(frozen=True)
class OfJoints:
    gains: tuple[Gain, ...] = derived(())


def test_sections_of_each_name_are_gathered_in_the_order_of_the_names():
    inputs = Params.of({"joints": ["b", "a", "b"], "gains": {"a": {"p": 2.0}}})
    assert inputs.names("joints", "others") == ("b", "a")
    read = inputs.read_each(OfJoints, ("b", "a"), {"gains": ("gains.{}", Gain)}, {"joints": ""})
    assert [gain.p for gain in read.gains] == [1.0, 2.0]
