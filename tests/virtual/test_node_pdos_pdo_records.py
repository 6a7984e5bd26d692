from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from support.virtualbench import Bench, servo_od, tmcm

from canopen_control.virtual.device import make_device

EDITS = Path(__file__).parents[1] / "data" / "eds_edits"
VALID, INVALID, NO_RTR = 0, 1 << 31, 1 << 30


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
        (0x1800, 0x40000283, 1, 0x06090030),  # the identifier of TPDO 2
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


@pytest.mark.parametrize("cob_id", [0, 0x001, 0x180, 0x583, 0x603, 0x703, 0x7E5, 0x080, 0x083, 0x283, 0x203])
def test_an_identifier_that_is_reserved_or_has_a_user_never_becomes_a_pdos(cob_id):
    bench = Bench(tmcm())
    bench.write(0x1800, 0x40000183 | INVALID, 1)
    assert bench.abort_of(0x1800, cob_id, 1, 4) == 0x06090030
    bench.start()
    bench.sync()
    assert not [frame for _, frame in bench.seen if frame.can_id == cob_id and len(frame.data) == 2]


def test_the_drive_of_the_tutorial_takes_a_cob_id_with_bit_30_cleared():
    """What dcfgen makes of `cob_id: auto`, which real TMCM-1270 take (public robby)."""
    bench = Bench(tmcm())
    for index, cob_id in ((0x1800, 0x183), (0x1801, 0x283)):
        bench.write(index, 0x40000000 | cob_id | INVALID, 1)
        bench.write(index, cob_id, 1)
        assert bench.number(index, 1) == cob_id


@pytest.mark.parametrize("name", ["nocob", "sync0"])
def test_a_file_without_a_cob_id_makes_a_device_without_that_service(name):
    device = make_device(EDITS / f"{name}.eds", 5)
    bench = Bench(device)
    bench.start()
    bench.sync()
    assert 0x000 not in {frame.can_id for _, frame in bench.seen}
    if name == "nocob":
        assert {number for number, pdo in device.pdos.tpdos.items() if not pdo.producer.parameters.enabled} >= {3}
    else:
        assert 0x080 not in device.routing.table
        bench.write(0x1005, 0x80)
        assert 0x080 in device.routing.table


def test_of_two_default_pdos_with_one_identifier_the_second_waits_for_the_first():
    od = servo_od(5)
    first, second = od.entries[0x1800, 1], od.entries[0x1801, 1]
    od.entries[0x1801, 1] = dataclasses.replace(second, default=first.default)
    device = make_device(od, 5)
    bench = Bench(device)
    enabled = lambda: [device.pdos.tpdos[number].producer.parameters.enabled for number in (0, 1)]  # noqa: E731
    bench.start()
    assert enabled() == [True, False]
    bench.write(0x1800, first.default | INVALID, 1)
    assert enabled() == [False, True]


@pytest.mark.parametrize("written", [0x00000203, 0x40000203])
def test_bit_30_of_an_rpdo_is_taken_and_kept_and_means_nothing(written):
    bench = Bench(tmcm())
    bench.write(0x1400, written | INVALID, 1)
    bench.write(0x1400, written, 1)
    assert bench.number(0x1400, 1) == written
    bench.start()
    bench.put(0x203, b"\x06\x00")
    assert bench.state == "READY_TO_SWITCH_ON"


@pytest.mark.parametrize("default", [0x40000185, 0x185])
@pytest.mark.parametrize("written", [0x40000185, 0x185])
def test_a_generic_drive_takes_both_for_its_tpdos_whatever_its_file_says(default, written):
    od = servo_od(5)
    od.entries[0x1800, 1] = dataclasses.replace(od.entries[0x1800, 1], default=default)
    bench = Bench(make_device(od, 5))
    bench.write(0x1800, written | INVALID, 1)
    bench.write(0x1800, written, 1)
    assert bench.number(0x1800, 1) == written
    assert bench.abort_of(0x1800, 253, 2) == (0x06090030 if written & NO_RTR else None)


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


def test_a_mapping_that_the_file_gets_wrong_maps_nothing():
    od = servo_od()
    bench = Bench(make_device(od, 5))
    bench.node.store.set(0x1A00, 1, 0x12340010)
    bench.node.pdos.configure(bench.now)
    bench.start()
    bench.sync()
    assert [frame.data for _, frame in bench.seen if frame.can_id == 0x185] == [b""]
