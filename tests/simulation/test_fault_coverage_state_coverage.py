from support.simulated import Played

from canopen_control.cia402.state import TRANSITIONS
from canopen_control.simulation.fault_coverage import EDGES, StateCoverage, coverage_words, left_out
from canopen_control.simulation.wire_view import WireView


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
