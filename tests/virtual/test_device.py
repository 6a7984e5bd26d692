from __future__ import annotations

import sys
from pathlib import Path

import pytest
from support.virtualbench import TMCM, Bench, T, entry, ready_tmcm, servo_od, tmcm

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, EdsError
from canopen_control.od.model import ObjectDictionary
from canopen_control.personality import personality_names, read_personality
from canopen_control.virtual.device import TMCM1270, device_model_of, is_tmcm1270, make_device, make_devices
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


# -- tmcm1270


MOVING, NEGATIVE = 1 << 14, 1 << 15


def test_it_is_known_by_its_identity():
    assert is_tmcm1270(tmcm().od)
    assert not is_tmcm1270(servo_od())
    assert tmcm().model is TMCM1270
    assert tmcm().name == "TMCM-1270"


def test_nothing_moves_before_its_ramps_are_written():
    bench = Bench(tmcm()).enable(3)
    bench.write(0x60FF, 2546)
    bench.on(2)
    assert (bench.state, bench.velocity, bench.position) == ("OPERATION_ENABLED", 0, 0)
    bench.write(0x6083, 16000)
    bench.on(2)
    assert bench.velocity == 2546
    bench.write(0x6060, 1)
    bench.write(0x607A, 0)
    bench.on(2)
    bench.control(0x1F)  # without a profile velocity
    position = bench.position
    bench.on(2)
    assert bench.position == position


def test_bits_14_and_15_show_motion_and_direction():
    bench = ready_tmcm()
    assert bench.statusword & (MOVING | NEGATIVE) == 0
    for target, bits in ((1600, MOVING), (-1600, MOVING | NEGATIVE), (0, 0)):
        bench.write(0x60FF, target)
        bench.on(1)
        assert bench.statusword & (MOVING | NEGATIVE) == bits


def test_it_refuses_the_modes_it_lacks_and_writes_to_its_fixed_options():
    bench = Bench(tmcm())
    assert [bench.abort_of(0x6060, mode) for mode in (2, 4, 7, 9, 10)] == [0x06090030] * 5
    assert bench.abort_of(0x605B, 1) == 0x06010002
    assert bench.abort_of(0x605D, 2) is None


def test_the_drive_that_left_is_at_ten_rad_per_s_after_its_ramp():
    bench = ready_tmcm()
    bench.write(0x60FF, 2546)  # 10 rad/s at 1600 microsteps a turn
    bench.on(2546 / 16000)
    assert bench.velocity == 2546
    bench.on(1)
    assert abs(bench.position - (2546**2 / 2 / 16000 + 2546)) <= 1


def test_its_enable_delay_delays_the_enable():
    bench = Bench(tmcm())
    bench.write(0x200A, 500)
    bench.enable(3)
    assert bench.state == "SWITCHED_ON"
    bench.on(0.5)
    assert bench.state == "OPERATION_ENABLED"


def test_microsteps_have_a_display():
    bench = Bench(tmcm())
    assert (bench.number(0x2000), bench.number(0x2107)) == (8, 8)
    bench.write(0x2000, 3)
    assert bench.number(0x2107) == 3


#: What a native Lely master of node-ID 1 writes to node 3 at boot where its DCF has `cob_id: auto` for one PDO of each
#: direction: supervision, then each PDO off, type, mapping emptied, filled and counted, and on with bit 30 at 0.
LELY_BOOT = """
23 16 10 01 F4 01 01 00
2B 17 10 00 64 00 00 00
23 01 14 01 03 03 00 80
2F 01 14 02 01 00 00 00
2F 01 16 00 00 00 00 00
23 01 16 01 20 00 FF 60
2F 01 16 00 01 00 00 00
23 01 14 01 03 03 00 00
23 01 18 01 83 02 00 80
2F 01 18 02 01 00 00 00
2F 01 1A 00 00 00 00 00
23 01 1A 01 20 00 64 60
23 01 1A 02 20 00 6C 60
2F 01 1A 00 02 00 00 00
23 01 18 01 83 02 00 00
"""


def test_what_a_lely_master_writes_at_boot_is_taken_with_bit_30_cleared():
    bench = Bench(tmcm())
    for line in LELY_BOOT.strip().splitlines():
        frame = bytes.fromhex(line)
        answers = [(item.can_id, item.data) for item in bench.put(0x603, frame)]
        assert answers == [(0x583, b"\x60" + frame[1:4] + bytes(4))], line
    assert bench.put(0x603, bytes.fromhex("4001180100000000"))[0].data == bytes.fromhex("4301180183020000")
    assert bench.put(0x603, bytes.fromhex("4001140100000000"))[0].data == bytes.fromhex("4301140103030000")
    bench.put(0x000, bytes.fromhex("0103"))
    sent = bench.sync()
    assert [item.data for item in sent if item.can_id == 0x283] == [bytes(8)]
    bench.put(0x303, bytes.fromhex("F2090000"))
    bench.sync()
    assert bench.number(0x60FF) == 2546


def test_values_of_a_robot_replace_those_of_the_file_and_the_device_model_stays():
    objects = {(0x1018, 2): 1, (0x1018, 4): 77, (0x1F56, 1): 0x10002}
    node = make_device(TMCM, 3, objects=objects)
    assert {address: node.store.number(*address) for address in objects} == objects
    assert node.model is TMCM1270
    assert node.store.number(0x1F56) == 1
    assert not node.od[0x1F56, 1].writable
    node.store.defaults()
    assert node.store.number(0x1018, 4) == 77
    assert make_device(TMCM, 3).store.number(0x1018, 4) == 3


def test_a_number_that_the_file_lacks_is_counted_by_subindex_0():
    od = servo_od()
    od.add(entry(0x1018, 0, T.UNSIGNED8, 1))
    od.entries.pop((0x1018, 4), None)
    node = make_device(od, 5, objects={(0x1018, 4): 77})
    assert (node.store.number(0x1018), node.store.number(0x1018, 4)) == (4, 77)
    assert (0x1018, 4) not in od


def test_a_value_that_does_not_fit_is_refused():
    with pytest.raises(ConfigError, match="node 3: 0x6060:00 = 200 does not fit INTEGER8; give -128 to 127"):
        make_device(TMCM, 3, objects={(0x6060, 0): 200})
    with pytest.raises(ConfigError, match="node 3: 0x1008:00 is a VISIBLE_STRING, and only integers can be given"):
        make_device(TMCM, 3, objects={(0x1008, 0): 2})
