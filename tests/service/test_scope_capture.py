import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.errors import ConfigError
from canopen_control.service.scope_capture import (
    Condition,
    CursorReading,
    ScopeCapture,
    ScopeState,
    Shot,
    Trigger,
    parse_trigger,
)


def fed(capture, values, step=0.1):
    for number, value in enumerate(values):
        capture.feed(number * step, (value,))
    return capture


def test_without_a_trigger_a_shot_begins_with_the_first_sample():
    capture = fed(ScopeCapture(None, length=0.5), range(10))
    (shot,) = capture.take()
    assert [row[1][0] for row in shot.rows] == [0, 1, 2, 3, 4]
    assert (shot.triggered, capture.state) == (None, ScopeState.DONE)


def test_a_shot_has_what_was_before_its_trigger():
    capture = ScopeCapture(Trigger(Condition.RISING, (0,), 10.0), length=1.0, before=0.25)
    fed(capture, [0] * 20 + [11] * 20)
    (shot,) = capture.take()
    assert shot.triggered == pytest.approx(2.0)
    assert shot.rows[0][0] == pytest.approx(1.7)  # the sample that held a quarter of a second before
    assert 2.6 < shot.rows[-1][0] < 2.75


@pytest.mark.parametrize(
    ("condition", "values", "at"),
    [
        (Condition.RISING, [5, 0, 1, 5, 9], 3),
        (Condition.RISING, [9, 9, 9], None),  # it never was below
        (Condition.FALLING, [0, 6, 5, 4], 2),
        (Condition.ABOVE, [6, 0], 0),
        (Condition.BELOW, [6, 5, 4], 2),
        (Condition.RISING, [None, 9, 0, None, 9, 0, 9], 6),  # an edge has a value on either side
        (Condition.ABOVE, [math.nan, 9], 1),
    ],
)
def test_each_condition_fires_where_it_should(condition, values, at):
    capture = ScopeCapture(Trigger(condition, (0,), 5.0), length=1.0)
    fed(capture, values)
    capture.stop()
    assert [round(shot.triggered / 0.1) for shot in capture.take()] == ([] if at is None else [at])


def test_a_fault_is_the_statusword_of_any_node():
    trigger = Trigger(Condition.FAULT, (1, 2))
    healthy, fault = 0x0237, 0x0218
    assert trigger.fires((0, healthy, healthy), (0, healthy, fault))
    assert not trigger.fires((0, healthy, fault), (0, healthy, fault))
    assert not trigger.fires(None, (0, healthy, fault))  # it was there before: it is not what is waited for


def test_shots_follow_each_other_until_there_are_enough():
    capture = ScopeCapture(Trigger(Condition.RISING, (0,), 1.0), length=0.3, shots=2)
    fed(capture, [0, 1, 1, 1, 1, 0, 1, 1, 1, 1, 0, 1, 1])
    assert [round(shot.triggered, 3) for shot in capture.take()] == [0.1, 0.6]
    assert capture.done


def test_a_shot_is_over_by_its_time_also_when_nothing_comes():
    capture = ScopeCapture(None, length=1.0)
    capture.feed(5.0, (1.0,))
    assert capture.next_deadline() == 6.0
    capture.tick(5.9)
    assert capture.take() == []
    capture.tick(6.2)
    (shot,) = capture.take()
    assert shot.rows == ((5.0, (1.0,)), (6.0, (1.0,)))  # what stands still is as long as what moves


def test_what_is_before_must_fit_into_the_shot():
    with pytest.raises(ConfigError, match="2 s before the trigger do not fit into 1 s"):
        ScopeCapture(Trigger(Condition.RISING, (0,)), length=1.0, before=2.0)


def test_measures_are_of_time_and_not_of_samples():
    measured = Shot(((0.0, (0.0,)), (1.0, (10.0,)), (1.5, (None,)), (4.0, (10.0,)))).measure(0)
    assert (measured.least, measured.most, measured.mean) == (0.0, 10.0, 7.5)
    assert measured.rms == pytest.approx(math.sqrt(75.0))
    assert Shot(((0.0, (None,)),)).measure(0) is None


@pytest.mark.parametrize(
    "text", ["", "1", "1:rising", "0:rising:1", "3:rising:1", "1:up:1", "1:rising:nan", "x:rising:1", "1:fault:0"]
)
def test_what_is_no_trigger_is_told_with_what_one_is(text):
    with pytest.raises(ConfigError, match="write SIGNAL:CONDITION:LEVEL, the signals counted from 1 to 2"):
        parse_trigger(text, 2)


