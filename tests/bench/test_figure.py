"""Figures: medians of rounds, ratios, limits both ways."""

import math

import pytest
from canopen_control_bench.figure import AT_LEAST, Figure, compared, limited, percentile, percentiles
from hypothesis import given
from hypothesis import strategies as st


def test_a_comparison_is_judged_by_the_median_of_the_rounds_ratios():
    figure = compared("cpu", "us", [(1, 4), (50, 100), (2, 4)], peer_name="other", limit=0.5)
    assert (figure.ours, figure.peer, figure.ratio, figure.good) == (2, 4, 0.5, True)
    assert not compared("cpu", "us", [(3, 4)] * 3, peer_name="other", limit=0.5).good


def test_without_a_peer_the_median_itself_is_judged():
    assert limited("drives", "", [1, 2, 9], limit=2).good
    assert not limited("drives", "", [1, 3, 9], limit=2).good
    assert limited("rate", "1/s", [5], limit=4, direction=AT_LEAST).good
    assert not limited("rate", "1/s", [3], limit=4, direction=AT_LEAST).good


def test_what_is_no_number_is_never_good_and_what_has_no_limit_always():
    assert not Figure("x", "us", math.nan, limit=1.0).good
    assert Figure("x", "us", math.nan).good


def test_ratios_and_counts_are_steady_and_times_are_not():
    assert compared("x", "us", [(1, 2)], peer_name="p").steady
    assert limited("x", "", [0], counted=True).steady
    assert not limited("x", "s", [0]).steady


def test_json_has_the_verdict():
    assert limited("x", "us", [2], limit=1).as_dict()["good"] is False


@given(st.lists(st.integers(-1000, 1000), min_size=1))
def test_percentiles_are_values_and_rise(values):
    found = list(percentiles(values).values())
    assert found == sorted(found)
    assert found[-1] == max(values)
    assert set(found) <= set(values)


@pytest.mark.parametrize(("part", "value"), [(0.5, 50), (0.99, 99), (1.0, 99)])
def test_a_percentile_is_what_that_part_does_not_pass(part, value):
    assert percentile(range(100), part) == value


def test_nothing_has_no_percentiles():
    assert percentile([], 0.5) == 0.0
