"""Figures: medians of rounds, ratios, limits both ways."""

import math

from canopen_control_bench.figure import AT_LEAST, Figure, compared, limited


def test_a_comparison_is_judged_by_the_median_of_the_rounds_ratios():
    figure = compared("cpu", "us", [(1, 4), (50, 100), (2, 4)], peer_name="other", limit=0.5)
    assert (figure.ours, figure.peer, figure.ratio, figure.good) == (2, 4, 0.5, True)
    assert not compared("cpu", "us", [(3, 4)] * 3, peer_name="other", limit=0.5).good


def test_without_a_peer_the_median_itself_is_judged():
    assert limited("drives", "", [1, 2, 9], limit=2).good
    assert not limited("drives", "", [1, 3, 9], limit=2).good
    assert limited("rate", "1/s", [5], limit=4, direction=AT_LEAST).good
    assert not limited("rate", "1/s", [3], limit=4, direction=AT_LEAST).good


def test_what_is_not_a_number_is_never_good_and_what_has_no_limit_always():
    assert not Figure("x", "us", math.nan, limit=1.0).good
    assert Figure("x", "us", math.nan).good
