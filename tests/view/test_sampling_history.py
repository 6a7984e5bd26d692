from hypothesis import given
from hypothesis import strategies as st

from canopen_control.view.sampling import SPAN_S, History


def test_the_last_thirty_seconds_are_kept():
    history = History(["a"])
    for step in range(400):
        history.add(1000.0 + step / 10, {"a": float(step)})
    rows = history.rows()
    assert rows[-1] == [1039.9, 399.0]
    assert rows[-1][0] - rows[0][0] <= SPAN_S + 0.01


def test_samples_of_one_tenth_of_a_second_replace_each_other():
    history = History(["a"])
    history.add(5.00, {"a": 1.0})
    history.add(5.04, {"a": 2.0})
    assert history.rows() == [[5.04, 2.0]]


def test_news_are_told_once_and_when_they_are_finished():
    history = History(["a"])
    for step in range(4):
        history.add(5.0 + step / 10, {"a": float(step)})
    assert [row[1] for row in history.take_new_rows()] == [0.0, 1.0, 2.0]
    assert history.take_new_rows() == []
    history.add(5.31, {"a": 9.0})
    history.add(5.4, {"a": 4.0})
    assert [row[1] for row in history.take_new_rows()] == [9.0]


def test_where_nothing_was_known_nothing_is_made_up():
    history = History(["a", "b"])
    history.add(5.0, {"a": float("nan")})
    assert history.rows() == [[5.0, None, None]]


def test_a_clock_that_is_set_back_begins_anew():
    history = History(["a"])
    history.add(5000.0, {"a": 1.0})
    history.add(10.0, {"a": 2.0})
    assert history.rows() == [[10.0, 2.0]]


@given(st.lists(st.tuples(st.floats(0, 1e6), st.one_of(st.none(), st.floats()))))
def test_whatever_comes_the_times_go_up_and_every_row_is_told_at_most_once(samples):
    history, told = History(["a"]), []
    for time, value in samples:
        history.add(time, {"a": value})
        told += history.take_new_rows()
        times = [row[0] for row in history.rows()]
        assert times == sorted(times)
    assert len({id(row) for row in told}) == len(told)
