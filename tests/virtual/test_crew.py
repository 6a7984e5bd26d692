from __future__ import annotations

import pytest
from support.virtualbench import TMCM, Bench

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, EdsError
from canopen_control.virtual.crew import make_crew
from canopen_control.virtual.launch import Options
from canopen_control.virtual.plant import LagPlant
from canopen_control.virtual.scenario import ScenarioError
from canopen_control.virtual.world import PlainWorld

GENERIC = data_path("eds", "generic_cia402.eds")


def test_a_crew_without_files_is_plain_nodes_with_their_ids_as_serials():
    crew = make_crew([2, 3], TMCM, Options(faults=["warning"]), print)
    assert [node.node_id for node in crew.nodes] == [2, 3]
    assert [node.get(0x1018, 4) for node in crew.nodes] == [2, 3]
    assert (crew.timeline, type(crew.world)) == ((), PlainWorld)
    assert [Bench(node).node.switches.active for node in crew.nodes] == [["warning"]] * 2


def test_serials_count_up():
    crew = make_crew([2, 3], TMCM, Options(serial=100), print)
    assert [node.get(0x1018, 4) for node in crew.nodes] == [100, 101]


def test_files_give_timeline_plants_and_stored_values(tmp_path):
    scenario, plant, store = tmp_path / "s.yml", tmp_path / "p.yml", tmp_path / "store"
    scenario.write_text("steps: [{at: 1s, fault: silent}]")
    plant.write_text('axes: {"3": {kind: lag}}')
    options = Options(scenario=scenario, plant=plant, store=store)
    crew = make_crew([3], TMCM, options, print)
    assert crew.timeline[0].fault == "silent"
    assert isinstance(crew.nodes[0].drives[0].mover.plant, LagPlant)
    bench = Bench(crew.nodes[0])
    bench.write(0x6083, 777)
    bench.write(0x1010, 0x65766173, 1)
    again = Bench(make_crew([3], TMCM, options, print).nodes[0])
    assert again.number(0x6083) == 777


def test_a_node_that_lss_named_starts_with_that_id_in_the_next_process(tmp_path):
    options = Options(store=tmp_path / "store")
    node = make_crew([255], GENERIC, options, print).nodes[0]
    assert node.lss.slave.store(7, None)
    assert make_crew([255], GENERIC, options, print).nodes[0].node_id == 7


def test_mistakes_are_told_before_anything_runs(tmp_path):
    with pytest.raises(EdsError):
        make_crew([3], tmp_path / "none.eds", Options(), print)
    with pytest.raises(ConfigError, match="no LSS"):
        make_crew([255], TMCM, Options(), print)
    with pytest.raises(ScenarioError):
        make_crew([3], TMCM, Options(scenario=tmp_path / "none"), print)
