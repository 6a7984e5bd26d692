import json
from pathlib import Path

import pytest
from support.mutants import MUTANTS
from support.simulated import S, setup_of

from canopen_control.cli.support.simulation_campaign import CampaignOrder, run_campaign
from canopen_control.simulation.campaign import Campaign
from canopen_control.simulation.random_schedule import known_faults


def order(seeds=range(2), **how):
    how.setdefault("duration_ns", 2 * S)
    return CampaignOrder(seeds, faults=known_faults(), words=["robby"], **how)


@pytest.mark.rest
def test_seeds_without_a_breach_write_nothing_unless_a_folder_is_named(tmp_path, capsys):
    assert run_campaign(setup_of(), order(), tmp_path / "out") == 0
    assert capsys.readouterr().out.startswith("2 seeds, 0.00 hours of the robot in ")
    assert not (tmp_path / "out").exists()
    assert run_campaign(setup_of(), order(folder=tmp_path / "out"), tmp_path / "out") == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"junit.xml", "summary.html"}


def test_an_interrupted_campaign_reports_how_far_it_was_and_is_not_a_success(tmp_path, capsys, monkeypatch):
    run = Campaign.run

    def one(self, seeds, jobs):
        yield from run(self, seeds[:1], jobs)
        raise KeyboardInterrupt

    monkeypatch.setattr(Campaign, "run", one)
    assert run_campaign(setup_of(), order(), tmp_path / "out") == 130
    output = capsys.readouterr()
    assert output.out.startswith("1 seeds, ")
    assert "canopen-control: interrupted: 1 of 2 seeds were run" in output.err


@pytest.mark.rest
@pytest.mark.sources
def test_a_breach_is_reported_shrunk_and_written(tmp_path, capsys, monkeypatch):
    MUTANTS["reset_chains_into_enable"](monkeypatch)
    monkeypatch.setattr(Campaign, "shrink", lambda self, result, hear: self.schedule(result.seed)[:12])
    expected = order(range(6, 7), duration_ns=7 * S, as_json=True)
    assert run_campaign(setup_of(), expected, tmp_path) == 1
    results = json.loads(capsys.readouterr().out)
    assert "enable_unasked" in results["breaches"][0]
    [scenario] = results["scenarios"]
    assert (tmp_path / "summary.html").exists()
    assert "steps:" in Path(scenario).read_text()
