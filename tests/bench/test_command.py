"""The options of the bench: exit codes, files, which families."""

import argparse
import json

import pytest
from canopen_control_bench import command as bench
from canopen_control_bench.figure import compared, limited
from canopen_control_bench.runner import FAMILIES, GROUPS, Report
from support.benches import MACHINE

from canopen_control.errors import ConfigError


def parse(*words):
    parser = argparse.ArgumentParser()
    bench.add_arguments(parser)
    return parser.parse_args(words)


@pytest.fixture
def measured(monkeypatch):
    """Families that measure at once: one ratio, one limit, as many as asked for."""
    asked = []
    monkeypatch.setattr(bench.signal, "signal", lambda number, handler: None)

    def run_families(names, options):
        asked[:] = names
        measured.options = options
        figures = [
            compared("ratio", "us", [(measured.ratio, 1)], peer_name="p", limit=0.5),
            limited("n", "", [2], limit=1),
        ]
        return Report(MACHINE, {"cycle": figures}, options.quick)

    monkeypatch.setattr(bench, "run_families", run_families)
    measured.ratio = 0.4
    measured.asked = asked
    return measured


def test_check_fails_on_a_limit_and_says_which(measured, capsys):
    assert bench.run(parse()) == 0
    assert bench.run(parse("--check")) == 1
    assert "short: n: 2, must be at most 1" in capsys.readouterr().err


def test_a_quick_check_fails_on_ratios_only(measured):
    assert bench.run(parse("--quick", "--check")) == 0
    measured.ratio = 0.6
    assert bench.run(parse("--quick", "--check")) == 1


def test_what_fell_short_in_a_quick_check_is_measured_once_more_and_that_decides(measured, monkeypatch, capsys):
    ratios = iter([0.6, 0.4])
    first = bench.run_families

    def run_families(names, options):
        measured.ratio = next(ratios)
        return first(names, options)

    monkeypatch.setattr(bench, "run_families", run_families)
    assert bench.run(parse("--quick", "--check", "cycle", "load")) == 0
    assert measured.asked == ["cycle"]
    said = capsys.readouterr().out
    assert "0.60" in said
    assert "0.40" in said


def test_families_are_chosen(measured):
    for words, names in (
        ((), ["cycle"]),
        (("all",), [*FAMILIES]),
        (("--quick",), [*FAMILIES]),
        (("cycle", "live", "cycle"), ["cycle", *(name for name in GROUPS["live"] if name != "cycle")]),
    ):
        bench.run(parse(*words))
        assert measured.asked == names


def test_what_may_run_beside_others_and_what_may_not_are_all_and_apart():
    assert sorted([*GROUPS["simulated"], *GROUPS["live"]]) == sorted(FAMILIES)
    assert set(GROUPS["live"]) >= {"cycle", "scale", "services", "bridge", "soak", "import"}  # these wait for others


def test_the_machine_is_left_as_it_is_only_where_that_is_asked_for(measured):
    for words, as_is in (((), False), (("--as-is",), True)):
        bench.run(parse(*words))
        assert measured.options.as_is is as_is


def test_a_file_that_cannot_be_written_is_refused_before_anything_is_measured(measured, tmp_path):
    for path in (tmp_path / "none" / "b.json", tmp_path):
        with pytest.raises(ConfigError, match="cannot be written"):
            bench.run(parse("--json", str(path)))
    assert measured.asked == []


def test_json_goes_to_a_file(measured, tmp_path):
    bench.run(parse("--json", str(tmp_path / "b.json")))
    assert json.loads((tmp_path / "b.json").read_text())["figures"]["cycle"][1]["ours"] == 2


def test_an_unknown_family_is_a_usage_error():
    with pytest.raises(SystemExit):
        parse("speed")


def test_without_root_going_before_others_is_refused_in_a_sentence(measured, monkeypatch):
    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(bench.os, "setpriority", refuse)
    with pytest.raises(ConfigError, match="only root may go before others"):
        bench.run(parse("--nice", "-5"))
