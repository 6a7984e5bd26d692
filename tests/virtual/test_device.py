from __future__ import annotations

import sys
from pathlib import Path

import pytest
from support.virtualbench import TMCM, Bench, T, entry, servo_od

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, EdsError
from canopen_control.od.model import ObjectDictionary
from canopen_control.personality import personality_names, read_personality
from canopen_control.virtual.device import TMCM1270, device_model_of, make_device, make_devices
from canopen_control.virtual.device_model import GENERIC
from canopen_control.virtual.plant import IndependentPlants, LagPlant
from canopen_control.virtual.scenario import ScenarioError

EDS = data_path("eds", "generic_cia402.eds")


def test_a_file_makes_a_device_and_one_dictionary_makes_many():
    assert make_device(TMCM, 3).store.number(0x1014) == 0x83
    od = servo_od(node_id=5)
    assert [make_device(od, node_id).store.number(0x1014) for node_id in (5, 9)] == [0x85, 0x89]


def test_a_file_that_is_not_there_and_a_fault_that_is_none_are_configuration_errors(tmp_path):
    with pytest.raises(EdsError):
        make_device(tmp_path / "none.eds", 3)
    with pytest.raises(ConfigError, match="no fault"):
        make_device(TMCM, 3, ("nonsense",))


def test_the_identity_brings_the_device_model():
    assert device_model_of(make_device(TMCM, 3).od) is TMCM1270
    assert device_model_of(servo_od()) is GENERIC


def test_each_axis_has_its_plant():
    node = make_device(servo_od(axes=3), 5, plant=lambda axis: LagPlant(time_constant=axis + 1.0))
    assert [drive.mover.plant.time_constant for drive in node.drives.values()] == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("change", ["no 6502", "no 606C", "const COB-IDs", "few objects", "real target", "string name"])
def test_files_that_deviate_start_and_reach_operation(change):
    od = servo_od()
    if change == "no 6502":
        del od.entries[0x6502, 0]
    elif change == "no 606C":
        del od.entries[0x606C, 0]
    elif change == "const COB-IDs":
        od.add(entry(0x1400, 1, T.UNSIGNED32, 0x205, "const"))
    elif change == "few objects":
        keep = {(0x1000, 0), (0x6040, 0), (0x6041, 0)}
        od.entries = {address: item for address, item in od.entries.items() if address in keep}
    elif change == "real target":
        od.add(entry(0x60FF, 0, T.REAL32, 0.0))
    else:
        od.add(entry(0x6041, 0, T.VISIBLE_STRING, ""))
    bench = Bench(make_device(od, 5))
    bench.start()
    for word in (6, 7, 15):
        bench.control(word)
    bench.sync()
    assert bench.state == "OPERATION_ENABLED"


def test_an_empty_dictionary_makes_a_node_that_boots():
    bench = Bench(make_device(ObjectDictionary(node_id=1), 1))
    assert [str(frame) for _, frame in bench.seen] == ["701#00"]
    bench.start()
    bench.sync()
    assert bench.node.operational


def test_devices_without_files_are_plain_nodes_with_their_ids_as_serials():
    devices = make_devices([2, 3], TMCM, print, faults=["warning"])
    assert [node.node_id for node in devices.nodes] == [2, 3]
    assert [node.get(0x1018, 4) for node in devices.nodes] == [2, 3]
    assert (devices.timeline, type(devices.world)) == ((), IndependentPlants)
    assert [Bench(node).node.fault_switches.active for node in devices.nodes] == [["warning"]] * 2


def test_serials_count_up():
    devices = make_devices([2, 3], TMCM, print, serial=100)
    assert [node.get(0x1018, 4) for node in devices.nodes] == [100, 101]


