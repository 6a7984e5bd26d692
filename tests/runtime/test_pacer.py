import bisect
import itertools
import operator
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples

from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.runtime.pacer import LATE_EDGES_NS, Pacer, SyncPhase

MS = 1_000_000


def follow(period, behind, syncs, *, ppm, lateness, seed=1, begin=0):
    """Run an edge clock that follows SYNCs of another clock; return (SYNC, edges since the SYNC before) and the phase.

    `lateness(random)` is how late a SYNC is seen, in ns; SYNCs are handed over in the order in which they are seen.
    """
    chance, phase = random.Random(seed), SyncPhase(period, behind)
    real = period * (1_000_000 + ppm) / 1_000_000
    ticks = sorted((round(begin + number * real) + lateness(chance), number) for number in range(syncs))
    edge, edges = period, []
    for observed, _ in ticks:
        while edge <= observed:
            edges.append(edge)
            edge += period + phase.step()
        edge += phase.receive_sync(observed, edge)
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
        shift = phase.receive_sync(tick, 12 * MS)
        assert 0 <= shift < 10 * MS
        assert (12 * MS + shift - tick) % (10 * MS) == 5 * MS


def test_a_sync_that_comes_at_another_time_from_now_on_is_followed_again():
    phase = SyncPhase(10 * MS, 5 * MS)
    edge = 5 * MS + phase.receive_sync(0, 5 * MS)
    shifts = []
    for number in range(1, 40):
        edge += 10 * MS + phase.step()
        shifts.append(phase.receive_sync(number * 10 * MS + 6 * MS, edge))  # as if 4 ms earlier
        edge += shifts[-1]
    assert [shift for shift in shifts if shift] == [6 * MS]
    assert (edge - 6 * MS) % (10 * MS) == 5 * MS


def test_a_step_is_a_sixty_fourth_of_a_period_at_most():
    phase, edge, steps = SyncPhase(64_000, 32_000), 32_000, []
    phase.receive_sync(0, edge)
    for number in range(1, 100):
        steps.append(phase.step())
        edge += 64_000 + steps[-1]
        phase.receive_sync(number * 64_000 + 20_000, edge)
    assert max(map(abs, steps)) == 1000
    assert sum(steps) == 20_000


@pytest.fixture
def make():
    reactors = []

    def make(work, period=20 * MS):
        clock = ManualClock(1000)
        reactors.append(Reactor(clock))
        return clock, reactors[-1], Pacer(reactors[-1], period, work)

    yield make
    for reactor in reactors:
        reactor.close()


def test_edges_lie_on_the_grid_of_the_start(make):
    edges = []
    _, reactor, pacer = make(edges.append)
    pacer.start()
    reactor.run_for(100 * MS)
    assert edges == [1000 + n * 20 * MS for n in range(1, 6)]
    assert (pacer.count, pacer.missed) == (5, 0)


def test_missed_edges_are_reported_at_most_once_a_second_and_in_sum(make):
    _, _, pacer = make(lambda _now: None)
    second = 1_000_000_000
    assert pacer.newly_missed(0) == 0
    pacer.missed = 2
    assert [pacer.newly_missed(now) for now in (1, 2)] == [2, 0]
    pacer.missed = 5
    assert [pacer.newly_missed(now) for now in (second, second + 1, second + 2)] == [0, 3, 0]


def test_a_late_cycle_skips_what_it_missed_and_stays_on_the_grid(make):
    edges = []

    def work(now):
        edges.append(now)
        if len(edges) == 2:
            clock.now_ns += 50 * MS

    clock, reactor, pacer = make(work)
    pacer.start()
    reactor.run_for(200 * MS)
    assert pacer.missed >= 1
    assert pacer.count + pacer.missed == 10
    assert (edges[-1] - 1000) % (20 * MS) == 0
    assert pacer.late_max >= 10 * MS
    assert (pacer.work_max, pacer.work) == (50 * MS, 0)


def test_every_cycle_is_counted_by_how_late_it_came(make):
    def work(now):
        if pacer.count == 3:
            clock.now_ns += 21 * MS  # the fourth edge comes a millisecond late

    clock, reactor, pacer = make(work)
    pacer.start()
    reactor.run_for(200 * MS)
    assert sum(pacer.late_counts) == pacer.count == 10
    assert pacer.late_counts[0] == 9
    assert pacer.late_counts[LATE_EDGES_NS.index(MS)] == 1


def test_work_may_stop_the_pacer(make):
    _, reactor, pacer = make(lambda now: pacer.stop())
    pacer.start()
    reactor.run_for(100 * MS)
    assert pacer.count == 1
    assert not pacer.running
    pacer.stop()


def test_work_that_fails_does_not_end_the_cycle(make):
    def work(now):
        raise RuntimeError("broken controller")

    _, reactor, pacer = make(work)
    reactor.on_error = lambda error: None
    pacer.start()
    reactor.run_for(100 * MS)
    assert pacer.count == 5
    assert reactor.errors == 5


@pytest.mark.parametrize("phase_ms", [0, 3, 9.9, 10, 10.1, 15, 19.9])
def test_another_clock_leads_the_grid_to_half_a_period_after_its_ticks(make, phase_ms):
    edges, ticks = [], []
    _, reactor, pacer = make(edges.append)

    def tick():
        ticks.append(reactor.now())
        pacer.lead(reactor.now())
        reactor.call_later(20 * MS, tick)

    reactor.call_later(round(phase_ms * MS), tick)
    pacer.start()
    reactor.run_for(1000 * MS)
    behind = [(edge - ticks[0]) % (20 * MS) for edge in edges]
    assert all(abs(item - 10 * MS) <= 20 * MS // 64 for item in behind[-10:])
    assert pacer.missed == 0
    assert 49 <= pacer.count <= 51
    assert min(after - before for before, after in itertools.pairwise(edges)) >= 9 * MS


def test_a_tick_that_is_seen_late_does_not_shift_the_grid(make):
    edges = []
    _, reactor, pacer = make(edges.append)
    pacer.start()
    reactor.run_for(30 * MS)
    pacer.lead(edges[-1] + 10 * MS)
    reactor.run_for(20 * MS)
    assert edges[1] - edges[0] == 20 * MS
    for late in (4, 0, 7, 0, 9.9):
        pacer.lead(edges[-1] + 10 * MS + round(late * MS))
        reactor.run_for(20 * MS)
    assert {after - before for before, after in itertools.pairwise(edges)} == {20 * MS}


def test_a_late_cycle_is_of_its_edge_and_after_skipped_ones_of_the_newest(make):
    observed = []

    def work(now):
        observed.append((pacer.edge - 1000, pacer.skipped, now - pacer.edge))
        if len(observed) in (1, 2):
            clock.now_ns += (25 if len(observed) == 1 else 65) * MS

    clock, reactor, pacer = make(work)
    pacer.start()
    reactor.run_for(200 * MS)
    assert observed[:4] == [(20 * MS, 0, 0), (40 * MS, 0, 5 * MS), (100 * MS, 2, 10 * MS), (120 * MS, 0, 0)]


def test_a_pacer_that_is_not_running_is_not_led(make):
    _, reactor, pacer = make(lambda now: None)
    pacer.lead(reactor.now())
    reactor.run_for(100 * MS)
    assert pacer.count == 0