def test_a_trigger_is_read():
    assert parse_trigger("2:falling:-1.5e3", 2) == Trigger(Condition.FALLING, (1,), -1500.0)
    assert parse_trigger("fault", 2).condition is Condition.FAULT


SAMPLES = st.lists(st.tuples(st.floats(0, 0.5), st.one_of(st.none(), st.floats(-10, 10))), max_size=60)


@given(SAMPLES, st.floats(0.1, 2.0), st.floats(0.0, 0.99), st.sampled_from([*Condition][:4]))
def test_any_samples_make_shots_in_order_that_hold_their_trigger(samples, length, share, condition):
    before = length * share
    capture = ScopeCapture(Trigger(condition, (0,), 1.0), length=length, before=before, shots=None)
    now = 0.0
    for step, value in samples:
        now += step
        capture.feed(now, (value,))
    capture.stop()
    last = -math.inf
    for shot in capture.take():
        times = [time for time, _ in shot.rows]
        assert times == sorted(times)
        assert shot.triggered in times
        assert times[-1] - shot.triggered <= length - before + 1e-9
        assert shot.triggered > last or len(times) >= 1
        assert all(time >= shot.triggered - before - 1e-9 for time in times[1:])
        last = shot.triggered


def shot_of(values, triggered=None):
    return Shot(tuple((10.0 + number, (value,)) for number, value in enumerate(values)), triggered)


def test_cursors_read_values_that_hold_and_the_rms_between_them():
    shot = shot_of([3.0, 3.0, -4.0, -4.0, 100.0])
    assert shot.cursors(0, 0.5, 3.5) == CursorReading(3.0, -4.0, pytest.approx(math.sqrt((1.5 * 9 + 1.5 * 16) / 3)))
    assert shot.cursors(0, 3.5, 0.5).difference == 7.0
    assert shot.cursors(0, 1.2, 1.2) == CursorReading(3.0, 3.0, 3.0)


def test_cursors_count_from_the_trigger_and_read_nothing_where_nothing_is_known():
    shot = shot_of([1.0, 2.0, 5.0, None], triggered=11.0)
    assert shot.span == (-1.0, 2.0)
    assert shot.cursors(0, -1.0, 1.0).difference == 4.0
    assert shot.cursors(0, -1.5, 1.0) is None
    assert shot.cursors(0, 0.0, 2.0) is None


@given(st.lists(st.integers(-1000, 1000), min_size=2, max_size=20), st.integers(0, 64), st.integers(0, 64))
def test_cursors_are_within_what_is_between_them(values, low, high):
    shot = shot_of(values)
    first, second = sorted(((len(values) - 1) * low / 64, (len(values) - 1) * high / 64))
    read = shot.cursors(0, first, second)
    part = shot.between(first, second)
    assert part.span[1] - part.span[0] == pytest.approx(second - first, abs=1e-9)
    sizes = [abs(row[0]) for _, row in part.rows]
    assert (read.first, read.second) == (values[int(first)], values[int(second)])
    assert min(sizes) - 1e-6 <= read.rms <= max(sizes) + 1e-6


@given(st.floats(0.0, 3.0), st.sampled_from([0.001, 0.01, 0.02]), st.integers(1, 4000), st.booleans())
def test_what_waits_for_a_fault_holds_no_more_than_what_comes_before_it(before, period, samples, with_gaps):
    """It may wait for days: what it holds depends on `before` and the rate alone."""
    capture = ScopeCapture(Trigger(Condition.FAULT, (0,)), length=before + 1.0, before=before)
    for number in range(samples):
        if with_gaps and number % 7 == 0:
            continue
        capture.feed(number * period, (float(0x27),))
        capture.tick(number * period + period / 2)
        assert capture.held <= before / period + 3
    assert capture.state is ScopeState.WAITING


@pytest.mark.rest
def test_a_fault_after_a_day_is_caught_with_what_was_before():
    day, rate = 86_400, 20
    capture = ScopeCapture(Trigger(Condition.FAULT, (0,)), length=2.0, before=1.0)
    for number in range(100_000):
        capture.feed(number / rate, (float(0x27),))
    for number in range(rate * 3):
        capture.feed(day + number / rate, (float(0x08 if number >= rate else 0x27),))
    (shot,) = capture.take()
    assert shot.triggered == day + 1.0
    assert shot.span == (-1.0, pytest.approx(1.0, abs=0.06))
