from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from canopen_control.ros.session import Mailbox


def test_the_first_message_leaves_at_once():
    box = Mailbox(20)
    assert box.put("forward", 1)
    assert box.take(1000) == ({"forward": 1}, None)


def test_within_an_interval_the_newest_waits_and_the_others_are_superseded():
    box = Mailbox(20)
    box.put("forward", 1)
    box.take(1000)
    assert box.put("forward", 2)
    assert box.take(1005) == ({}, 1020)
    assert not box.put("forward", 3), "somebody comes at 1020 anyway"
    assert box.take(1020) == ({"forward": 3}, None)


def test_controllers_do_not_wait_for_each_other():
    box = Mailbox(20)
    box.put("a", 1)
    box.take(1000)
    box.put("a", 2)
    box.put("b", 3)
    assert box.take(1010) == ({"b": 3}, 1020)


def test_what_waits_under_a_name_that_is_gone_is_dropped():
    box = Mailbox(20)
    box.put("a", 1)
    box.forget("a")
    assert box.take(1000) == ({}, None)
    assert box.put("b", 1), "somebody must be woken again"


@given(st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 30)), max_size=60), st.integers(1, 20))
def test_whoever_obeys_wakes_and_times_gets_the_last_value_and_never_two_in_an_interval(puts, interval):
    box, now, timer, sent = Mailbox(interval), 0, None, []

    def take():
        nonlocal timer
        due, timer = box.take(now)
        sent.extend((now, name, value) for name, value in due.items())

    for number, (name, pause) in enumerate(puts):
        end = now + pause
        while timer is not None and timer <= end:
            now = max(now, timer)
            take()
        now = end
        if box.put(name, number):
            take()
    while timer is not None:
        now = max(now, timer)
        take()
    for name in {name for name, _ in puts}:
        times = [time for time, which, _ in sent if which == name]
        assert all(b - a >= interval for a, b in pairwise(times))
        values = [value for _, which, value in sent if which == name]
        assert values == sorted(values)
        assert values[-1] == max(number for number, (which, _) in enumerate(puts) if which == name)
