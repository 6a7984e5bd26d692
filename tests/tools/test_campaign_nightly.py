"""The nightly campaign of `tools/campaign --hours`: what it runs, keeps and goes on from, and its page."""

import json
import re
from collections import Counter
from pathlib import Path

import pytest
from campaigner import nightly
from campaigner.__main__ import main
from campaigner.seed_results import REPAIRED, Plan, Results, RobotResults, page_of, read_results, write_results

from canopen_control.errors import ConfigError
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
    assert [each.sha256 for each in read_results(parts).robots] == [each.sha256 for each in read_results(whole).robots]
    assert "4 seeds, 0.00 hours of robots" in capsys.readouterr().out


def test_results_of_another_version_are_begun_anew(short, tmp_path, monkeypatch):
    path = tmp_path / "r.json"
    night(path, "--seeds", "2")
    monkeypatch.setattr(nightly, "code_sum", lambda: "0ther")
    night(path, "--seeds", "2")
    found = read_results(path)
    assert (found.code, [each.seeds for each in found.robots]) == ("0ther", [1, 1])


def test_seeds_of_two_builds_are_told_as_such(short, tmp_path, monkeypatch):
    path = tmp_path / "r.json"
    monkeypatch.setattr(nightly, "build", lambda: "pure Python")
    night(path, "--seeds", "2")
    assert read_results(path).build == "sources"
    monkeypatch.setattr(nightly, "build", lambda: nightly.COMPILED)
    night(path, "--seeds", "4")
    found = read_results(path)
    assert (found.build, found.seeds) == ("both", 4)
    assert "a part from the sources, the rest with the modules" in page_of(found)


def test_hours_that_are_over_leave_seeds_for_the_next(short, tmp_path):
    path = tmp_path / "r.json"
    assert main(["--hours", "1e-7", "--out", str(path)]) == 1


def test_a_breach_is_shrunk_written_and_exits_with_1(short, tmp_path, monkeypatch, capsys):
    breach = Breach(0.5, "late", "SYNC came late")
    monkeypatch.setattr(
        nightly.Campaign,
        "run",
        lambda _self, seeds, _jobs: (SeedResult(each, 1.0, 0.1, 9, 1, "ab", (breach,), {}) for each in seeds),
    )
    monkeypatch.setattr(nightly.Campaign, "shrink", lambda _self, _result: ())
    assert night(tmp_path / "r.json", "--seeds", "2") == 1
    said = capsys.readouterr().out
    assert "robby, seed 0: 0.500 s: late: SYNC came late" in said
    [scenario] = re.findall(r"simulate robby --scenario (\S+)", said)
    assert "steps: []" in Path(scenario).read_text()


def results():
    found = Results("c0de", PLANS, [RobotResults(3, 18.0, 0.5, 1000, 7, "ab" * 32, [], Counter({("cut", "fault"): 2}))])
    found.robots[0].cells["NMT", "STOPPED", "cut"] = 1234
    found.robots[1].breaches.append("seed 4: 1.000 s: late: SYNC")
    return found


def test_the_page_is_that_of_the_results_that_were_written(tmp_path, capsys):
    path = tmp_path / "seeds.json"
    write_results(path, results())
    assert main(["--page", "--out", str(path)]) == 1  # a breach
    page = path.with_suffix(".md").read_text()
    assert page == page_of(read_results(path))
    assert "3 of 4\nseeds" in page
    assert "`c0de` by the check sum" in page
    assert ", from the sources;" in page
    assert "| robby | 3 | 3 | 1 | 0.01 | 36 | 1,000 | 0 | `abababababab` |" in page
    assert "- arm6, seed 4: 1.000 s: late: SYNC" in page
    assert "| `cut` | 2 |" in page
    assert "| NMT | INITIALISING | STOPPED | OPERATIONAL | PRE_OPERATIONAL |" in page
    assert "| `cut` |  | 1,234 |  |  |" in page


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"robots": [{"robot": 3}]}'])
def test_what_holds_no_results_is_told(tmp_path, text):
    path = tmp_path / "seeds.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match="holds no results of seeds"):
        read_results(path)


@pytest.mark.parametrize("words", [["--hours", "0"], ["--hours", "x"], ["--hours", "1", "--jobs", "0"]])
def test_usage(words, capsys):
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    assert "tools/campaign: error: " in capsys.readouterr().err


def test_the_check_sum_is_of_what_is_simulated(tmp_path):
    (tmp_path / "eds").mkdir()
    before = nightly.code_sum(tmp_path)
    (tmp_path / "eds" / "a.eds").write_text("[FileInfo]")
    assert nightly.code_sum(tmp_path) != before


def test_the_page_in_the_documentation_is_made_of_the_results_there():
    found = read_results(REFERENCE / "seeds.json")
    assert (REFERENCE / "seeds.md").read_text(encoding="utf-8") == page_of(found)
    names = [plan.name for plan in nightly.PLANS]
    rows = json.loads((REFERENCE / "seeds.json").read_text())["robots"]
    broken = {
        f"{name}, {text.partition(':')[0]}" for name, row in zip(names, rows, strict=True) for text in row["breaches"]
    }
    assert broken <= REPAIRED.keys()