def test_files_give_timeline_plants_and_stored_values(tmp_path):
    scenario, plant, store = tmp_path / "s.yml", tmp_path / "p.yml", tmp_path / "store"
    scenario.write_text("steps: [{at: 1s, fault: silent}]")
    plant.write_text('axes: {"3": {kind: lag}}')
    options = {"scenario": scenario, "plant": plant, "store": store}
    devices = make_devices([3], TMCM, print, **options)
    assert devices.timeline[0].name == "silent"
    assert isinstance(devices.nodes[0].drives[0].mover.plant, LagPlant)
    bench = Bench(devices.nodes[0])
    bench.write(0x6083, 777)
    bench.write(0x1010, 0x65766173, 1)
    again = Bench(make_devices([3], TMCM, print, **options).nodes[0])
    assert again.number(0x6083) == 777


def test_a_node_that_lss_named_starts_with_that_id_in_the_next_process(tmp_path):
    options = {"store": tmp_path / "store"}
    node = make_devices([255], EDS, print, **options).nodes[0]
    assert node.lss.slave.store(7, None)
    assert make_devices([255], EDS, print, **options).nodes[0].node_id == 7


def test_errors_are_reported_before_anything_runs(tmp_path):
    with pytest.raises(EdsError):
        make_devices([3], tmp_path / "none.eds", print)
    with pytest.raises(ConfigError, match="LSS is not supported"):
        make_devices([255], TMCM, print)
    with pytest.raises(ScenarioError):
        make_devices([3], TMCM, print, scenario=tmp_path / "none")


def test_nodes_of_one_process_may_be_of_different_files():
    eds = Path(__file__).parents[2] / "eds"
    devices = make_devices([2, 5], eds / "TMCM-1270.eds", print, eds_files={5: eds / "generic_cia401.eds"})
    assert [(node.node_id, bool(node.drives)) for node in devices.nodes] == [(2, True), (5, False)]


def test_what_a_world_had_to_guess_is_reported(tmp_path):
    (tmp_path / "guessing_engine.py").write_text(
        "from canopen_control.virtual.plant import IndependentPlants\n"
        "class World(IndependentPlants):\n    notes = ('a mass',)\n"
        "def make(path):\n    return World()\n"
    )
    plant = tmp_path / "plant.yml"
    plant.write_text("engine: guessing_engine:make")
    messages = []
    sys.path.insert(0, str(tmp_path))
    try:
        make_devices([2], Path(__file__).parents[2] / "eds" / "TMCM-1270.eds", messages.append, plant=plant)
    finally:
        sys.path.remove(str(tmp_path))
    assert messages == ["world: a mass"]


@pytest.mark.parametrize("name", [name for name in personality_names() if name != "vfd"])
def test_every_personality_goes_with_the_bundled_drive_of_every_object(name):
    personality = read_personality(name)
    node = make_device(data_path("eds", "generic_cia402.eds"), 3, like=personality)
    assert node.quirks.active
    assert Bench(node).on(2.1).enable(3).node.drives[0].state.name in ("OPERATION_ENABLED", "READY_TO_SWITCH_ON")


def test_the_modes_of_a_personality_are_those_of_its_drive():
    bench = Bench(make_device(data_path("eds", "generic_cia402.eds"), 3, like=read_personality("ipos")))
    assert bench.number(0x6502) == 0x65  # as an iPOS shows them: CSP works and is not listed
    assert bench.abort_of(0x6060, 8) is None
    assert bench.abort_of(0x6060, 9) == 0x06090030


def test_a_personality_on_an_eds_that_lacks_its_objects_is_one_sentence():
    with pytest.raises(ConfigError, match=r"delta\.yaml:4: Delta ASDA-A2 has 0x1006, which the EDS of node 3 "):
        make_device(servo_od(3), 3, like=read_personality("delta"))


def test_quirks_alongside_a_personality():
    node = make_device(data_path("eds", "generic_cia402.eds"), 3, like=read_personality("copley"), quirks=["sdo_late"])
    assert node.quirks.active == ["sdo_late=0.1", "mapping_count_first"]
    with pytest.raises(ConfigError, match="is given twice"):
        make_device(node.od, 3, like=read_personality("copley"), quirks=["mapping_count_first"])
