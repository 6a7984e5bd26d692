from __future__ import annotations

import json
import struct
from pathlib import Path

import pytest
from support.virtualbench import MS, Bench, servo, servo_od, tmcm

from canopen_control.frame import REMOTE_FLAG
from canopen_control.virtual.device import make_device

VALID, INVALID, NO_RTR = 0, 1 << 31, 1 << 30


def sent(bench, can_id):
    return [frame.data for _, frame in bench.seen if frame.can_id == can_id]


def remap(bench, number, mapping, rpdo=False, kind=None, cob_id=None, **times):
    comm, record = (0x1400 + number, 0x1600 + number) if rpdo else (0x1800 + number, 0x1A00 + number)
    cob_id = bench.number(comm, 1) if cob_id is None else cob_id
    bench.write(comm, cob_id | INVALID, 1)
    bench.write(record, 0)
    for sub, item in enumerate(mapping, 1):
        bench.write(record, item, sub)
    bench.write(record, len(mapping))
    if kind is not None:
        bench.write(comm, kind, 2)
    for sub, value in times.items():
        bench.write(comm, value, int(sub[1:]))
    bench.write(comm, cob_id & ~INVALID, 1)


def test_the_remapping_procedure_of_the_vectors_is_taken_frame_by_frame():
    vectors = json.loads((Path(__file__).parents[1] / "data" / "virtual_remap.json").read_text())
    bench = Bench(tmcm())
    bench.write(0x1400, 0x40000203, 1)  # the vectors speak of a PDO that was 0x203
    frames = vectors["rpdo1_node3"]
    for request, answer in zip(frames[::2], frames[1::2], strict=True):
        identifier, data = request.split("#")
        assert [str(f) for f in bench.put(int(identifier, 16), bytes.fromhex(data))] == [answer]
    assert bench.number(0x1600) == 2


@pytest.mark.parametrize(
    ("index", "value", "sub", "code"),
    [
        (0x1A00, 0x60640020, 1, 0x06090030),  # an entry while valid
        (0x1A00, 0, 0, 0x06090030),  # the count while valid
        (0x1800, 0x400001A0, 1, 0x06090030),  # another identifier while valid
        (0x1800, 0x00000183, 1, 0x06090030),  # bit 30 cleared
        (0x1800, 245, 2, 0x06090030),  # a reserved type
        (0x1800, 10, 3, 0x06090030),  # the inhibit time while valid
        (0x1800, 0, 7, 0x06090011),  # no subindex
        (0x1800, 5, 0, 0x06010002),
    ],
)
def test_what_the_rules_forbid_has_its_abort_code(index, value, sub, code):
    bench = Bench(tmcm())
    size = {0: 1, 1: 4, 2: 1, 3: 2, 7: 1}[sub] if index == 0x1800 else None
    assert bench.abort_of(index, value, sub, size) == code


@pytest.mark.parametrize(
    ("rpdo", "mapping", "code"),
    [
        (False, [0x60400010], 0x06040041),  # an RPDO's object in a TPDO
        (True, [0x60410010], 0x06040041),
        (False, [0x60640010], 0x06040041),  # a part of it
        (False, [0x50000020], 0x06020000),
        (False, [0x607D0920], 0x06090011),
        (True, [0x00050008], 0x06040041),  # no dummy mapping on this device
        (False, [0x60640020, 0x606C0020, 0x60610008], 0x06040042),
    ],
)
def test_what_cannot_be_mapped_has_its_abort_code(rpdo, mapping, code):
    bench = Bench(tmcm())
    comm, record = (0x1400, 0x1600) if rpdo else (0x1800, 0x1A00)
    bench.write(comm, bench.number(comm, 1) | INVALID, 1)
    bench.write(record, 0)
    codes = [bench.abort_of(record, item, sub) for sub, item in enumerate(mapping, 1)]
    codes.append(bench.abort_of(record, len(mapping)))
    assert code in codes


def test_a_device_has_only_the_mapping_slots_of_its_file():
    bench = Bench(tmcm())
    bench.write(0x1800, bench.number(0x1800, 1) | INVALID, 1)
    bench.write(0x1A00, 0)
    assert bench.abort_of(0x1A00, 0x60410010, 4, 4) == 0x06090011
    assert bench.abort_of(0x1A00, 4, 0) == 0x06090031  # the file's HighLimit


def test_no_pdo_outside_operational():
    bench = Bench(servo())
    bench.sync()
    bench.put(0x205, b"\x06\0\x03")
    assert sent(bench, 0x185) == []
    assert bench.state == "SWITCH_ON_DISABLED"
    bench.start()
    bench.sync()
    assert len(sent(bench, 0x185)) == 1
    bench.put(0x205, b"\x06\0\x03")
    assert (bench.state, bench.drive.mode) == ("READY_TO_SWITCH_ON", 3)


def test_an_rpdo_is_applied_whole_before_its_controlword_is_looked_at():
    bench = Bench(servo())
    bench.start()
    remap(bench, 0, [0x60400010, 0x607A0020], rpdo=True)
    bench.write(0x6060, 1)
    for word in (6, 7, 15):
        bench.put(0x205, struct.pack("<Hi", word, 0))
    bench.put(0x205, struct.pack("<Hi", 0x1F, 400))  # the edge comes before its target in the frame
    bench.on(2)
    assert bench.position == 400


