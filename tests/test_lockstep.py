"""Guarantees of `support.lockstep` for tests in virtual time."""

import os
import select
import threading
import time

import pytest
from support.lockstep import _REAL_SLEEP, lockstep, press_ctrl_c

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


def test_threads_take_turns_and_a_stalled_one_misses_nothing():
    def story():
        reported, ours, theirs = [], *os.pipe()
        with lockstep():
            begin = time.monotonic()

            def tell(what):
                reported.append((round(time.monotonic() - begin, 3), what))

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
        return reported

    first = story()
    assert first == [
        (0.1, "wrote 0"), (0.1, "read 1"), (0.2, "wrote 1"), (0.25, "read 1"), (0.3, "wrote 2"), (0.4, "joined"),
    ]  # fmt: skip
    assert story() == first


def test_ctrl_c_ends_a_wait_in_the_turn_of_its_thread():
    order = []

    def interrupt():
        time.sleep(0.1)
        press_ctrl_c()
        _REAL_SLEEP(0.05)  # the thread that was interrupted has time to go on, but not the turn
        order.append("the other thread waits")
        time.sleep(0.1)

    with lockstep():
        thread = threading.Thread(target=interrupt)
        thread.start()
        begin = time.monotonic()
        try:
            time.sleep(30.0)
        except KeyboardInterrupt:
            order.append("interrupted")
        thread.join()
        assert order == ["the other thread waits", "interrupted"]
        assert time.monotonic() - begin == pytest.approx(0.2)
