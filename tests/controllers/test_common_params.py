"""What every controller can be told."""

import pytest

from canopen_control.controllers.common_params import CommonParams
from canopen_control.controllers.params import Params
from canopen_control.errors import RobotConfigError


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
