"""The history of the bench: a row for each run, in the file that `--json` writes."""

import json

import pytest
from canopen_control_bench import history, runner
from canopen_control_bench.figure import compared, limited
from support.benches import MACHINE


def report(speed):
    figures = [
        compared("robby", "s", [(speed, 1.0)], peer_name="CPU", limit=20.0),
        limited("boot of robby", "ms", [30.0], limit=100),
    ]
    return runner.Report(MACHINE, {"simulate": figures})


def test_each_run_adds_a_row_of_what_is_judged(tmp_path):
    path = tmp_path / "speed.json"
    for speed in (50.0, 60.0):
        report(speed).write(path)
    rows = json.loads(path.read_text())["history"]
    assert [row["figures"]["simulate"] for row in rows] == [
        {"robby": 50.0, "boot of robby": 30.0},
        {"robby": 60.0, "boot of robby": 30.0},
    ]
    assert rows[0]["date"] == MACHINE["date"]


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"history": 3}', '{"history": [3, {"date": "today"}]}'])
def test_a_file_without_rows_begins_anew(tmp_path, text):
    path = tmp_path / "speed.json"
    path.write_text(text)
    assert history.kept_rows(path) == []
    assert history.kept_rows(tmp_path / "none.json") == []


def test_only_the_newest_runs_are_kept(tmp_path):
    row = {"date": "", "package": "", "figures": {}}
    path = tmp_path / "speed.json"
    path.write_text(json.dumps({"history": [{**row, "date": str(n)} for n in range(history.MOST_RUNS + 5)]}))
    report(1.0).write(path)
    rows = json.loads(path.read_text())["history"]
    assert (len(rows), rows[0]["date"]) == (history.MOST_RUNS, "6")
