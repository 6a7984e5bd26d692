import xml.etree.ElementTree as ElementTree

import pytest
from support.mutants import MUTANTS
from support.simulated import S, setup_of

from canopen_control.bus.recordings import Recording
from canopen_control.errors import ConfigError
from canopen_control.simulation.campaign import (
    SeedResult,
    Totals,
    html_summary,
    junit_summary,
    write_breach,
    write_text,
)
from canopen_control.simulation.invariants import Breach
from canopen_control.simulation.scenario_steps import read_scenario_steps
from canopen_control.simulation.simulation_run import SimulationRun
from canopen_control.virtual.scenario import ScenarioEvent

LATE = Breach(1.5, "late", "SYNC came <late>")

EDGES = {("NMT", "PRE_OPERATIONAL", "OPERATIONAL"): 2}

CELLS = {("boot", "BOOTING", "cut"): 3}


def result(seed, *breaches):
    return SeedResult(
        seed, 3600.0, 2.0, 100, 5, "0" * 64, breaches, {("silent", "running"): 2, ("cut", "fault"): 1}, EDGES, CELLS
    )


@pytest.fixture
def totals():
    created = Totals()
    for item in (result(2, LATE), result(1)):
        created.add(item)
    return created


def test_the_summary_as_junit_has_a_case_for_each_seed(totals):
    suite = ElementTree.fromstring(junit_summary("robby", totals))
    assert (suite.get("tests"), suite.get("failures")) == ("2", "1")
    assert [case.get("name") for case in suite] == ["seed 1", "seed 2"]
    assert suite[1][0].get("message") == "1.500 s: late: SYNC came <late>"


def test_the_summary_as_a_page_reports_how_much_what_and_in_which_state(totals):
    page = html_summary("robby", totals)
    assert "2 schedules, 2.00 hours of the robot" in page
    assert "seed 2: 1.500 s: late: SYNC came &lt;late&gt;" in page
    assert "<td>silent</td><td></td><td>4</td>" in page
    assert "NMT 1 of 10" in page
    assert "<tr><th>boot</th><th>WAITING</th><th>BOOTING</th><th>READY</th></tr>" in page
    assert "<tr><td>cut</td><td></td><td>6</td><td></td></tr>" in page
    assert "<td>NMT</td><td>PRE_OPERATIONAL</td><td>OPERATIONAL</td><td>4</td>" in page
    assert "<td>axis power</td><td>DISABLED</td><td>ENABLE</td><td>not covered</td>" in page


@pytest.mark.rest
@pytest.mark.sources
def test_a_breach_is_written_as_a_scenario_that_breaks_and_a_recording(tmp_path, monkeypatch):
    MUTANTS["reset_chains_into_enable"](monkeypatch)
    acts = (ScenarioEvent(S, "stop"), ScenarioEvent(3 * S // 2, "axis", name="fault-reset"))
    path = write_breach(tmp_path / "out", setup_of(), result(4, LATE), acts, 3 * S, "canopen-control simulate robby")
    text = path.read_text()
    assert f"# canopen-control simulate robby --scenario {path}" in text
    scenario = read_scenario_steps(path, setup_of())
    run = SimulationRun(setup_of(), scenario.seed, scenario.acts)
    run.run(scenario.duration_ns)
    run.close()
    assert {breach.rule for breach in run.invariants.breaches} == {"enable_unasked"}
    [log] = path.parent.glob("*.log")
    assert len(list(Recording(log))) == run.robot.frames


def test_what_cannot_be_written_is_reported(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="cannot be written"):
        write_text(tmp_path / "file" / "page.html", "")
