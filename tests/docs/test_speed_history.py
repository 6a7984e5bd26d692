"""The drawing of the bench's history: one panel for each robot, a line for each build, well-formed."""

import json
import sys
from pathlib import Path
from xml.etree import ElementTree

DOCS = Path(__file__).parents[2] / "docs"
sys.path.insert(0, str(DOCS))
from speed_history import drawn, series_of, write_history  # noqa: E402 - the pages' own modules

SVG = "{http://www.w3.org/2000/svg}"


def row(day, **speeds):
    figures = {f"robby at 50 Hz, {build.replace('_', ' ')}": speed for build, speed in speeds.items()}
    return {"date": f"2026-11-{day:02}T00:00:00+00:00", "package": "1", "figures": {"simulate": figures}}


def test_a_panel_has_a_line_for_each_build_with_the_runs_that_it_is_in():
    rows = [row(1, from_the_sources=50.0), row(2, from_the_sources=70.0, compiled=130.0), row(3, pure_Python=90.0)]
    assert series_of(rows, "simulate") == {
        "robby at 50 Hz": {"from the sources": [(0, 50.0), (1, 70.0), (2, 90.0)], "compiled": [(1, 130.0)]}
    }
    assert series_of(rows, "cycle") == {}


def test_a_figure_without_a_build_in_its_name_is_of_the_build_that_ran():
    rows = [
        {"package": package, "figures": {"cycle": {"cycle, 1 kHz: CPU / canopen": 0.2}}}
        for package in ("pure Python", "compiled")
    ]
    assert series_of(rows, "cycle") == {
        "cycle, 1 kHz: CPU / canopen": {"from the sources": [(0, 0.2)], "compiled": [(1, 0.2)]}
    }


def test_the_drawing_is_an_svg_whose_highest_point_is_at_the_top(tmp_path):
    path = tmp_path / "history.json"
    path.write_text(json.dumps({"history": [row(1, compiled=65.0), row(2, compiled=130.0)]}))
    root = ElementTree.fromstring(drawn(path, "simulate"))
    first, second = ([float(item.get(key)) for key in ("cx", "cy")] for item in root.iter(f"{SVG}circle"))
    assert (second[1], first[1] - second[1]) == (34.0, 45.0)
    assert first[0] < second[0]
    assert "130" in [item.text for item in root.iter(f"{SVG}text")]


def test_runs_on_a_busy_machine_are_rings(tmp_path):
    path = tmp_path / "history.json"
    path.write_text(json.dumps({"history": [row(1, compiled=1.0) | {"idle": 0.2}, row(2, compiled=1.0) | {"idle": 1}]}))
    root = ElementTree.fromstring(drawn(path, "simulate"))
    busy, idle = (item.get("fill") for item in root.iter(f"{SVG}circle"))
    assert (busy, idle) == ("#fff", "#1f77b4")


def test_a_run_reports_which_commit_it_measured(tmp_path):
    path = tmp_path / "history.json"
    path.write_text(json.dumps({"history": [row(1, compiled=1.5) | {"commit": "abc123"}, row(2, compiled=2.0)]}))
    root = ElementTree.fromstring(drawn(path, "simulate"))
    assert [item.findtext(f"{SVG}title") for item in root.iter(f"{SVG}circle")] == [
        "2026-11-01 abc123 1.5",
        "2026-11-02 2",
    ]


def test_the_page_of_this_repository_shows_a_drawing_of_each_family_and_is_written_once(tmp_path):
    write_history(tmp_path)
    created = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    page = (tmp_path / "speed_history.md").read_text(encoding="utf-8")
    drawings = set(created) - {"speed_history.md"}
    assert "speed_history_simulate.svg" in drawings
    assert all(f"({name})" in page for name in drawings)
    write_history(tmp_path)
    assert {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == created


def test_the_history_of_this_repository_has_both_robots_and_the_boot():
    rows = json.loads((DOCS / "reference" / "speed_history.json").read_text(encoding="utf-8"))["history"]
    assert series_of(rows, "simulate").keys() == {"robby at 50 Hz", "16 drives at 50 Hz", "boot of robby, CPU"}


def test_no_path_of_a_machine_is_in_the_history():
    assert "/" not in json.dumps(json.loads((DOCS / "reference" / "speed_history.json").read_text())["machine"])