def test_a_synchronous_rpdo_waits_for_sync_and_its_reaction_shows_one_sync_later():
    bench = Bench(servo())
    remap(bench, 0, [0x60400010, 0x60600008], rpdo=True, kind=1)
    bench.start()
    bench.put(0x205, b"\x06\0\x03")
    assert bench.state == "SWITCH_ON_DISABLED"
    bench.sync()
    assert bench.state == "READY_TO_SWITCH_ON"
    assert sent(bench, 0x185)[-1][0] & 0x6F == 0x40
    bench.sync()
    assert sent(bench, 0x185)[-1][0] & 0x6F == 0x21


def test_short_rpdos_are_dropped_and_told_and_long_ones_cut_and_told():
    bench = Bench(servo())
    bench.start()
    bench.put(0x205, b"\x06\0")
    assert bench.state == "SWITCH_ON_DISABLED"
    assert sent(bench, 0x085)[0][:2] == b"\x10\x82"
    bench.put(0x205, b"\x06\0\x03\xff")
    assert bench.state == "READY_TO_SWITCH_ON"
    assert sent(bench, 0x085)[1][:2] == b"\x20\x82"


def test_a_refused_value_leaves_its_object_and_the_rest_of_the_rpdo_counts():
    bench = Bench(tmcm())
    bench.start()
    bench.put(0x303, b"\x06\0\x09")  # CSV, which this device does not have
    assert (bench.state, bench.drive.mode) == ("READY_TO_SWITCH_ON", 0)
    assert sent(bench, 0x083) == [bytes.fromhex("20630100FF000000")]
    assert bench.node.pdos.refused == 1


def test_dummy_entries_are_gaps():
    bench = Bench(servo())
    remap(bench, 0, [0x00060010, 0x60400010], rpdo=True)
    bench.start()
    bench.put(0x205, b"\xff\xff\x06\0")
    assert bench.state == "READY_TO_SWITCH_ON"


@pytest.mark.parametrize(("kind", "expected"), [(1, 6), (2, 3), (3, 2)])
def test_cyclic_tpdos_come_with_every_nth_sync(kind, expected):
    bench = Bench(servo())
    bench.write(0x1800, kind, 2)
    bench.start()
    for _ in range(6):
        bench.sync()
    assert len(sent(bench, 0x185)) == expected


def test_an_acyclic_synchronous_tpdo_comes_after_a_change():
    bench = Bench(servo())
    bench.write(0x1800, 0, 2)
    bench.start()
    bench.sync()
    bench.seen.clear()
    bench.sync()
    assert sent(bench, 0x185) == []
    bench.control(6)
    assert sent(bench, 0x185) == []
    bench.sync()
    assert len(sent(bench, 0x185)) == 1


def test_event_driven_tpdos_come_on_a_change_not_closer_than_the_inhibit_time():
    bench = Bench(servo())
    remap(bench, 0, [0x60410010], kind=255, s3=100)  # 10 ms
    bench.start()
    start = bench.now
    bench.seen.clear()
    bench.on(0.02)
    for word in (6, 7, 15):
        bench.control(word)
    bench.on(0.1)
    times = [when - start for when, frame in bench.seen if frame.can_id == 0x185]
    assert times == [20 * MS, 30 * MS]
    assert sent(bench, 0x185)[-1][0] & 0x6F == 0x27


def test_an_event_timer_sends_what_did_not_change():
    bench = Bench(servo())
    remap(bench, 0, [0x60410010], kind=255, s5=50)
    bench.start()
    bench.seen.clear()
    bench.on(0.5)
    assert len(sent(bench, 0x185)) == 10


def test_a_moving_motor_shows_in_an_event_driven_tpdo_and_a_standing_one_does_not():
    bench = Bench(servo())
    remap(bench, 1, [0x60640020, 0x606C0020], kind=255)
    bench.enable(3)
    bench.seen.clear()
    bench.on(1)
    assert sent(bench, 0x285) == []
    bench.write(0x60FF, 1000)
    bench.on(0.5)
    positions = [struct.unpack("<ii", data)[0] for data in sent(bench, 0x285)]
    assert len(positions) > 50
    assert positions == sorted(positions)
    bench.write(0x60FF, 0)
    bench.on(1)
    assert struct.unpack("<ii", sent(bench, 0x285)[-1]) == (bench.position, 0)


def test_a_remote_frame_asks_for_a_tpdo_of_type_253():
    bench = Bench(servo())
    bench.write(0x1800, 253, 2)
    bench.start()
    bench.put(0x185 | REMOTE_FLAG, bytes(3))
    assert len(sent(bench, 0x185)) == 1


def test_a_mapping_that_the_file_gets_wrong_maps_nothing():
    od = servo_od()
    bench = Bench(make_device(od, 5))
    bench.node.store.set(0x1A00, 1, 0x12340010)
    bench.node.pdos.configure(bench.now)
    bench.start()
    bench.sync()
    assert sent(bench, 0x185) == [b""]


def test_the_default_pdos_of_the_tmcm_1270():
    bench = Bench(tmcm())
    bench.start()
    assert [str(frame) for _, frame in bench.seen][-2:] == ["183#5006", "283#500600"]
    bench.seen.clear()
    bench.sync()
    assert [str(frame) for _, frame in bench.seen] == ["383#500600000000"]
    bench.put(0x203, b"\x06\0")
    bench.put(0x303, b"\x07\0\x03")
    assert (bench.state, bench.drive.mode) == ("SWITCHED_ON", 3)
    bench.put(0x503, b"\x0f\0" + bytes(4))  # RPDO4 is off
    assert bench.state == "SWITCHED_ON"
