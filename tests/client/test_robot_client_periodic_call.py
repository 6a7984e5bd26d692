"""Periodic calls on a thread: the first after one period, and none after the context."""

import threading
import time

import pytest
from support.host import eventually

from canopen_control.client.robot_client import periodic_call


def test_calls_repeat_on_a_thread_of_this_name_until_the_block_ends():
    calls = []
    with periodic_call(lambda: calls.append(threading.current_thread().name), 0.001, name="ticking"):
        assert eventually(lambda: len(calls) > 2)
    assert set(calls) == {"ticking"}
    assert "ticking" not in [thread.name for thread in threading.enumerate()]


def test_work_shorter_than_a_period_is_not_delayed_and_causes_no_call():
    begin = time.monotonic()
    with periodic_call(lambda: pytest.fail("too early"), 60.0, name="late"):
        pass
    assert time.monotonic() - begin < 10.0


def test_an_error_of_the_block_ends_the_calls_after_the_running_one():
    entered, leave, done = threading.Event(), threading.Event(), []

    def slow():
        entered.set()
        leave.wait(60)
        done.append(True)

    def block():
        with periodic_call(slow, 0.001, name="slow"):
            assert entered.wait(60)
            leave.set()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        block()
    assert done


def test_the_exit_waits_no_longer_than_allowed():
    entered, leave = threading.Event(), threading.Event()

    def hanging():
        entered.set()
        leave.wait(60)

    begin = time.monotonic()
    with periodic_call(hanging, 0.001, name="hanging", join_s=0.05):
        assert entered.wait(60)
    assert time.monotonic() - begin < 10.0
    leave.set()
