import pytest
from support.mutants import MUTANTS
from support.simulated import S, setup_of

from canopen_control.simulation.campaign import Campaign, Totals
from canopen_control.simulation.random_schedule import known_faults


@pytest.fixture(scope="module")
def campaign():
    return Campaign(setup_of(), 4 * S, known_faults())


@pytest.mark.process
def test_results_do_not_depend_on_how_many_processes_there_are(campaign):
    alone, together = Totals(), Totals()
    for result in campaign.run([0, 1, 2], 1):
        alone.add(result)
    for result in campaign.run([0, 1, 2], 2):
        together.add(result)
    assert [item.sha256 for item in alone.results.values()] == [item.sha256 for item in together.results.values()]
    assert alone.robot_s == 12.0
    assert alone.frames == together.frames > 1000
    assert alone.broken == []
    assert alone.troubles == together.troubles


@pytest.mark.process
def test_a_robot_whose_parameters_are_not_message_runs_in_processes_too():
    arm = Campaign(setup_of("arm6"), S, [])
    assert [item.sha256 for item in arm.run([1, 2], 2)] == [arm.run_seed(seed).sha256 for seed in (1, 2)]


@pytest.mark.rest
@pytest.mark.sources
def test_a_breach_is_shrunk_to_what_it_takes(campaign, monkeypatch):
    MUTANTS["reset_chains_into_enable"](monkeypatch)
    long = Campaign(setup_of(), 8 * S, known_faults(), tries=3)
    result = long.run_seed(6)
    assert result.breaches[0].rule == "enable_unasked"
    tries = []
    results = long.shrink(result, tries.append)
    assert len(results) < len(long.schedule(6))
    assert any(act.name == "fault-reset" for act in results)
    assert tries


def test_there_is_nothing_to_aim_at_on_a_robot_without_drives():
    campaign = Campaign(setup_of("diffbot_sim"), 2 * S, known_faults())
    assert campaign.aim(range(100, 103), ()) == []
    assert campaign.run_seed(1).breaches == ()
