import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.view.history import SPAN_S, History


def test_the_newest_sample_is_at_zero_and_an_old_one_leaves_after_thirty_seconds():
    history = History(["a"])
    history.add(1000.0, {"a": 1.0})
    for step in range(1, 300):
        history.add(1000.0 + step / 10, {"a": 2.0})
    ages, values = history.columns(["a"])
    assert (ages[-1], values[0], len(ages)) == (0.0, 1.0, 300)
    history.add(1030.05, {"a": 3.0})
    history.add(1030.15, {"a": 3.0})
    ages, values = history.columns(["a"])
    assert ages[0] == -SPAN_S
    assert (values[0], values[-1]) == (2.0, 3.0)


def test_samples_of_one_tenth_of_a_second_replace_each_other():
    history = History(["a"])
    assert history.add(5.00, {"a": 1.0})
    assert not history.add(5.04, {"a": 2.0})
    assert history.columns(["a"])[1].tolist() == [2.0]


def test_where_nothing_was_known_nothing_is_drawn():
    history = History(["a", "b"])
    history.add(5.0, {"a": 1.0, "b": 1.0})
    history.add(5.1, {"a": 1.0, "b": None})
    history.add(5.5, {"a": 2.0, "b": 2.0})
    ages, a, b = history.columns(["a", "b"])
    assert ages.tolist() == pytest.approx([-0.5, 0.0])
    assert a.tolist() == b.tolist() == [1.0, 2.0]
    assert [len(row) for row in History(["a"]).columns(["a"])] == [1, 1]


def test_a_clock_that_is_set_back_begins_anew():
    history = History(["a"])
    history.add(5000.0, {"a": 1.0})
    history.add(10.0, {"a": 2.0})
    assert history.columns(["a"])[1].tolist() == [2.0]
    history.clear()
    assert history.columns(["a"])[1].tolist() == [0.0]


@given(st.lists(st.tuples(st.floats(0, 1e6), st.one_of(st.none(), st.floats(-1e6, 1e6))), max_size=50))
def test_whatever_comes_the_columns_are_finite_and_in_order(samples):
    history = History(["a"])
    for time, value in samples:
        history.add(time, {"a": value})
    ages, values = history.columns(["a"])
    assert len(ages) == len(values)
    assert np.isfinite(values).all()
    assert (np.diff(ages) > 0).all()
