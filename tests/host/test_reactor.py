from __future__ import annotations

import itertools
import os
import signal
import socket
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.errors import LocalProtocolError
from canopen_control.host import reactor as reactor_module
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock

MS = 1_000_000
SECOND = 1000 * MS


@pytest.fixture
def pair():
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.setblocking(False)
        theirs.setblocking(False)
        yield ours, theirs


@pytest.fixture
def real():
    with Reactor() as loop:
        yield loop


# -- time on a manual clock


def test_a_timer_at_the_end_of_the_time_still_fires(reactor):
    observed = []
    reactor.call_at(50, lambda: observed.append(reactor.now()))
    reactor.call_at(51, lambda: observed.append(reactor.now()))
    reactor.run_for(50)
    assert observed == [50]
    reactor.run_for(1)
    assert observed == [50, 51]


def test_a_periodic_timer_keeps_its_absolute_edges(reactor):
    edges = []

    def edge():
        edges.append(reactor.now())
        reactor.call_at(edges[-1] + 20 * MS, edge)

    reactor.call_at(20 * MS, edge)
    reactor.run_for(SECOND)
    assert edges == [20 * MS * n for n in range(1, 51)]


def test_a_timer_can_cancel_one_of_the_same_moment(reactor):
    observed = []
    reactor.call_at(5, lambda: second.cancel())
    second = reactor.call_at(5, lambda: observed.append("never"))
    reactor.run_for(10)
    assert observed == []
    assert not second.active


def test_run_until_a_condition_stops_the_clock_there(reactor):
    observed = []
    for moment in (10, 20, 30):
        reactor.call_at(moment, lambda moment=moment: observed.append(moment))
    assert reactor.run_until(lambda: len(observed) == 2)
    assert reactor.now() == 20


def test_run_until_gives_up_when_nothing_can_happen_any_more(reactor):
    reactor.call_later(10, lambda: None)
    assert not reactor.run_until(lambda: False)
    assert reactor.now() == 10


def test_what_is_readable_is_served_before_time_moves(reactor, pair):
    ours, theirs = pair
    observed = []
    reactor.add_reader(ours, lambda: observed.append((ours.recv(10), reactor.now())))
    reactor.call_at(10, lambda: (theirs.send(b"x"), theirs.send(b"y")))
    reactor.call_at(11, lambda: observed.append(("timer", reactor.now())))
    reactor.run_for(20)
    assert observed == [(b"xy", 10), ("timer", 11)]


def test_a_turn_serves_descriptors_then_calls_then_timers(reactor, pair):
    ours, theirs = pair
    theirs.send(b"x")
    observed = []
    reactor.call_at(0, lambda: observed.append("timer"))
    reactor.call_soon(lambda: observed.append("soon"))
    reactor.add_reader(ours, lambda: observed.append(ours.recv(10)))
    reactor.run_for(0)
    assert observed == [b"x", "soon", "timer"]


def test_calls_keep_their_order_and_what_they_add_waits_a_turn(reactor):
    observed = []
    reactor.call_soon(lambda: (observed.append(1), reactor.call_soon(lambda: observed.append(3))))
    reactor.call_soon(lambda: observed.append(2))
    reactor.call_at(0, lambda: observed.append("timer"))
    reactor.run_for(0)
    assert observed == [1, 2, "timer", 3]


def test_run_on_a_manual_clock_races_through_its_timers(reactor):
    count = itertools.count()

    def again():
        if next(count) == 1000:
            reactor.stop()
        reactor.call_later(3600 * SECOND, again)

    again()
    started = time.monotonic()
    reactor.run()
    assert reactor.now() == 1000 * 3600 * SECOND
    assert time.monotonic() - started < 10


