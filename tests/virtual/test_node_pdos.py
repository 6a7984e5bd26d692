from __future__ import annotations

import dataclasses
import json
import struct
from pathlib import Path

import pytest
from support.virtualbench import MS, Bench, T, entry, servo, servo_od, tmcm

from canopen_control.cia301.emcy import EmcyConsumer
from canopen_control.cia301.nmt import NmtCommand
from canopen_control.cia301.pdo import MappedObject, PdoCodec
from canopen_control.frame import REMOTE_FLAG, CanFrame
from canopen_control.virtual.device import make_device
from canopen_control.virtual.fault_table import FaultSwitches
from canopen_control.virtual.node_pdos import MappedTpdo, RpdoInput, axis_writes_of

FRAMES = [CanFrame(0x203, bytes((n,))) for n in range(10)]


@pytest.fixture
def bench():
    return Bench(servo())


def heard(input_, times=(), ticks=()):
    observed = []
    take = input_.receiver(lambda frame, now: observed.append((frame.data[0], now)))
    for frame, now in zip(FRAMES, times or range(10), strict=True):
        take(frame, now)
    for now in ticks:
        input_.tick(now)
    return observed


def test_healthy_it_hands_all_on_at_once():
    assert heard(RpdoInput()) == [(n, n) for n in range(10)]
    assert RpdoInput().next_deadline() is None


def test_late_ones_come_in_their_order_when_they_are_due():
    late = RpdoInput()
    late.delay_ns.inject(100)
    observed = heard(late, ticks=(99, 104, 300))
    assert observed == [(n, 104 if n < 5 else 300) for n in range(10)]
    assert late.next_deadline() is None


def test_what_is_on_its_way_when_the_fault_ends_still_comes():
    late = RpdoInput()
    late.delay_ns.inject(100)
    heard(late)
    late.delay_ns.clear()
    assert late.next_deadline() == 100
    assert [n for n, _ in heard(late)] == list(range(10))


def test_one_of_so_many_is_lost():
    lossy = RpdoInput()
    lossy.lost.inject(5)
    assert [n for n, _ in heard(lossy)] == [0, 1, 2, 3, 5, 6, 7, 8]


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
def test_a_generic_drive_takes_both_for_its_tpdos_whatever_its_file_specifies(default, written):
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


WORD, TARGET, MODE = (entry(index, 0, T.UNSIGNED16) for index in (0x6040, 0x60FF, 0x6060))
SECOND = entry(0x6840, 0, T.UNSIGNED16)


def test_an_rpdo_concerns_each_axis_once_with_all_its_objects():
    axes = {0: "first", 1: "second"}
    assert axis_writes_of((TARGET, None, SECOND, WORD), axes) == (
        ("first", True, {0x60FF, 0x6040}),
        ("second", True, {0x6040}),
    )


def test_an_object_that_is_not_an_axis_s_or_of_an_axis_that_is_not_there_leaves_none():
    assert axis_writes_of((WORD, entry(0x2000, 0, T.UNSIGNED8)), {0: "first"}) == ()
    assert axis_writes_of((WORD, SECOND), {0: "first"}) == ()


def test_a_tpdo_reports_which_of_its_objects_have_changed_since_it_was_sampled():
    values = [1, 2]
    tpdo = MappedTpdo(0)
    tpdo.codec = PdoCodec([MappedObject(0x6041, 0, 16, T.UNSIGNED16), MappedObject(0x6061, 0, 16, T.UNSIGNED16)])
    tpdo.sources = (lambda: values[0], lambda: values[1])
    tpdo.mapped = ((0x6041, 0), (0x6061, 0))
    before = tpdo.sample()
    values[1] = 3
    assert tpdo.sample() == b"\x01\0\x03\0"
    assert tpdo.changed_since(before) == [(0x6061, 0)]


def test_a_value_too_wide_for_its_place_leaves_a_tpdo_of_zeros():
    tpdo = MappedTpdo(0)
    tpdo.codec, tpdo.sources = PdoCodec([MappedObject(0x6041, 0, 16, T.UNSIGNED16)]), (lambda: 1 << 20,)
    assert tpdo.sample() == b"\0\0"


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


def test_no_pdo_outside_operational(bench):
    bench.sync()
    bench.put(0x205, b"\x06\0\x03")
    assert sent(bench, 0x185) == []
    assert bench.state == "SWITCH_ON_DISABLED"
    bench.start()
    bench.sync()
    assert len(sent(bench, 0x185)) == 1
    bench.put(0x205, b"\x06\0\x03")
    assert (bench.state, bench.drive.modes.number) == ("READY_TO_SWITCH_ON", 3)


