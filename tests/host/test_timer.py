from __future__ import annotations

import os
import select
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.host import timer as timer_module
from canopen_control.host.timer import ManualClock, MonotonicClock, Rhythm, TimerQueue, open_alarm

MS = 1_000_000


def nothing():
    pass


def test_a_manual_clock_moves_only_when_it_is_moved():
    clock = ManualClock(5)
    assert clock.now() == 5
    clock.now_ns += 7
    assert clock.now() == 12
    assert clock.is_manual
    assert not MonotonicClock().is_manual


def test_a_timer_cancelled_between_being_due_and_firing_gives_no_callback():
    queue = TimerQueue()
    queue.push(1, nothing)
    due = queue.pop_due(1)[0]
    assert due.active
    due.cancel()
    due.cancel()
    assert due.take() is None
    assert len(queue) == 0


def test_cancelling_many_does_not_grow_the_heap():
    queue = TimerQueue()
    keep = queue.push(10**9, nothing)
    for deadline in range(100_000):
        queue.push(deadline, nothing).cancel()
    assert len(queue) == 1
    assert len(queue._heap) < 200
    assert queue.pop_due(10**9) == [keep]


def test_a_cleared_queue_has_no_active_timer():
    queue = TimerQueue()
    timer = queue.push(1, nothing)
    queue.clear()
    assert not timer.active
    timer.cancel()
    assert len(queue) == 0
    assert queue.pop_due(10) == []


@given(st.lists(st.tuples(st.sampled_from(["push", "cancel", "pop"]), st.integers(0, 30)), max_size=300))
def test_the_queue_does_what_a_sorted_list_does(steps):
    queue = TimerQueue()
    model: list[tuple[int, int]] = []  # (deadline, number)
    timers = {}
    for number, (verb, value) in enumerate(steps):
        if verb == "push":
            timers[number] = queue.push(value, nothing)
            model.append((value, number))
        elif verb == "cancel" and timers:
            chosen = sorted(timers)[value % len(timers)]
            timers[chosen].cancel()
            model = [item for item in model if item[1] != chosen]
        elif verb == "pop":
            due = sorted(item for item in model if item[0] <= value)
            model = [item for item in model if item[0] > value]
            assert queue.pop_due(value) == [timers[number] for _, number in due]
        assert len(queue) == len(model)
        assert queue.next_deadline() == min((deadline for deadline, _ in model), default=None)


# -- the kernel's timer

KINDS = [timer_module._CtypesAlarm] + ([timer_module._OsAlarm] if hasattr(os, "timerfd_create") else [])


@pytest.fixture(params=KINDS)
def alarm(request):
    alarm = request.param()
    yield alarm
    alarm.close()


def readable(alarm, timeout_s=0.0):
    return bool(select.select([alarm.fileno()], [], [], timeout_s)[0])


def test_an_alarm_rings_at_its_moment_and_not_before(alarm):
    deadline = time.monotonic_ns() + 3 * MS
    alarm.set(deadline)
    assert readable(alarm, 5.0)
    assert time.monotonic_ns() >= deadline


def test_setting_an_alarm_again_silences_it_without_a_read(alarm):
    alarm.set(1)
    assert readable(alarm, 5.0)
    alarm.set(time.monotonic_ns() + 3600 * 1000 * MS)
    assert not readable(alarm)
    alarm.set(1)
    assert readable(alarm, 5.0)
    alarm.set(None)
    assert not readable(alarm)


def test_a_rhythm_is_one_after_two_equal_steps_and_ends_with_another():
    rhythm = Rhythm()
    reported = [
        (rhythm.continues(deadline), rhythm.interval_ns) for deadline in (50, 60, 70, 80, 90, 95, 100, 105, 0, 0, 7)
    ]
    assert reported == [
        (False, 0),
        (False, 0),
        (False, 10),
        (True, 10),
        (True, 10),
        (False, 0),
        (False, 5),
        (True, 5),
        (False, 0),
        (False, 0),
        (False, 0),
    ]


@given(st.lists(st.integers(1, 4), max_size=40))
def test_a_timer_with_its_rhythm_rings_at_every_deadline(steps):
    rhythm = Rhythm()
    deadline, initial, interval = 100, 0, 0
    for step in steps:
        deadline += step
        if not rhythm.continues(deadline):
            initial, interval = deadline, rhythm.interval_ns
        assert deadline == initial or (interval and (deadline - initial) % interval == 0)


@pytest.fixture
def settings(alarm):
    """How often the alarm was set in the kernel."""
    settime, result = alarm._settime, []
    alarm._settime = lambda *args, **options: (result.append(args), settime(*args, **options))
    return result


def test_an_alarm_of_a_rhythm_rings_at_each_moment_and_is_set_less_often(alarm, settings):
    first, count = time.monotonic_ns() + 2 * MS, 40
    for number in range(count):
        deadline = first + number * MS
        alarm.set(deadline)
        assert readable(alarm, 5.0)
        assert time.monotonic_ns() >= deadline
    assert 3 <= len(settings) <= count


def test_an_alarm_of_a_rhythm_that_is_set_before_it_has_rung_rings_at_the_later_moment(alarm, settings):
    first = time.monotonic_ns() + 3600 * 1000 * MS
    for number in range(5):
        alarm.set(first + number * MS)
    assert len(settings) == 5
    alarm.set(1)
    assert readable(alarm, 5.0)


def test_an_alarm_of_a_rhythm_that_was_slept_through_rings_at_once(alarm, settings):
    first = time.monotonic_ns() - 100 * MS
    for number in range(3):
        alarm.set(first + number * MS)
    assert readable(alarm, 5.0)
    alarm.set(first + 3 * MS)  # it has rung a hundred times since
    assert len(settings) == 4
    assert readable(alarm)
    alarm.set(None)
    assert not readable(alarm, 0.01)


@pytest.mark.sources
def test_elsewhere_there_is_none(monkeypatch):
    monkeypatch.setattr(timer_module.sys, "platform", "darwin")
    assert open_alarm() is None


@pytest.mark.sources
def test_a_system_that_refuses_leaves_the_selectors_own_timeout(monkeypatch):
    def refuse():
        raise OSError("no timerfd here")

    monkeypatch.setattr(timer_module, "_CtypesAlarm", refuse)
    monkeypatch.setattr(timer_module, "_OsAlarm", refuse)
    assert open_alarm() is None