def test_run_on_a_manual_clock_without_timers_waits_for_another_thread(reactor):
    thread = threading.Timer(0.01, lambda: reactor.call_threadsafe(reactor.stop))
    thread.start()
    reactor.run()
    thread.join()
    assert reactor.now() == 0


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 50)), max_size=40))
def test_the_same_program_does_the_same_thing_twice(plan):
    def play():
        trace = []
        with Reactor(ManualClock()) as loop:

            def fire(number, again):
                trace.append((loop.now(), number))
                if again:
                    loop.call_later(again, lambda: fire(number, 0))

            for number, (delay, again) in enumerate(plan):
                loop.call_later(delay, lambda number=number, again=again: fire(number, again))
            loop.run_for(100)
        return trace

    first = play()
    assert first == play()
    assert [moment for moment, _ in first] == sorted(moment for moment, _ in first)
    assert len(first) == len(plan) + sum(1 for _, again in plan if again)


# -- exceptions


def test_a_callback_that_raises_ends_nothing_and_is_counted(pair):
    ours, theirs = pair
    raised, observed = [], []

    def fail(text):
        raise ValueError(text)

    with Reactor(ManualClock()) as loop:
        loop.on_error = raised.append
        theirs.send(b"x")
        loop.add_reader(ours, lambda: (ours.recv(1), fail("reader")))
        loop.call_soon(lambda: fail("soon"))
        loop.call_at(1, lambda: fail("timer"))
        loop.call_at(1, lambda: observed.append("after"))
        loop.run_for(10)
        assert loop.errors == 3
    assert [str(error) for error in raised] == ["reader", "soon", "timer"]
    assert observed == ["after"]


def test_an_error_handler_that_raises_ends_nothing_either(capsys):
    with Reactor(ManualClock()) as loop:
        loop.on_error = lambda error: 1 / 0
        loop.call_soon(lambda: [].pop())
        loop.run_for(1)
        assert loop.errors == 2
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_without_a_handler_the_first_twenty_are_printed(capsys):
    with Reactor(ManualClock()) as loop:
        for _ in range(50):
            loop.call_soon(lambda: 1 / 0)
        loop.run_for(1)
        assert loop.errors == 50
    assert capsys.readouterr().err.count("ZeroDivisionError") == 20


def test_a_keyboard_interrupt_ends_the_loop_and_it_can_run_again(reactor):
    def interrupt():
        raise KeyboardInterrupt

    reactor.call_soon(interrupt)
    with pytest.raises(KeyboardInterrupt):
        reactor.run()
    assert reactor.run_for(5)


# -- descriptors


def test_a_reader_that_removes_another_one_of_the_same_turn_is_obeyed(reactor, pair):
    ours, theirs = pair
    ours.send(b"x")
    theirs.send(b"x")
    observed = []

    def only_one():
        observed.append(1)
        for sock in pair:
            reactor.remove_reader(sock)

    for sock in pair:
        reactor.add_reader(sock, only_one)
    reactor.run_for(5)
    assert observed == [1]


def test_a_descriptor_has_a_reader_and_a_writer(reactor, pair):
    ours, theirs = pair
    observed = []
    theirs.send(b"x")

    def write():
        observed.append("w")
        reactor.remove_writer(ours)

    reactor.add_reader(ours, lambda: observed.append(ours.recv(1)))
    reactor.add_writer(ours, write)
    reactor.run_for(1)
    assert observed == [b"x", "w"]
    theirs.send(b"y")
    reactor.run_for(1)
    assert observed == [b"x", "w", b"y"]


def test_what_was_ready_of_a_removed_descriptor_is_not_reported_to_the_next_one_of_its_number(reactor, pair):
    """Both are ready in one turn; the reader that is served first puts another file in the place of the other one."""
    observed, files = [], [os.pipe(), os.pipe()]
    for _, write in files:
        os.write(write, b"x")
    (first, _), (second, _) = files

    def replace(mine, other):
        observed.append("replaced")
        reactor.remove_reader(mine)
        reactor.remove_reader(other)
        os.dup2(pair[0].fileno(), other)  # nothing waits there
        reactor.add_reader(other, lambda: observed.append("told"))

    reactor.add_reader(first, lambda: replace(first, second))
    reactor.add_reader(second, lambda: replace(second, first))
    reactor.run_for(1)
    for number in (number for file in files for number in file):
        reactor.remove_reader(number)
        os.close(number)
    assert observed == ["replaced"]


