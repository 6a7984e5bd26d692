"""The ramp to a place: never faster, never steeper, always there in the end."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples

from canopen_control.hardware.tracking import TrapezoidalProfile

PERIOD = 0.01
PLACES = st.lists(st.tuples(st.integers(-5_000, 5_000), st.integers(0, 30)), min_size=1, max_size=4)


def ramp(most=50_000.0, rise=200_000.0):
    trapezoidal_profile = TrapezoidalProfile()
    trapezoidal_profile.limit(most, rise)
    return trapezoidal_profile


@settings(max_examples=examples(60))
@given(PLACES, st.floats(2000.0, 1e5), st.floats(2e4, 1e6))
def test_whatever_the_places_it_is_never_faster_nor_steeper_and_gets_there(places, most, rise):
    created, here, before = ramp(most, rise), 0, 0.0
    for place, cycles in places:
        for _ in range(cycles):
            step = created.step(place - here, PERIOD)
            assert abs(step) <= max(1.0, most * PERIOD + 0.5)
            rising = abs(created.speed) - abs(before)
            assert rising <= rise * PERIOD * 1.001 + 1e-6
            here, before = here + step, created.speed
    last = places[-1][0]
    for _ in range(2_000):
        here += created.step(last - here, PERIOD)
        if here == last and created.speed == 0.0:
            break
    assert here == last


def test_a_way_up_from_rest_rises_holds_and_falls_without_overshoot():
    created, here, steps = ramp(), 0, []
    while here != 30_000:
        steps.append(created.step(30_000 - here, PERIOD))
        here += steps[-1]
        assert here <= 30_000
    assert max(steps) == 500
    assert steps[0] == 20
    assert len(steps) * PERIOD == pytest.approx(30_000 / 50_000 + 50_000 / 200_000, rel=0.15)


def test_a_place_behind_is_gone_to_after_the_speed_has_fallen():
    created, here = ramp(), 0
    for _ in range(20):
        here += created.step(100_000 - here, PERIOD)
    turning = created.step(-here, PERIOD)
    assert turning > 0
    assert created.speed < 40_000


def test_the_drives_own_limit_holds_too_and_rest_restarts():
    created = ramp()
    for _ in range(50):
        assert created.step(1_000_000, PERIOD, 10_000.0) <= 100
    created.rest()
    assert created.step(1_000_000, PERIOD) == 20


def test_without_limits_there_is_not_a_ramp():
    trapezoidal_profile = TrapezoidalProfile()
    assert not trapezoidal_profile.limited
    trapezoidal_profile.limit(math.inf, 1.0)
    assert trapezoidal_profile.limited
