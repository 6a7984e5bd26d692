import pytest
from support.observers import Watch
from support.simulated import Played

from canopen_control.simulation.fault_coverage import STATES, FaultCoverage, cells_of, cells_words, kind_of, states_of
from canopen_control.simulation.random_schedule import known_faults
from canopen_control.simulation.scenario_events import KINDS
from canopen_control.virtual.scenario import ScenarioEvent


@pytest.fixture
def covered(played: Played):
    coverage = FaultCoverage(played.robot)
    played.robot.observers.append(Watch(played=lambda _now, act: coverage.on_event(act)))
    played.coverage = coverage
    return played


def test_a_fault_counts_for_each_machine_of_its_node(covered):
    covered.do("fault", 3, 0.1, name="warning")
    assert covered.coverage.cells == {
        ("NMT", "OPERATIONAL", "warning"): 1,
        ("CiA 402", "OPERATION_ENABLED", "warning"): 1,
        ("boot", "READY", "warning"): 1,
        ("axis power", "FOLLOWING", "warning"): 1,
    }


def test_a_trouble_of_all_counts_each_state_once(covered):
    covered.do("stop").run(1.0).do("axis", "right_drive", name="enable").run(0.5)
    covered.do("lose", "", 0.05, values=(2.0,))
    power = {state for machine, state, _ in covered.coverage.cells if machine == "axis power"}
    assert set(covered.coverage.cells.values()) == {1}
    assert power <= set(STATES["axis power"])


def test_a_drive_without_supply_and_a_robot_that_is_down_have_no_states(covered):
    covered.do("power", 3)
    assert {machine for machine, _ in states_of(covered.robot, 3)} == {"boot", "axis power"}
    covered.do("kill", seconds=0.5)
    assert list(states_of(covered.robot, 3)) == []
    assert {machine for machine, _ in states_of(covered.robot, 2)} == {"NMT", "CiA 402"}


def test_what_breaks_nothing_counts_nowhere(covered):
    covered.drive(5.0, 5.0).do("stop").run(0.1)
    assert covered.coverage.cells == {}


def test_the_cells_are_all_states_with_all_kinds():
    faults = known_faults()
    cells = cells_of(faults)
    kinds = {name for name, kind in KINDS.items() if kind.breaks} - {"fault"} | set(faults)
    assert len(cells) == len(set(cells)) == sum(map(len, STATES.values())) * len(kinds)
    assert kind_of(ScenarioEvent(0, "fault", "2", "silent")) == "silent"
    assert kind_of(ScenarioEvent(0, "kill")) == "kill"


def test_the_words_count_only_cells_that_there_are():
    cells = cells_of(["silent"])
    some = [cell for cell in cells if cell[0] == "NMT"][:3]
    words = cells_words([*some, ("NMT", "nowhere", "silent")], ["silent"])
    assert f"NMT 3 of {4 * 10}" in words
    assert "boot 0 of 30" in words