@pytest.mark.parametrize("kind", ["add_reader", "add_writer"])
def test_a_number_used_again_after_a_close_without_removal_is_served_as_the_new_file(reactor, kind):
    observed = []
    first, other = socket.socketpair()
    getattr(reactor, kind)(first, lambda: observed.append("old"))
    number = first.fileno()
    first.close()
    other.close()
    again, theirs = socket.socketpair()
    with again, theirs:
        ours, peer = (again, theirs) if again.fileno() == number else (theirs, again)
        assert ours.fileno() == number
        reactor.add_reader(ours, lambda: observed.append(ours.recv(1)))
        peer.send(b"x")
        reactor.run_for(1)
        assert observed == [b"x"]
        reactor.remove_reader(ours)


def test_removing_one_of_two_from_a_closed_descriptor_removes_both(reactor):
    first, other = socket.socketpair()
    reactor.add_reader(first, lambda: None)
    reactor.add_writer(first, lambda: None)
    number = first.fileno()
    first.close()
    other.close()
    reactor.remove_writer(number)
    assert number not in reactor._watches
    reactor.run_for(1)


def test_a_peer_that_hangs_up_makes_its_descriptor_readable(reactor, pair):
    ours, theirs = pair
    observed = []

    def read():
        observed.append(ours.recv(1))
        reactor.remove_reader(ours)

    reactor.add_reader(ours, read)
    theirs.close()
    reactor.run_for(1)
    assert observed == [b""]


def test_a_busy_descriptor_does_not_starve_the_timers(real, pair):
    ours, theirs = pair
    theirs.send(b"x")
    real.add_reader(ours, lambda: None)  # never read: ready in every turn
    rung = []
    real.call_later(MS, lambda: rung.append(1))
    assert real.run_until(lambda: bool(rung), timeout_ns=10 * SECOND)
    real.remove_reader(ours)


def test_a_timer_that_is_always_due_does_not_starve_the_descriptors(real, pair):
    ours, theirs = pair

    def again():
        real.call_at(0, again)

    again()
    received = []
    real.add_reader(ours, lambda: received.append(ours.recv(1)))
    real.call_later(MS, lambda: theirs.send(b"x"))
    assert real.run_until(lambda: bool(received), timeout_ns=10 * SECOND)
    assert received == [b"x"]


# -- threads