def test_an_rpdo_is_applied_whole_before_its_controlword_is_looked_at(bench):
    bench.start()
    remap(bench, 0, [0x60400010, 0x607A0020], rpdo=True)
    bench.write(0x6060, 1)
    for word in (6, 7, 15):
        bench.put(0x205, struct.pack("<Hi", word, 0))
    bench.put(0x205, struct.pack("<Hi", 0x1F, 400))  # the edge comes before its target in the frame
    bench.on(2)
    assert bench.position == 400


def test_a_synchronous_rpdo_waits_for_sync_and_its_reaction_shows_one_sync_later(bench):
    remap(bench, 0, [0x60400010, 0x60600008], rpdo=True, kind=1)
    bench.start()
    bench.put(0x205, b"\x06\0\x03")
    assert bench.state == "SWITCH_ON_DISABLED"
    bench.sync()
    assert bench.state == "READY_TO_SWITCH_ON"
    assert sent(bench, 0x185)[-1][0] & 0x6F == 0x40
    bench.sync()
    assert sent(bench, 0x185)[-1][0] & 0x6F == 0x21


def test_short_rpdos_are_dropped_and_reported_and_long_ones_cut_and_reported(bench):
    bench.start()
    bench.put(0x205, b"\x06\0")
    assert bench.state == "SWITCH_ON_DISABLED"
    assert sent(bench, 0x085)[0][:2] == b"\x10\x82"
    bench.put(0x205, b"\x06\0\x03\xff")
    assert bench.state == "READY_TO_SWITCH_ON"
    assert sent(bench, 0x085)[1][:2] == b"\x20\x82"


def truth(bench):
    """Return what the frames, 0x1001 and a listener say of errors that last."""
    listener = EmcyConsumer(bench.node.node_id)
    for data in sent(bench, 0x080 + bench.node.node_id):
        listener.receive(CanFrame(0x080 + bench.node.node_id, data), 0)
    assert listener.register == bench.number(0x1001)
    assert bool(listener.active) == bool(bench.number(0x1001))
    return listener.active


@pytest.mark.parametrize(
    ("wrong", "right", "code"),
    [
        ((0x205, b"\x06\0"), (0x205, b"\x06\0\0"), 0x8210),
        ((0x205, b"\x06\0\0\0"), (0x205, b"\x06\0\0"), 0x8220),
        ((0x080, b"\x01"), (0x080, b""), 0x8240),
    ],
)
def test_a_wrong_length_is_an_error_until_the_right_one_comes(bench, wrong, right, code):
    bench.start()
    for _ in range(3):
        bench.put(*wrong)
    assert truth(bench) == (code,)
    assert bench.number(0x1001) == 0x11
    assert (bench.number(0x1003), bench.number(0x1003, 1)) == (1, code)
    bench.put(*right)
    assert truth(bench) == ()
    bench.put(*wrong)
    assert truth(bench) == (code,)


def test_the_error_stays_while_another_rpdo_is_wrong_and_goes_with_a_new_mapping_and_a_reset(bench):
    bench.start()
    bench.put(0x205, b"")
    bench.put(0x305, b"")
    bench.put(0x205, b"\x06\0\0")
    assert truth(bench) == (0x8210,)
    remap(bench, 1, [0x60FF0020], rpdo=True)
    assert truth(bench) == ()
    bench.put(0x205, b"")
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    bench.on(1)
    assert bench.number(0x1001) == 0


def test_a_deadline_missed_is_an_error_until_data_come(bench):
    bench.write(0x1400, 100, 5)
    bench.start()
    bench.put(0x205, b"\0\0\0")
    bench.on(0.2)
    assert truth(bench) == (0x8250,)
    bench.put(0x205, b"\0\0\0")
    assert truth(bench) == ()


def test_a_refused_value_leaves_its_object_and_the_rest_of_the_rpdo_counts():
    bench = Bench(tmcm())
    bench.start()
    bench.put(0x303, b"\x06\0\x09")  # CSV, which this device does not have
    assert (bench.state, bench.drive.modes.number) == ("READY_TO_SWITCH_ON", 0)
    assert sent(bench, 0x083) == [bytes.fromhex("20630100FF000000")]
    assert bench.number(0x1001) == 1
    assert bench.node.pdos.refused == 1


