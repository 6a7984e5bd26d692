"""The options of the bench: exit codes, files, which families."""

import argparse

import pytest
from canopen_control_bench import command as bench
from canopen_control_bench.figure import compared, limited
from canopen_control_bench.runner import FAMILIES, GROUPS, Report
from support.benches import MACHINE


def parse(*words):
    parser = argparse.ArgumentParser()
    bench.add_arguments(parser)
    return parser.parse_args(words)


@pytest.fixture
def measured(monkeypatch):
    """Families that measure at once: one ratio, one limit, as many as asked for."""
    requests = []
    monkeypatch.setattr(bench.signal, "signal", lambda number, handler: None)

    def run_families(names, options):
        requests[:] = names
        measured.options = options
        figures = [
            compared("ratio", "us", [(measured.ratio, 1)], peer_name="p", limit=0.5),
            limited("n", "", [2], limit=1),
        ]
        return Report(MACHINE, {"cycle": figures}, options.quick)

    monkeypatch.setattr(bench, "run_families", run_families)
    measured.ratio = 0.4
    measured.asked = requests
    return measured


def test_check_fails_on_a_limit_and_reports_which(measured, capsys):
    assert bench.run(parse()) == 0
    assert bench.run(parse("--check")) == 1
    assert "short: n: 2, must be at most 1" in capsys.readouterr().err


def test_what_fell_short_in_a_quick_check_is_measured_once_more_and_that_decides(measured, monkeypatch, capsys):
    ratios = iter([0.6, 0.4])
    first = bench.run_families

    def run_families(names, options):
        measured.ratio = next(ratios)
        return first(names, options)

    monkeypatch.setattr(bench, "run_families", run_families)
    assert bench.run(parse("--quick", "--check", "cycle", "load")) == 0
    assert measured.asked == ["cycle"]
    output = capsys.readouterr().out
    assert "0.60" in output
    assert "0.40" in output


def test_families_are_chosen(measured):
    for words, names in (
        ((), ["cycle"]),
        (("all",), [*FAMILIES]),
        (("--quick",), [*FAMILIES]),
        (("cycle", "live", "cycle"), ["cycle", *(name for name in GROUPS["live"] if name != "cycle")]),
    ):
        bench.run(parse(*words))
        assert measured.asked == names