def test_no_call_of_many_threads_is_lost(real):
    observed = []

    def from_there(number):
        for step in range(500):
            real.call_threadsafe(lambda step=step: observed.append((number, step)))

    threads = [threading.Thread(target=from_there, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    assert real.run_until(lambda: len(observed) == 4000, timeout_ns=30 * SECOND)
    for thread in threads:
        thread.join()
        assert not thread.is_alive()


# -- signals


def test_a_signal_is_served_on_the_loop_and_the_old_handler_returns():
    observed = []
    before = signal.getsignal(signal.SIGUSR1)
    with Reactor() as loop:
        loop.handle_signals({signal.SIGUSR1: lambda: (observed.append("usr1"), loop.stop())})
        loop.call_soon(lambda: os.kill(os.getpid(), signal.SIGUSR1))
        loop.run()
    assert observed == ["usr1"]
    assert signal.getsignal(signal.SIGUSR1) == before
    wakeup = signal.set_wakeup_fd(-1)
    assert wakeup == -1


def test_sigint_is_not_a_keyboard_interrupt_while_it_is_handled():
    before = signal.getsignal(signal.SIGINT)  # not the default where the tests run in the background
    with Reactor() as loop:
        loop.handle_signals({signal.SIGINT: loop.stop})
        loop.call_soon(lambda: os.kill(os.getpid(), signal.SIGINT))
        loop.run()
    assert signal.getsignal(signal.SIGINT) is before


# -- the life of a loop


def test_a_loop_does_not_run_inside_itself():
    raised = []
    with Reactor(ManualClock()) as loop:
        loop.on_error = raised.append
        loop.call_soon(loop.run)
        loop.run_for(1)
    assert [type(error) for error in raised] == [LocalProtocolError]


def test_a_closed_loop_does_not_run_and_closes_twice():
    loop = Reactor()
    timer = loop.call_later(5, lambda: None)
    loop.close()
    loop.close()
    assert not timer.active
    with pytest.raises(LocalProtocolError, match="closed"):
        loop.run()


# -- the real clock


@pytest.mark.sources
@pytest.mark.parametrize("with_alarm", [True, False])
def test_real_timers_fire_in_order_and_never_early(monkeypatch, with_alarm):
    if not with_alarm:
        monkeypatch.setattr(reactor_module, "open_alarm", lambda: None)
    with Reactor() as loop:
        assert (loop._alarm is not None) == with_alarm
        observed = []
        start = loop.now()
        for delay in (3 * MS, MS, 2 * MS):
            loop.call_at(start + delay, lambda delay=delay: observed.append((delay, loop.now() - start)))
        assert loop.run_for(4 * MS)
    assert [delay for delay, _ in observed] == [MS, 2 * MS, 3 * MS]
    assert all(late >= delay for delay, late in observed)


class CountingAlarm:
    def __init__(self):
        self.read, self.write = os.pipe()
        self.settings = []

    def fileno(self):
        return self.read

    def set(self, deadline_ns):
        self.settings.append(deadline_ns)

    def close(self):
        os.close(self.read)
        os.close(self.write)


@pytest.mark.sources
def test_the_alarm_is_set_only_when_the_earliest_deadline_changes(monkeypatch, pair):
    alarm = CountingAlarm()
    monkeypatch.setattr(reactor_module, "open_alarm", lambda: alarm)
    ours, theirs = pair
    with Reactor() as loop:
        far = loop.now() + 3600 * SECOND
        loop.call_at(far, lambda: None)
        served = []

        def echo():
            served.append(ours.recv(1))
            later = loop.call_at(far + 1, lambda: None)
            later.cancel()
            theirs.send(b"x")

        loop.add_reader(ours, echo)
        theirs.send(b"x")
        loop.run_until(lambda: len(served) == 20)
        assert alarm.settings == [far]
        sooner = loop.call_at(far - 5, lambda: None)
        loop.run_until(lambda: len(served) == 40)
        sooner.cancel()
        loop.run_until(lambda: len(served) == 60)
    assert alarm.settings == [far, far - 5, far]


def test_a_timer_of_a_rhythm_fires_at_each_of_its_times(real):
    deadline, late = real.now() + MS, []

    def tick():
        nonlocal deadline
        late.append(real.now() - deadline)
        deadline += MS // 2
        real.call_at(deadline, tick)

    real.call_at(deadline, tick)
    assert real.run_until(lambda: len(late) >= 100, timeout_ns=60 * SECOND)
    assert min(late) >= 0


def test_serving_does_what_is_due_and_leaves_a_manual_clock_alone():
    reactor = Reactor(ManualClock(10))
    done = []
    reactor.call_at(10, lambda: done.append("due"))
    reactor.call_at(11, lambda: done.append("later"))
    assert reactor.next_deadline == 10
    reactor.serve()
    assert (done, reactor.now(), reactor.next_deadline) == (["due"], 10, 11)
    reactor.call_soon(lambda: done.append("soon"))
    assert reactor.next_deadline == 10
    reactor.serve()
    assert done == ["due", "soon"]
    reactor.close()