def test_an_rpdo_that_repeats_itself_takes_back_what_sdo_has_written_meanwhile(bench):
    bench.start()
    remap(bench, 0, [0x60400010, 0x60FF0020], rpdo=True)
    same = struct.pack("<Hi", 6, 400)
    for _ in range(3):
        bench.put(0x205, same)
    bench.write(0x60FF, 100)
    assert bench.number(0x60FF) == 100
    bench.put(0x205, same)
    assert bench.number(0x60FF) == 400


def test_a_repeated_rpdo_is_still_limited_by_a_fault(bench):
    bench.start()
    remap(bench, 0, [0x60400010, 0x60FF0020], rpdo=True)
    same = struct.pack("<Hi", 6, 400)
    bench.put(0x205, same)
    bench.put(0x205, same)
    bench.node.store.ceilings.inject({0x60FF: 50})
    bench.put(0x205, same)
    assert bench.number(0x60FF) == 50


def test_dummy_entries_are_gaps(bench):
    remap(bench, 0, [0x00060010, 0x60400010], rpdo=True)
    bench.start()
    bench.put(0x205, b"\xff\xff\x06\0")
    assert bench.state == "READY_TO_SWITCH_ON"


@pytest.mark.parametrize(("kind", "expected"), [(1, 6), (2, 3), (3, 2)])
def test_cyclic_tpdos_come_with_every_nth_sync(bench, kind, expected):
    bench.write(0x1800, kind, 2)
    bench.start()
    for _ in range(6):
        bench.sync()
    assert len(sent(bench, 0x185)) == expected


def test_an_acyclic_synchronous_tpdo_comes_after_a_change(bench):
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


def test_event_driven_tpdos_come_on_a_change_not_closer_than_the_inhibit_time(bench):
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


def test_an_event_timer_sends_what_did_not_change(bench):
    remap(bench, 0, [0x60410010], kind=255, s5=50)
    bench.start()
    bench.seen.clear()
    bench.on(0.5)
    assert len(sent(bench, 0x185)) == 10


def test_a_moving_motor_shows_in_an_event_driven_tpdo_and_a_standing_one_does_not(bench):
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


def test_a_remote_frame_asks_for_a_tpdo_of_type_253(bench):
    bench.write(0x1800, 253, 2)
    bench.start()
    bench.put(0x185 | REMOTE_FLAG, bytes(3))
    assert len(sent(bench, 0x185)) == 1


def test_the_default_pdos_of_the_tmcm_1270():
    bench = Bench(tmcm())
    bench.start()
    assert [str(frame) for _, frame in bench.seen][-2:] == ["183#5006", "283#500600"]
    bench.seen.clear()
    bench.sync()
    assert [str(frame) for _, frame in bench.seen] == ["383#500600000000"]
    bench.put(0x203, b"\x06\0")
    bench.put(0x303, b"\x07\0\x03")
    assert (bench.state, bench.drive.modes.number) == ("SWITCHED_ON", 3)
    bench.put(0x503, b"\x0f\0" + bytes(4))  # RPDO4 is off
    assert bench.state == "SWITCHED_ON"


def waiting_for_sync():
    bench = Bench(servo())
    remap(bench, 0, [0x60400010, 0x60600008], rpdo=True, kind=1)
    bench.start()
    return bench


def test_an_rpdo_that_only_waits_for_sync_is_held_and_counts_at_sync():
    bench = waiting_for_sync()
    assert bench.node.receive_sync_rpdo(CanFrame(0x205, b"\x06\0\x03"), bench.now + MS)
    assert (bench.node.clock.now, bench.node.frames()) == (bench.now + MS, [])
    assert bench.state == "SWITCH_ON_DISABLED"
    bench.now += MS
    bench.sync()
    assert bench.state == "READY_TO_SWITCH_ON"


@pytest.mark.parametrize("why", ["its length", "a wrong one before", "late", "lost", "a fault", "NMT"])
def test_an_rpdo_that_has_a_consequence_is_not_held(why):
    bench = waiting_for_sync()
    data, node = b"\x06\0\x03", bench.node
    if why == "its length":
        data = b"\x06\0"
    elif why == "a wrong one before":
        bench.put(0x205, b"\x06")
    elif why == "late":
        node.pdos.input.delay_ns.inject(MS)
    elif why == "lost":
        node.pdos.input.lost.inject(2)
    elif why == "a fault":
        FaultSwitches(node).set("silent", True, bench.now)
    else:
        bench.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert not node.receive_sync_rpdo(CanFrame(0x205, data), bench.now)
    assert not node.pdos.rpdos[0].consumer.holds
