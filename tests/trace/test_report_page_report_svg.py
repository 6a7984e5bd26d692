"""Drawings: well-formed whatever they are given, and the peak is in them."""

import xml.etree.ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.trace.report_facts import Span
from canopen_control.trace.report_page import LEFT, RIGHT, WIDTH, TimeAxis, bars, lines, timeline

AXIS = TimeAxis(0.0, 10.0, 4.0)


def test_the_axis_runs_over_the_whole_width():
    assert AXIS.x(0.0) == LEFT
    assert AXIS.x(10.0) == WIDTH - RIGHT
    assert AXIS.x(99.0) == WIDTH - RIGHT
    assert TimeAxis(0.0, 0.0).x(0.0) == LEFT


@given(
    st.lists(st.one_of(st.none(), st.floats(-1e9, 1e9)), max_size=50),
    st.floats(0.0, 1e5),
    st.one_of(st.none(), st.floats(-10.0, 1e5)),
)
def test_lines_are_well_formed_and_within_the_drawing(values, end, fault):
    time = [end * n / max(len(values), 1) for n in range(len(values))]
    drawn = lines("a & b", time, [("actual", values)], TimeAxis(0.0, end, fault), "rad/s")
    if all(value is None for value in values):
        assert drawn == ""
        return
    root = ET.fromstring(drawn)
    for path in root.iter("path"):
        numbers = [float(word) for word in path.get("d").replace("M", " ").replace("L", " ").split()]
        assert all(LEFT - 0.1 <= x <= WIDTH - RIGHT + 0.1 for x in numbers[::2])
        assert all(0 <= y <= 130 for y in numbers[1::2])


def test_a_gap_in_the_data_is_a_gap_in_the_line():
    drawn = lines("x", [0, 1, 2, 3], [("actual", [1.0, 2.0, None, 3.0])], AXIS, "")
    assert ET.fromstring(drawn).find("path").get("d").count("M") == 2


def test_of_very_many_points_the_peak_stays():
    values = [0.0] * 100_000
    values[77_777] = 9.0
    time = [10.0 * n / len(values) for n in range(len(values))]
    drawn = lines("x", time, [("actual", values)], AXIS, "")
    path = ET.fromstring(drawn).find("path").get("d")
    assert path.count("L") < 2500
    ys = [float(word.split()[1]) for word in path.replace("M", "L").split("L")[1:]]
    assert min(ys) < 20 < max(ys)


def test_a_span_reports_its_state_and_time():
    drawn = timeline("states", [("<left>", [Span(1.0, 9.0, "FAULT")])], AXIS)
    root = ET.fromstring(drawn)
    assert root.find("g/title").text == "fault, 1.000 s to 9.000 s"
    assert root.find("g/rect").get("class") == "s-FAULT"
    assert root.find("g/text").text == "fault"
    assert [line.get("class") for line in root.iter("line")][-1] == "fault"


@pytest.mark.parametrize("counts", [[0, 0], []])
def test_no_counts_make_no_bars(counts):
    assert bars("x", ["a", "b"][: len(counts)], counts) == ""


def test_one_late_cycle_is_seen_alongside_a_million():
    root = ET.fromstring(bars("x", ["a", "b", "c"], [1_000_000, 0, 1]))
    heights = [float(rect.get("height")) for rect in root.iter("rect")]
    assert heights[2] > 3.0
    assert heights[1] == 0.0
