"""The verb `bench`: its options are those of the package that measures, and a sentence where that is missing."""

import argparse
import sys

import pytest

from canopen_control.cli import bench
from canopen_control.cli.main import main


def parse(*words):
    parser = argparse.ArgumentParser()
    bench.add_arguments(parser)
    return parser.parse_args(words)


def test_options_and_families_are_those_of_the_bench(capsys):
    assert parse("cycle", "--quick").family == ["cycle"]
    with pytest.raises(SystemExit):
        parse("--help")
    assert "two drives: CPU, lateness" in capsys.readouterr().out


def test_it_runs_what_the_bench_runs(monkeypatch):
    from canopen_control_bench import command

    monkeypatch.setattr(command, "run", lambda args: 7 if args.quick else 0)
    assert main(["bench", "--quick"]) == 7


def test_without_the_package_a_sentence_reports_where_it_is(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "canopen_control_bench", None)
    assert main(["bench", "cycle"]) == 2
    error_output = capsys.readouterr().err
    assert "is not installed" in error_output
    assert "tools/bench" in error_output


def test_a_module_that_the_bench_itself_misses_is_not_taken_for_the_bench(monkeypatch):
    monkeypatch.delitem(sys.modules, "canopen_control_bench.command", raising=False)
    monkeypatch.delattr("canopen_control_bench.command", raising=False)
    monkeypatch.setitem(sys.modules, "canopen_control_bench.runner", None)
    with pytest.raises(ModuleNotFoundError, match="runner"):
        parse()
