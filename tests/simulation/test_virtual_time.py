import pytest

from canopen_control.simulation.virtual_time import START_NS, Actor, Timing, VirtualTime

MS = 1_000_000
S = 1_000_000_000


def test_what_is_due_at_once_happens_in_the_order_of_its_making():
    time, done = VirtualTime(), []
    time.later(5, lambda: done.append("b"))
    time.later(3, lambda: done.append("a"))
    time.later(5, lambda: done.append("c"))
    assert time.next_ns() == START_NS + 3
    time.run_until(START_NS + 4)
    assert (done, time.now_ns) == (["a"], START_NS + 4)
    time.run_until(START_NS + 5)
    assert done == ["a", "b", "c"]
    assert time.next_ns() is None


def test_what_is_put_into_the_past_happens_now():
    time, observed = VirtualTime(), []
    time.run_until(START_NS + 100)
    time.at(5, lambda: observed.append(time.now_ns))
    time.run_until(START_NS + 100)
    assert observed == [START_NS + 100]


@pytest.fixture
def processes():
    created = []

    def make(*how):
        created.append(Actor(*how))
        return created[-1]

    yield make
    for item in created:
        item.end()


def test_a_process_wakes_late_and_its_timers_go_by_its_own_oscillator(processes):
    time = VirtualTime()
    actor = processes(time, "host", Timing(latency_ns=1000, ppm=100.0), "seed")
    woken = []
    actor.reactor.call_at(actor.reactor.now() + S, lambda: woken.append((time.now_ns, actor.reactor.now())))
    actor.arrived()
    time.run_until(START_NS + 2 * S)
    [(shared, local)] = woken
    assert local - actor.local(START_NS) >= S
    assert shared - START_NS == pytest.approx(S * (1 - 100e-6) + 1000, abs=2000)  # fast: its second is over sooner


def test_lateness_is_drawn_from_the_seed(processes):
    def wake_ups(seed):
        time, result = VirtualTime(), []
        actor = processes(time, "host", Timing(1000, 50_000, 5 * MS), seed)

        def again():
            result.append(time.now_ns)
            actor.reactor.call_later(MS, again)

        actor.call(again)
        time.run_until(START_NS + 20 * MS)
        return result

    assert wake_ups("1") == wake_ups("1") != wake_ups("2")


def test_a_stalled_process_does_nothing_and_then_all_that_waited(processes):
    time, done = VirtualTime(), []
    actor = processes(time, "host", Timing(), "1")
    actor.stall(10 * MS)
    actor.call(lambda: done.append(time.now_ns))
    time.run_until(START_NS + 9 * MS)
    assert done == []
    time.run_until(START_NS + 10 * MS)
    assert done == [START_NS + 10 * MS]


def test_a_process_that_was_put_to_sleep_before_its_wake_up_is_stalled_too(processes):
    time, done = VirtualTime(), []
    actor = processes(time, "host", Timing(latency_ns=MS), "1")
    actor.call(lambda: done.append(time.now_ns))
    actor.stall(5 * MS)
    time.run_until(START_NS + 20 * MS)
    assert done == [START_NS + 6 * MS]


def test_a_process_that_ended_does_nothing_any_more(processes):
    time, done = VirtualTime(), []
    actor = processes(time, "host", Timing(), "1")
    actor.call(lambda: done.append("never"))
    actor.end()
    actor.end()
    actor.arrived()
    time.run_until(START_NS + S)
    assert done == []


def test_time_jumps_only_to_what_comes_before_every_other_event_and_the_end():
    time = VirtualTime()
    start, jumps = time.now_ns, []
    time.at(start + 10, lambda: jumps.extend([time.jump(start + 20), time.jump(start + 19), time.now_ns - start]))
    time.at(start + 20, lambda: jumps.append(time.jump(start + 31)))
    time.run_until(start + 30)
    assert jumps == [False, True, 19, False]
    assert time.now_ns == start + 30
