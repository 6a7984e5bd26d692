import itertools

import pytest

from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.runtime.pacer import LATE_EDGES_NS, Pacer

MS = 1_000_000


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


def test_missed_edges_are_told_at_most_once_a_second_and_in_sum(make):
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
    assert all(abs(each - 10 * MS) <= 20 * MS // 64 for each in behind[-10:])
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
    seen = []

    def work(now):
        seen.append((pacer.edge - 1000, pacer.skipped, now - pacer.edge))
        if len(seen) in (1, 2):
            clock.now_ns += (25 if len(seen) == 1 else 65) * MS

    clock, reactor, pacer = make(work)
    pacer.start()
    reactor.run_for(200 * MS)
    assert seen[:4] == [
        (20 * MS, 0, 0),
        (40 * MS, 0, 5 * MS),
        (100 * MS, 2, 10 * MS),
        (120 * MS, 0, 0),
    ]


def test_a_pacer_that_is_not_running_is_not_led(make):
    _, reactor, pacer = make(lambda now: None)
    pacer.lead(reactor.now())
    reactor.run_for(100 * MS)
    assert pacer.count == 0
