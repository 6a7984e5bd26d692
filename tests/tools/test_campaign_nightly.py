"""The nightly campaign of `tools/campaign --hours`: runs, stored results, continuation, and its page."""

import json
import re
from pathlib import Path

import pytest
from campaigner import nightly
from campaigner.__main__ import main
from campaigner.seed_results import REPAIRED, Plan, page_of, read_results

from canopen_control.simulation.campaign import SeedResult
from canopen_control.simulation.invariants import Breach

REFERENCE = Path(__file__).parents[2] / "docs" / "reference"
PLANS = (Plan("robby", 3, 1), Plan("arm6", 1, 1))


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(nightly, "PLANS", PLANS)
    monkeypatch.setattr(nightly, "ALL", 4)
    monkeypatch.setattr(nightly, "code_sum", lambda: "c0de")


def night(path, *words):
    return main(["--hours", "1", "--out", str(path), *words])


def test_a_run_that_was_ended_is_taken_up_where_it_was(short, tmp_path, capsys):
    whole, parts = tmp_path / "whole.json", tmp_path / "parts.json"
    assert night(whole, "--seeds", "4") == 0
    assert night(parts, "--seeds", "2") == 0
    assert read_results(parts).seeds == 2
    assert night(parts, "--seeds", "4") == 0
    assert [robot.sha256 for robot in read_results(parts).robots] == [
        robot.sha256 for robot in read_results(whole).robots
    ]
    assert "4 seeds, 0.00 hours of robots" in capsys.readouterr().out


def test_a_breach_is_shrunk_written_and_exits_with_1(short, tmp_path, monkeypatch, capsys):
    breach = Breach(0.5, "late", "SYNC came late")
    monkeypatch.setattr(
        nightly.Campaign,
        "run",
        lambda _self, seeds, _jobs: (SeedResult(seed, 1.0, 0.1, 9, 1, "ab", (breach,), {}) for seed in seeds),
    )
    monkeypatch.setattr(nightly.Campaign, "shrink", lambda _self, _result: ())
    assert night(tmp_path / "r.json", "--seeds", "2") == 1
    output = capsys.readouterr().out
    assert "robby, seed 0: 0.500 s: late: SYNC came late" in output
    [scenario] = re.findall(r"simulate robby --scenario (\S+)", output)
    assert "steps: []" in Path(scenario).read_text()


def test_the_page_in_the_documentation_is_made_of_the_results_there():
    results = read_results(REFERENCE / "seeds.json")
    assert (REFERENCE / "seeds.md").read_text(encoding="utf-8") == page_of(results)
    names = [plan.name for plan in nightly.PLANS]
    rows = json.loads((REFERENCE / "seeds.json").read_text())["robots"]
    broken = {
        f"{name}, {text.partition(':')[0]}" for name, row in zip(names, rows, strict=True) for text in row["breaches"]
    }
    assert broken <= REPAIRED.keys()
