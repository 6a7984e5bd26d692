"""The phase lock: one edge between two SYNCs, whatever the clocks and the process do."""

import bisect
import operator
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples

from canopen_control.runtime.pacer import SyncPhase

MS = 1_000_000


def follow(period, behind, syncs, *, ppm, lateness, seed=1, begin=0):
    """Run an edge clock that follows SYNCs of another clock; return (SYNC, edges since the SYNC before) and the phase.

    `lateness(random)` is how late a SYNC is seen, in ns; SYNCs are handed over in the order in which they are seen.
    """
    chance, phase = random.Random(seed), SyncPhase(period, behind)
    real = period * (1_000_000 + ppm) / 1_000_000
    ticks = sorted((round(begin + number * real) + lateness(chance), number) for number in range(syncs))
    edge, edges = period, []
    for seen, _ in ticks:
        while edge <= seen:
            edges.append(edge)
            edge += period + phase.step()
        edge += phase.heard(seen, edge)
    sent = [round(begin + number * real) for number in range(syncs)]
    counts, at = [], 0
    for sync in sent:
        before = at
        while at < len(edges) and edges[at] < sync:
            at += 1
        counts.append(at - before)
    return counts, edges, sent, phase


@pytest.mark.rest
@pytest.mark.parametrize("ppm", [-200, 200])
def test_in_an_hour_at_200_ppm_no_edge_is_lost_and_none_doubled(ppm):
    period = 10 * MS
    counts, edges, sent, phase = follow(
        period, period // 2, 360_000, ppm=ppm, lateness=lambda chance: round(chance.random() * 2 * MS), begin=3 * MS
    )
    assert set(counts[2:]) == {1}
    assert phase.locked
    drift = abs(sent[-1] - 3 * MS - (len(sent) - 1) * period)
    assert drift == pytest.approx(720 * MS, rel=1e-4), "72 periods that a clock of its own would have lost"
    behind = [(edge - 3 * MS) % (sent[1] - sent[0]) for edge in edges[-1000:]]
    assert max(behind) - min(behind) < period // 8


def on_the_next(edge):
    """Return when an adapter hands over what came at `edge`: once a millisecond, as over USB."""
    return -(-edge // MS) * MS


@pytest.mark.rest
@pytest.mark.parametrize(("period", "ppm", "syncs"), [(10 * MS, -200, 360_000), (4 * MS, 200, 150_000)])
def test_in_an_hour_a_process_up_to_2_ms_late_behind_a_slow_adapter_has_one_set_point_there_at_each_sync(
    period, ppm, syncs
):
    chance = random.Random(ppm)
    _, edges, sent, _ = follow(period, period // 8, syncs, ppm=ppm, lateness=lambda chance: round(chance.random() * MS))
    arrived = [on_the_next(edge + round(chance.random() * 2 * MS)) for edge in edges[64:]]
    assert all(map(operator.le, arrived, arrived[1:])), "none overtakes another"
    first = bisect.bisect(sent, arrived[0])
    waiting = [bisect.bisect(sent, when, lo=max(0, first + place - 3)) for place, when in enumerate(arrived[:-1])]
    assert waiting == list(range(first, first + len(waiting)))


@pytest.mark.parametrize("ppm", [-2000, 1000, 7000, 12_000])
@pytest.mark.parametrize("period", [MS, 10 * MS])
def test_a_period_that_is_a_hundredth_longer_is_learned_and_the_edges_stay_behind_its_syncs(period, ppm):
    counts, edges, sent, _ = follow(
        period, period // 8, 4000, ppm=ppm, lateness=lambda chance: round(chance.random() ** 3 * 0.4 * period)
    )
    assert set(counts[200:]) == {1}
    real = sent[-1] / (len(sent) - 1)
    behind = [edge / real % 1.0 for edge in edges[200:]]
    assert min(behind) > 0.07
    assert max(behind) < 0.25


@settings(max_examples=examples(60))
@given(
    period=st.sampled_from([MS, 4 * MS, 10 * MS, 20 * MS]),
    part=st.sampled_from([2, 8]),
    ppm=st.integers(-200, 200),
    begin=st.floats(0.0, 1.0),
    late=st.floats(0.0, 0.45),
    stalls=st.integers(0, 20),
    seed=st.integers(0, 1 << 30),
)
def test_late_sights_bunches_and_stalls_never_lose_or_double_an_edge(period, part, ppm, begin, late, stalls, seed):
    def lateness(chance):
        if stalls and chance.randrange(1000) < stalls:
            return round(chance.random() * 3 * period)  # the process was away for up to three periods
        bunch = period // 10  # an adapter hands over what came in a tenth of a period
        return min(round(chance.random() * late * period) // bunch * bunch, period)

    counts, *_ = follow(
        period, period // part, 2000, ppm=ppm, lateness=lateness, seed=seed, begin=round(begin * period)
    )
    settled = counts[64:]
    assert set(settled) == {1}, [(place, count) for place, count in enumerate(counts) if count != 1]


def test_the_first_sync_makes_a_period_longer_and_never_shorter():
    for tick in range(0, 10 * MS, MS // 4):
        phase = SyncPhase(10 * MS, 5 * MS)
        shift = phase.heard(tick, 12 * MS)
        assert 0 <= shift < 10 * MS
        assert (12 * MS + shift - tick) % (10 * MS) == 5 * MS


def test_a_sync_that_comes_at_another_time_from_now_on_is_followed_anew():
    phase = SyncPhase(10 * MS, 5 * MS)
    edge = 5 * MS + phase.heard(0, 5 * MS)
    shifts = []
    for number in range(1, 40):
        edge += 10 * MS + phase.step()
        shifts.append(phase.heard(number * 10 * MS + 6 * MS, edge))  # as if 4 ms earlier
        edge += shifts[-1]
    assert [each for each in shifts if each] == [6 * MS]
    assert (edge - 6 * MS) % (10 * MS) == 5 * MS


def test_a_step_is_a_sixty_fourth_of_a_period_at_most():
    phase, edge, steps = SyncPhase(64_000, 32_000), 32_000, []
    phase.heard(0, edge)
    for number in range(1, 100):
        steps.append(phase.step())
        edge += 64_000 + steps[-1]
        phase.heard(number * 64_000 + 20_000, edge)
    assert max(map(abs, steps)) == 1000
    assert sum(steps) == 20_000
