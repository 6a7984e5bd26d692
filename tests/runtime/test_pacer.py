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
