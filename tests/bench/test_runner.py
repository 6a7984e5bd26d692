"""The runner: a table with verdicts, JSON, and only ratios judged when it was quick."""

import json
from types import SimpleNamespace

import pytest
from canopen_control_bench import machine, runner
from canopen_control_bench.figure import compared, limited
from support.benches import MACHINE

from canopen_control.errors import CanopenError


@pytest.fixture(autouse=True)
def no_commit(monkeypatch):
    """Leave git alone, which the description of the machine asks."""
    monkeypatch.setattr(machine, "_commit", lambda: None)


def report(**options):
    figures = [
        compared("fast", "us", [(1, 4)], peer_name="peer", limit=0.5, absolutes={"hub CPU us": 3.0}),
        compared("slow", "us", [(3, 4)], peer_name="peer", limit=0.5),
        limited("many", "", [5], limit=1),
    ]
    return runner.Report(MACHINE | {"idle": 0.5}, {"cycle": figures}, **options)


def test_what_is_short_is_marked_and_returned():
    text = str(report())
    assert text.count("SHORT") == 2
    assert "hub CPU us 3" in text
    assert "NOT IDLE" in text
    assert [each.name for each in report().short()] == ["slow", "many"]


def test_a_quick_run_judges_ratios_only():
    assert [each.name for each in report(quick=True).short()] == ["slow"]


def test_a_second_run_takes_the_place_of_what_fell_short_or_failed():
    first, second = report(quick=True), report(quick=True)
    first.failures["load"] = "a frame is missing"
    assert first.fell_short() == ["cycle", "load"]
    second.figures = {"cycle": [second.figures["cycle"][0]], "load": []}
    first.take(second)
    assert first.fell_short() == []
    assert first.failures == {}


def test_a_family_that_fails_does_not_take_the_others_with_it(monkeypatch):
    def fail(_options):
        raise CanopenError("a frame is missing")

    modules = {"load": SimpleNamespace(measure=fail), "boot": SimpleNamespace(measure=lambda _options: [])}
    monkeypatch.setattr(runner, "module_of", modules.__getitem__)
    found = runner.run_families(["load", "boot"], runner.Options(as_is=True))
    assert found.failures == {"load": "a frame is missing"}
    assert found.figures == {"boot": []}
    assert "FAILED: a frame is missing" in str(found)


@pytest.mark.parametrize(
    ("as_is", "refused", "told"),
    [
        (False, "", "awake for cycle, scale, services"),
        (False, "/dev/x: Permission denied", "may sleep (/dev/x: Permission denied)"),
        (True, "", "may sleep"),
    ],
)
def test_processors_are_kept_awake_while_a_cycle_is_measured_and_the_table_says_so(monkeypatch, as_is, refused, told):
    seen = []

    def keep_awake(undo):
        undo.callback(seen.append, "asleep")
        seen.append("awake")
        return refused

    monkeypatch.setattr(runner, "keep_awake", keep_awake)
    monkeypatch.setattr(runner, "module_of", lambda _name: SimpleNamespace(measure=lambda _: seen.append("run") or []))
    found = runner.run_families(["scale", "load"], runner.Options(as_is=as_is))
    assert found.machine["processors"] == told
    assert f"processors {told}" in str(found)
    assert seen == (["run", "run"] if as_is else ["awake", "run", "asleep", "run"])


def test_json_has_everything(tmp_path):
    path = tmp_path / "bench.json"
    report().write(path)
    found = json.loads(path.read_text())
    assert found["machine"]["kernel"] == "K"
    assert [each["good"] for each in found["figures"]["cycle"]] == [True, False, False]


def test_what_an_earlier_run_has_written_is_shown_beside(tmp_path):
    path = tmp_path / "bench.json"
    earlier = report()
    earlier.figures["cycle"][0] = compared("fast", "us", [(7.5, 4)], peer_name="peer", limit=0.5)
    del earlier.figures["cycle"][1]
    earlier.write(path)
    now = report()
    now.put_beside(path)
    head, fast, _hub, slow, many = str(now).splitlines()[-5:]
    assert f"last: {MACHINE['date']}, {MACHINE['package']}" in str(now)
    assert head.split()[:2] == ["last", "ours"]
    assert fast.split()[3:5] == ["7.5", "1"]
    assert slow.split()[3:5] == ["3", "4"], "there was none"
    assert many.split()[1:3] == ["5", "5"]


@pytest.mark.parametrize("text", [None, "", "[]", "{}", '{"machine": {}, "figures": []}', "\x00", '{"machine": 3}'])
def test_a_file_that_is_no_report_says_nothing(tmp_path, text):
    path = tmp_path / "bench.json"
    if text is not None:
        path.write_text(text)
    now = report()
    now.put_beside(path)
    assert str(now) == str(report())


@pytest.mark.parametrize("name", runner.FAMILIES)
def test_every_family_is_a_module_that_measures(name):
    assert callable(runner.module_of(name).measure)
