import math

import pytest

from canopen_control.controllers.trajectory.follower import SpeedScaling, scaled
from canopen_control.hardware.interfaces import CommandInterface, StateInterface


def test_a_user_sets_it_and_the_command_interface_hears_of_it():
    scaling, command = SpeedScaling(0.5, allowed=True), CommandInterface("arm", "speed")
    scaling.take(None, command)
    scaling.update()
    assert (scaling.factor, command.value) == (0.5, 0.5)
    scaling.set(0.25)
    scaling.update()
    assert (scaling.factor, command.value) == (0.25, 0.25)


@pytest.mark.parametrize(("value", "factor"), [(0.3, 0.3), (2.0, 2.0), (-1.0, 0.0), (math.nan, 0.0), (math.inf, 0.0)])
def test_a_state_interface_counts_and_what_it_does_not_know_lets_time_stand(value, factor):
    scaling = SpeedScaling(1.0, allowed=True)
    scaling.take(StateInterface("arm", "speed", value), None)
    scaling.set(0.9)
    scaling.update()
    assert scaling.factor == factor


@pytest.mark.parametrize("factor", [-0.1, math.nan, math.inf])
def test_a_factor_that_is_none_is_a_sentence(factor):
    assert "give 0 or more" in SpeedScaling(allowed=True).mistake(factor)
    assert SpeedScaling(allowed=True).mistake(0.0) is None


def test_where_more_than_positions_is_commanded_it_runs_at_its_own_speed():
    scaling = SpeedScaling(0.5, allowed=False)
    assert scaling.factor == 1.0
    assert "more than positions" in scaling.mistake(0.5)


@pytest.mark.parametrize(
    ("time", "factor", "wanted"),
    [(10_000_000, 1.0, 10_000_000), (10_000_000, 0.3, 2_999_999), (10_000_000, 0.1, 1_000_000),
     (3_333_333, 0.5, 1_666_666), (10_000_000, 0.0, 0)],
)  # fmt: skip
def test_a_scaled_time_is_cut_to_whole_nanoseconds(time, factor, wanted):
    assert scaled(time, factor) == wanted
