from __future__ import annotations

from dataclasses import dataclass

import pytest

from canopen_control.controllers.params import CommonParams, Params
from canopen_control.errors import RobotConfigError
from canopen_control.yamlfile.convert import setting


@dataclass(frozen=True)
class Axis:
    speed: float = 0.0


@dataclass(frozen=True)
class Some:
    rate: float = 1.0
    x: Axis = setting(Axis(), key="linear.x", section=True)  # noqa: RUF009 - it is a field


def test_sections_gather_dotted_names():
    assert Params.of({"linear.x.speed": 2, "rate": 3}).read(Some) == Some(3.0, Axis(2.0))
    assert Params.of({"linear": {"x": {"speed": 2}}}).read(Some) == Some(1.0, Axis(2.0))
    assert Params.of({}).read(Some) == Some()


def test_a_renamed_key_is_told_once_and_one_without_effect_too():
    params = Params.of({"pace": 4, "colour": "red"}, "c")
    renames = {"pace": "rate", "colour": ""}
    for _ in range(2):
        assert params.read(Some, renames).rate == 4.0
    assert params.warnings == [
        "c: colour: 'colour' has no effect and can be removed",
        "c: pace: 'pace' is read as 'rate'",
    ]


def test_the_rate_is_the_managers_unless_it_is_given():
    assert Params.of({}).read(CommonParams).update_rate == 0
    assert Params.of({"update_rate": 50}).read(CommonParams).update_rate == 50


def test_a_rate_below_zero_is_refused():
    with pytest.raises(RobotConfigError, match="update_rate"):
        Params.of({"update_rate": -1}).read(CommonParams)


def test_what_has_no_effect_here_is_told():
    params = Params.of({"is_async": True}, "c")
    assert params.read(CommonParams).is_async
    assert any("one thread" in warning for warning in params.warnings)
