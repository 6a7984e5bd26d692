"""Figures: medians of rounds, ratios, limits both ways."""

import math

from canopen_control_bench.cycle import CANOPEN, OURS, WAKE_LIMIT, wake_figures
from canopen_control_bench.figure import AT_LEAST, Figure, compared, limited
from canopen_control_bench.turns import Turn


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


def test_a_quick_run_has_a_limit_for_p90_only_as_ten_cycles_decide_its_p99() -> None:
    def turns(ours_us: int, late_us: int) -> dict[str, list[Turn]]:
        work = [ours_us * 1000] * 980 + [late_us * 1000] * 20  # the host took the processor away in 2 % of the cycles
        peer = [100_000] * 980 + [late_us * 1000] * 20
        return {OURS: [Turn(work_ns=work)] * 3, CANOPEN: [Turn(work_ns=peer)] * 3}

    quick = wake_figures("1 kHz", turns(25, 500), quick=True)
    assert [(figure.name[-3:], figure.ratio, figure.limit) for figure in quick] == [
        ("p90", 0.25, WAKE_LIMIT),
        ("p99", 1.0, None),
    ]
    assert not wake_figures("1 kHz", turns(50, 500), quick=True)[0].good
    assert [figure.good for figure in wake_figures("1 kHz", turns(25, 500))] == [True, False]
    assert [figure.limit for figure in wake_figures("100 Hz", turns(25, 500))] == [None, None]
