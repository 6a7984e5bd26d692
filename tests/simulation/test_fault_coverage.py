import pytest
from support.observers import Watch
from support.simulated import Played

from canopen_control.cia402.state import TRANSITIONS
from canopen_control.simulation.fault_coverage import (
    EDGES,
    STATES,
    FaultCoverage,
    StateCoverage,
    cells_of,
    cells_words,
    coverage_words,
    kind_of,
    left_out,
    states_of,
)
from canopen_control.simulation.random_schedule import known_faults
from canopen_control.simulation.scenario_events import KINDS
from canopen_control.simulation.wire_view import WireView
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


# -- state coverage


def test_the_machines_have_the_edges_of_their_tables():
    assert ("axis power", "DISABLED", "ENABLE") in EDGES["axis power"]
    assert len(EDGES["CiA 402"]) <= sum(len(row.sources) for row in TRANSITIONS)
    assert ("CiA 402", "SWITCHED_ON", "OPERATION_ENABLED") in EDGES["CiA 402"]
    assert len(EDGES["NMT"]) == 10


def test_a_robot_that_is_enabled_stopped_and_killed_walks_what_it_does(played: Played):
    view = WireView(played.robot.setup.bus)
    for wire in played.robot.wires.values():
        wire.listeners.append(view.hear)
    coverage = StateCoverage(played.robot, [view])
    played.run(0.3)
    played.do("stop").run(1.0)
    walked = coverage.walked
    assert walked["axis power", "FOLLOWING", "STOP"] == 2  # of two wheels
    assert walked["CiA 402", "OPERATION_ENABLED", "SWITCHED_ON"] == 2
    assert ("axis power", "DISABLED", "ENABLE") not in walked
    assert ("axis power", "DISABLED", "ENABLE") in left_out(walked)
    played.do("kill", seconds=0.5).run(0.55)
    coverage.on_sample()
    played.run(1.0)
    assert coverage.walked["axis power", "DISABLED", "ENABLE"] >= 2
    assert ("NMT", "PRE_OPERATIONAL", "OPERATIONAL") in coverage.walked


def test_the_words_count_only_edges_that_there_are():
    edge = next(iter(EDGES["NMT"]))
    words = coverage_words({edge: 3, ("NMT", "unknown", "OPERATIONAL"): 1})
    assert words.endswith("NMT 1 of 10")
    assert words.startswith(f"axis power 0 of {len(EDGES['axis power'])}")
    assert edge not in left_out({edge: 1})
