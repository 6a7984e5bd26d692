"""What `support.lockstep` promises to the tests that live in virtual time."""

import os
import select
import threading
import time

import pytest
from support.lockstep import _REAL_SLEEP, lockstep

from canopen_control.host.reactor import Reactor


def test_an_hour_takes_no_time_and_timers_are_never_late():
    real = time.perf_counter()
    with lockstep(), Reactor() as reactor:
        begin, late = reactor.now(), []

        def again(due):
            late.append(reactor.now() - due)
            reactor.call_at(due + 10**10, lambda: again(due + 10**10))

        reactor.call_at(begin + 10**10, lambda: again(begin + 10**10))
        reactor.run_for(3600 * 10**9)
        assert reactor.now() == begin + 3600 * 10**9
        assert late == [0] * 360
        time.sleep(60.0)
        assert time.monotonic_ns() == begin + 3660 * 10**9
    assert time.perf_counter() - real < 20.0
    assert time.monotonic is not None
    assert abs(time.monotonic() - time.clock_gettime(time.CLOCK_MONOTONIC)) < 1.0  # the real one is back


def test_threads_take_turns_and_who_stalls_is_late_for_nothing():
    def story():
        told, ours, theirs = [], *os.pipe()
        with lockstep():
            begin = time.monotonic()

            def tell(what):
                told.append((round(time.monotonic() - begin, 3), what))

            def other():
                for number in range(3):
                    time.sleep(0.1)
                    _REAL_SLEEP(0.02)  # no processor for a while
                    os.write(theirs, b"x")
                    tell(f"wrote {number}")

            thread = threading.Thread(target=other)
            thread.start()
            for _ in range(2):
                tell(f"read {len(os.read(ours, 9)) if select.select([ours], [], [], 0.25)[0] else 0}")
                time.sleep(0.15)
            thread.join()
            tell("joined")
        os.close(ours)
        os.close(theirs)
        return told

    first = story()
    assert first == [
        (0.1, "wrote 0"), (0.1, "read 1"), (0.2, "wrote 1"), (0.25, "read 1"), (0.3, "wrote 2"), (0.4, "joined"),
    ]  # fmt: skip
    assert story() == first


def test_an_event_wakes_at_once_and_a_wait_for_it_ends_in_time():
    with lockstep():
        event, begin = threading.Event(), time.monotonic()
        assert not event.wait(1.5)
        assert time.monotonic() - begin == pytest.approx(1.5)
        threading.Thread(target=lambda: (time.sleep(0.5), event.set())).start()
        assert event.wait(100.0)
        assert time.monotonic() - begin == pytest.approx(2.0)


def test_who_waits_for_less_than_a_nanosecond_does_so_for_one():
    with lockstep() as steps:
        before = steps.now_ns
        time.sleep(1e-12)
        assert steps.now_ns == before + 1
        with lockstep() as inner:
            assert inner is steps


def test_what_comes_from_outside_is_waited_for_in_truth():
    ours, theirs = os.pipe()
    outside = threading.Thread(target=lambda: (_REAL_SLEEP(0.05), os.write(theirs, b"x")))
    outside.start()
    with lockstep():
        assert select.select([ours], [], []) == ([ours], [], [])
    outside.join()
    os.close(ours)
    os.close(theirs)
