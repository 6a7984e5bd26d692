"""The report page: self-contained, complete, and safe against the content of a recording."""

import html.parser
import re
import xml.etree.ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from canopen_control.trace.flight_file import NO_FAULT, FlightFile, FlightMeta
from canopen_control.trace.report_build import facts_of
from canopen_control.trace.report_facts import Span
from canopen_control.trace.report_page import LEFT, RIGHT, WIDTH, TimeAxis, bars, lines, page_of, timeline


class Parser(html.parser.HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags, self.references, self.open = [], [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.references += [value for name, value in attributes if name in ("src", "href", "xlink:href", "action")]
        if tag not in ("meta", "line", "rect", "path", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def parsed(page):
    parser = Parser()
    parser.feed(page)
    assert parser.open == []
    return parser


def test_nothing_is_fetched_and_nothing_runs(lost_drive):
    page = page_of(facts_of(lost_drive))
    parser = parsed(page)
    assert parser.references == []
    assert "script" not in parser.tags
    assert "default-src 'none'" in page
    assert not re.search(r"https?://|url\(|@import", page)


def test_a_calm_run_shows_its_last_frames(calm_run):
    page = page_of(facts_of(calm_run))
    assert "The last frames" in page
    assert 'class="sum "' in page


def test_what_is_in_a_recording_is_text_and_never_markup(lost_drive):
    evil = '"><script>alert(1)</script>'
    boot = [replace(step, error=evil) for step in lost_drive.meta.status.boot]
    lost_drive.meta = replace(lost_drive.meta, robot=evil, status=replace(lost_drive.meta.status, boot=boot))
    lost_drive.events = [replace(event, text=evil) for event in lost_drive.events]
    page = page_of(facts_of(lost_drive))
    assert "script" not in parsed(page).tags
    assert "&lt;script&gt;" in page


def test_an_empty_recording_has_a_page():
    page = page_of(facts_of(FlightFile(FlightMeta(robot="", reason=NO_FAULT))))
    parsed(page)
    assert "No error was reported" in page
    assert "<svg" not in page


# Drawings: well-formed whatever they are given, and the peak is in them.


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
