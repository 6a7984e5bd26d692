"""Tracking error: of a drive that follows exactly it is nothing, and pauses in a motion are counted."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples

from canopen_control.hardware.tracking import WINDOW_S, Tracking, TrapezoidalProfile


def tracked(interface="position", **pace):
    tracking = Tracking()
    tracking.pace(0.01, **pace)
    tracking.compare(interface, positions=interface == "position")
    return tracking


@pytest.mark.parametrize(("late", "delay"), [(False, 2), (True, 3)])
@given(wanted=st.lists(st.floats(-1e3, 1e3), min_size=5, max_size=50))
def test_a_drive_that_is_at_each_set_point_when_it_is_measured_has_no_error(late, delay, wanted):
    tracking = tracked(late=late)
    for place, value in enumerate(wanted):
        tracking.step(value, wanted[place - delay] if place >= delay else math.nan)
    figures = tracking.figures()
    assert (figures.worst, figures.rms) == (0.0, 0.0)


@given(errors=st.lists(st.floats(-10, 10), min_size=1, max_size=2000))
def test_figures_since_enable_are_those_of_all_errors_and_the_window_those_of_the_newest(errors):
    tracking = tracked()
    for _ in range(2):
        tracking.step(0.0, math.nan)
    for error in errors:
        tracking.step(0.0, error)
    figures = tracking.figures()
    assert figures.worst_since_enable == max(map(abs, errors))
    assert figures.rms_since_enable == pytest.approx(math.sqrt(sum(e * e for e in errors) / len(errors)), abs=1e-9)
    newest = errors[-round(figures.window_s / 0.01) :]
    assert figures.worst == max(map(abs, newest))
    assert figures.rms == pytest.approx(math.sqrt(sum(e * e for e in newest) / len(newest)), abs=1e-9)
    assert figures.window_s <= 2 * WINDOW_S + 1e-9


def test_nothing_is_known_before_anything_was_compared_and_after_a_new_enable():
    tracking = tracked()
    assert tracking.figures() is None
    for _ in range(4):
        tracking.step(1.0, 0.5)
    assert tracking.figures().worst == 0.5
    tracking.begin()
    assert tracking.figures() is None


def test_unknown_values_are_not_errors():
    tracking = tracked()
    for expected, actual in [(1.0, math.nan), (math.nan, 1.0), (1.0, 1.0), (1.0, math.nan), (1.0, 1.0)]:
        tracking.step(expected, actual)
    assert tracking.figures().worst == 0.0


@pytest.mark.parametrize(
    ("expected", "repeated"),
    [
        ([0.0, 1.0, 2.0, 2.0, 3.0], 1),
        ([0.0, 1.0, 1.0, 1.0, 2.0, 2.0, 3.0], 3),
        ([0.0, 1.0, 2.0, *([2.0] * 10), 3.0], 0),  # it stood
        ([5.0, 5.0, 5.0, 6.0, 7.0], 0),  # it began to move
        ([1.0, 2.0, 3.0, 4.0], 0),
    ],
)
def test_a_position_that_is_sent_again_on_the_way_is_repeated(expected, repeated):
    tracking = tracked()
    for _ in range(6):
        tracking.step(expected[0], 0.0)
    for value in expected:
        tracking.step(value, 0.0)
    assert tracking.repeated == repeated


def test_a_velocity_that_stays_is_not_a_repetition():
    tracking = tracked("velocity")
    for value in (0.0, 1.0, 1.0, 2.0, 2.0):
        tracking.step(value, 0.0)
    assert tracking.repeated == 0


@pytest.mark.parametrize(
    ("interface", "values", "counted"),
    [
        ("position", [0.0, 0.1, 0.2], 2),
        ("position", [0.2] * 10, 0),
        ("velocity", [1.0] * 10, 2),
        ("velocity", [0.0] * 10, 0),
        ("velocity", [math.nan], 0),
    ],
)
def test_skipped_edges_cost_set_points_of_what_moves_alone(interface, values, counted):
    tracking = tracked(interface)
    for value in values:
        tracking.step(value, 0.0)
    tracking.skip(2)
    assert tracking.skipped == counted


def test_values_behind_a_gear_are_reported_the_joint():
    tracking = tracked(factor=-0.01)
    for _ in range(3):
        tracking.step(100.0, 50.0)
    assert tracking.figures().worst == pytest.approx(0.5)


def test_after_a_rest_nothing_is_compared_with_what_was_commanded_before():
    tracking = tracked()
    for _ in range(5):
        tracking.step(1.0, 1.0)
    tracking.restart()
    for value in (7.0, 7.0):
        tracking.step(value, 1.0)
    assert tracking.figures().worst == 0.0


# The ramp to a place: never faster, never steeper, always there in the end.


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
