"""The history of the bench: a row for each run, in the file that `--json` writes."""

import json

from canopen_control_bench import runner
from canopen_control_bench.figure import AT_LEAST, compared, limited
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


def compared_report(ratio, *, idle=0.1, **machine):
    figures = [
        compared("cycle", "us", [(ratio, 1.0)], peer_name="canopen", limit=0.5),
        compared("cycle", "us", [(9 * ratio, 1.0)], peer_name="python-can"),
        limited("boot", "ms", [100 * ratio], limit=100),
        limited("frames", "", [1 / ratio], limit=1.0, direction=AT_LEAST, counted=True),
    ]
    return runner.Report(MACHINE | {"idle": idle} | machine, {"cycle": figures})


def slower(tmp_path, before, now):
    path = tmp_path / "speed.json"
    path.unlink(missing_ok=True)
    before.write(path)
    now.put_beside(path)
    return now.slower


def test_what_is_slower_than_the_last_time_is_named_where_it_can_be_compared(tmp_path):
    ratio, count = "cycle: cycle / canopen: 0.4, 0.2 on", "cycle: frames: 2.5, 5 on"
    result = slower(tmp_path, compared_report(0.2), compared_report(0.4))
    assert [text.startswith(begin) for text, begin in zip(result, (ratio, count), strict=True)] == [True, True]
    idle = slower(tmp_path, compared_report(0.2, idle=0.95), compared_report(0.4, idle=0.95))
    assert idle[1].startswith("cycle: boot: 40, 20 on")
    assert "slower than before: cycle: boot: 40" in str_of(tmp_path)


def str_of(tmp_path):
    now = compared_report(0.4, idle=0.95)
    now.put_beside(tmp_path / "speed.json")
    return str(now)


def test_a_little_slower_is_not_a_word_worth_and_nor_is_another_machine(tmp_path):
    assert slower(tmp_path, compared_report(0.2), compared_report(0.24)) == []
    assert slower(tmp_path, compared_report(0.2), compared_report(0.1)) == []
    for other in ({"machine": "a Pi"}, {"package": "compiled"}, {"processors": "awake"}):
        assert slower(tmp_path, compared_report(0.2, **other), compared_report(0.4)) == [], other
