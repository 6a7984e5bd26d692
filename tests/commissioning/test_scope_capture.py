import math
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.service_node import NodeStub

from canopen_control.commissioning.node_session import NodeSession
from canopen_control.commissioning.scope_capture import (
    Condition,
    CursorReading,
    NamedShot,
    ScopeCapture,
    ScopeState,
    Shot,
    Trigger,
    csv_of,
    named_shot,
    parse_csv,
    parse_trigger,
    picture_of,
    write_bag,
)
from canopen_control.commissioning.scope_signals import joint_signal_of, signal_of
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds

NODE = NodeSession(NodeStub({}), 5, read_eds(data_path("eds", "TMCM-1270.eds"), 5).od)
SIGNALS = [signal_of("5:0x6064", NODE), joint_signal_of("wheel:velocity")]
SHOT = Shot(tuple((100.0 + n / 10, (float(n), None)) for n in range(11)), triggered=100.5)
NAMED = named_shot(SHOT, SIGNALS)


def test_csv_has_times_from_the_trigger_and_nothing_where_nothing_is_known():
    lines = csv_of(NAMED).splitlines()
    assert lines[:2] == ["time,t,5:0x6064,wheel:velocity", "100.000000,-0.500000,0,"]
    assert lines[-1] == "101.000000,0.500000,10,"


@given(
    st.lists(st.tuples(st.integers(0, 10**6), st.none() | st.integers(-(10**8), 10**8)), min_size=1, max_size=30),
    st.none() | st.integers(0, 29),
)
def test_what_was_written_is_read_back(samples, trigger):
    now, rows = 1_000_000, []
    for step, value in samples:
        now += step
        rows.append((now / 1e6, (None if value is None else float(value),)))
    shot = Shot(tuple(rows), None if trigger is None else rows[min(trigger, len(rows) - 1)][0])
    back = parse_csv(csv_of(NamedShot(shot, ("a,b",))), "x.csv")
    assert (back.names, back.label, back.place("a,b"), back.place("c")) == (("a,b",), "x.csv", 0, None)
    assert [row for _, row in back.shot.rows] == [row for _, row in rows]
    assert [time for time, _ in back.shot.rows] == pytest.approx([time for time, _ in rows], abs=2e-6)
    assert back.shot.zero == pytest.approx(shot.zero, abs=3e-6)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "is not a capture of a scope"),
        ("time_s,command\n0,1\n", "is not a capture of a scope"),
        ("time,t,a\n", "is not a capture of a scope"),
        ("time,t,a\n1,0,x\n", "a cell is not a number"),
        ("time,t,a\n1\n", "a cell is not a number"),
        ("time,t,a\n1,0,2,3\n", "more or fewer cells"),
    ],
)
def test_what_is_not_a_shot_is_reported(text, why):
    with pytest.raises(ConfigError, match=why):
        parse_csv(text, "file.csv")


def pixels(data):
    """Return the size of a picture, and how many of its pixels have each of some colours."""
    image = pytest.importorskip("matplotlib.image")
    import io

    result = image.imread(io.BytesIO(data))[:, :, :3]

    def count(red, green, blue):
        near = abs(result - [red / 255, green / 255, blue / 255]).max(axis=2) < 0.2
        return int(near.sum())

    return result.shape, count(0x1F, 0x77, 0xB4), count(0x9A, 0xA5, 0xB1), count(0x16, 0x32, 0x4F)


@pytest.mark.rest
def test_a_picture_has_the_signal_its_overlay_and_the_cursors():
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install canopen-control[plot]")
    size, signal, overlay, cursor = pixels(picture_of(NAMED))
    assert size[1] > size[0] > 300
    assert signal > 200
    other = NamedShot(Shot(tuple((time, (5.0,)) for time, _ in SHOT.rows), 100.2), ("5:0x6064",), ("",), "old")
    _, again, below, lines = pixels(picture_of(NAMED, other, (-0.2, 0.2)))
    assert again > 200
    assert below > overlay + 200
    assert lines > cursor + 200


def test_a_signal_that_is_never_known_is_an_empty_picture():
    pytest.importorskip("matplotlib")
    unknown = NamedShot(Shot(((0.0, (None,)), (1.0, (math.nan,)))), ("a",))
    assert picture_of(unknown).startswith(b"\x89PNG")


def test_without_matplotlib_it_suggests_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(ConfigError, match=r"pip install canopen-control\[plot\]; or write NAME\.csv"):
        picture_of(NAMED)


@pytest.mark.rest
def test_a_bag_has_a_topic_for_each_signal(tmp_path):
    reader = pytest.importorskip("rosbags.rosbag2")
    both = Shot(tuple((time, (value[0], 2.0)) for time, value in SHOT.rows))
    write_bag(tmp_path / "shot", both, SIGNALS)
    with reader.Reader(tmp_path / "shot") as bag:
        topics = {connection.topic: connection.msgcount for connection in bag.connections}
    assert topics == {"/scope/node_5/o6064_00": 11, "/scope/wheel/velocity": 11}


def fed(capture, values, step=0.1):
    for number, value in enumerate(values):
        capture.feed(number * step, (value,))
    return capture


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
    assert not trigger.fires(None, (0, healthy, fault))  # the condition was already true, so it does not fire


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
    assert shot.rows == ((5.0, (1.0,)), (6.0, (1.0,)))  # a capture at standstill is as long as one in motion


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
def test_what_is_not_a_trigger_is_reported_with_what_one_is(text):
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
    assert shot.time_range == (-1.0, 2.0)
    assert shot.cursors(0, -1.0, 1.0).difference == 4.0
    assert shot.cursors(0, -1.5, 1.0) is None
    assert shot.cursors(0, 0.0, 2.0) is None


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
    assert shot.time_range == (-1.0, pytest.approx(1.0, abs=0.06))
