import json

from hypothesis import given
from hypothesis import strategies as st

from canopen_control.commissioning.scope_capture import NamedShot, Shot
from canopen_control.view.scope_chart import MAX_POINTS, chart_options, cursor_change, height_of, thinned

ROWS = tuple((100.0 + n / 10, (float(n), None, -float(n))) for n in range(11))
NAMED = NamedShot(Shot(ROWS, 100.5), ("a", "b", "c"), ("rad", "rad/s", "rad"), "new")


@given(st.lists(st.none() | st.floats(-100, 100), min_size=1, max_size=400), st.integers(8, 40))
def test_a_thinned_signal_keeps_its_peaks_and_its_order(values, most):
    points = thinned(Shot(tuple((float(n), (value,)) for n, value in enumerate(values))), 0, most)
    known = [value for value in values if value is not None]
    drawn = [value for _, value in points if value is not None]
    assert len(points) <= most + 2
    assert [time for time, _ in points] == sorted({time for time, _ in points})
    if known:
        assert (min(drawn), max(drawn)) == (min(known), max(known))


def test_signals_of_one_unit_share_a_field_and_what_is_not_known_is_a_gap():
    options = chart_options(NAMED, None, (-0.2, 0.2))
    lines = {option["id"]: option for option in options["series"]}
    assert [lines[name]["xAxisIndex"] for name in ("s0", "s1", "s2")] == [0, 1, 0]
    assert lines["s1"]["data"][0] == (-0.5, None)
    assert [axis["name"] for axis in options["yAxis"]] == ["rad", "rad/s"]
    assert height_of(NAMED) > 300
    json.dumps(options, allow_nan=False)  # as it is sent


def test_cursors_and_the_trigger_are_all_that_changes_with_them():
    change = cursor_change(NAMED, (-0.2, 0.3))
    assert set(change) == {"series"}
    marks = change["series"][0]["markLine"]["data"]
    assert [(mark["xAxis"], mark["name"]) for mark in marks] == [(-0.2, "1"), (0.3, "2"), (0.0, "T")]
    assert change["series"][0]["markLine"]["precision"] > 6
    assert len(str(change)) < 2000
    assert MAX_POINTS > 1000
