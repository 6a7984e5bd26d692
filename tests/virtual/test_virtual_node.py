from __future__ import annotations

import itertools
import struct
from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples
from support.virtualbench import MS, Bench, S, T, entry, ready_tmcm, servo, servo_od, tmcm

from canopen_control.cia301.lss import MASTER_COB_ID, UNCONFIGURED
from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia402.state import State, decode_statusword
from canopen_control.data_files import data_path
from canopen_control.frame import REMOTE_FLAG, CanFrame
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, ObjectDictionary
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_outbox import BitRateActivated, HeartbeatMissed, NodeIdChanged
from canopen_control.virtual.virtual_node import SYNC_LENGTH_ERROR, VirtualNode, merged

IDENTITY = (0x99, 0x1234, 0x10002, 77)


def bench(node_id=5, **kwargs):
    od = servo_od(node_id)
    od.device = replace(od.device, lss_supported=True, bit_rates=frozenset((125_000, 500_000)))
    return Bench(make_device(od, node_id, serial=77, **kwargs))


def lss(b, *data):
    """Send an LSS request; return the answers."""
    return [frame.data for frame in b.put(MASTER_COB_ID, bytes(data).ljust(8, b"\0")) if frame.can_id == 0x7E4]


def select(b):
    for part, number in enumerate(IDENTITY):
        answers = lss(b, 0x40 + part, *number.to_bytes(4, "little"))
    return answers


def boots(b):
    return [frame.can_id - 0x700 for _, frame in b.seen if frame.data == b"\0" and 0x700 < frame.can_id < 0x780]


def test_without_lss_supported_no_node_answers():
    od = servo_od(5)
    b = Bench(make_device(od, 5, serial=77))
    assert MASTER_COB_ID not in b.node.routes()
    assert select(b) == []


def test_it_is_selected_by_its_identity_and_confirms_this():
    b = bench()
    assert select(b) == [bytes((0x44,)).ljust(8, b"\0")]
    assert [int.from_bytes(lss(b, 0x5A + part)[0][1:5], "little") for part in range(4)] == list(IDENTITY)
    assert lss(b, 0x5E)[0][1] == 5


def test_a_new_node_id_counts_after_reset_communication_and_every_cob_id_follows():
    b = bench()
    select(b)
    assert lss(b, 0x11, 9)[0][1] == 0
    lss(b, 0x04, 0)
    assert b.number(0x1000) == 0x20192  # still node 5
    b.seen.clear()
    b.put(0, bytes((0x82, 5)))
    b.on(0.1)
    assert boots(b) == [9]
    assert b.node.node_id == 9
    assert b.number(0x1014) == 0x89
    assert b.number(0x1018, 4) == 77
    b.put(0, bytes((0x01, 9)))
    assert b.node.operational
    b.node.outbox.emergency(0x5441, 1)
    assert [frame.can_id for frame in b.node.frames()] == [0x089]
    assert NodeIdChanged(9) in b.events
    assert b.put(0x605, bytes.fromhex("4000100000000000")) == []


def test_without_store_the_node_id_is_gone_with_the_power_and_with_it_it_stays():
    b = bench()
    select(b)
    lss(b, 0x11, 9)
    b.node.power_on(b.now)
    b.on(0.1)
    assert b.node.node_id == 5
    select(b)
    lss(b, 0x11, 9)
    assert lss(b, 0x17)[0][1] == 0
    b.node.power_on(b.now)
    b.on(0.1)
    assert b.node.node_id == 9


def test_a_store_that_fails_is_reported():
    b = bench()
    b.node.keeper = SimpleNamespace(keep=lambda _node: False)
    select(b)
    lss(b, 0x11, 9)
    assert lss(b, 0x17)[0][1] == 2
    assert b.node.lss.stored_node_id == 5


def test_a_node_without_an_id_is_silent_until_fast_scan_and_a_node_id_make_it_boot():
    b = bench(UNCONFIGURED)
    b.on(10)
    assert b.seen == []
    assert list(b.node.routes()) == [MASTER_COB_ID]
    assert b.put(0, bytes((0x01, 0))) == []
    assert lss(b, 0x4C) == [bytes((0x50,)).ljust(8, b"\0")]
    assert lss(b, 0x51, 0, 0, 0, 0, 0x80, 0, 0)[0][0] == 0x4F
    for part, number in enumerate(IDENTITY):
        following = part + 1 if part < 3 else 0
        for bit in range(31, -1, -1):
            shown = number >> bit << bit
            nxt = following if bit == 0 else part
            assert lss(b, 0x51, *shown.to_bytes(4, "little"), bit, part, nxt)[0][0] == 0x4F
    assert lss(b, 0x11, 12)[0][1] == 0
    b.seen.clear()
    lss(b, 0x04, 0)
    b.on(0.1)
    assert boots(b) == [12]
    b.start()
    b.enable(3)
    b.write(0x60FF, 1000)
    b.on(1)
    assert b.velocity == 1000


def test_bit_rates_are_those_of_the_file_and_a_change_is_reported():
    b = bench()
    select(b)
    assert lss(b, 0x13, 0, 2)[0][1] == 0  # 500 kbit/s
    assert lss(b, 0x13, 0, 3)[0][1] == 1  # 250 is not in the file
    b.node.receive(CanFrame(MASTER_COB_ID, bytes.fromhex("156400").ljust(8, b"\0")), b.now)
    b.collect()
    assert BitRateActivated(500_000) in b.events


def test_each_identifier_has_its_receiver_and_two_of_one_both_receive_in_order():
    received = []
    routes = [(1, lambda f, now: received.append("a")), (2, lambda f, now: received.append("b"))]
    table = merged([*routes, (1, lambda f, now: received.append("c"))])
    assert table.keys() == {1, 2}
    table[1](CanFrame(1, b""), 0)
    assert received == ["a", "c"]
    table[2](CanFrame(2, b""), 0)
    assert received == ["a", "c", "b"]


def test_a_version_reports_that_the_identifiers_changed_and_only_that():
    bench = Bench(tmcm())
    before = bench.node.routing.version
    bench.write(0x1016, 127 << 16 | 1000, 1)
    assert (bench.node.routing.version > before, 0x77F in bench.node.routes()) == (True, True)
    before = bench.node.routing.version
    bench.write(0x1016, 127 << 16 | 900, 1)
    assert bench.node.routing.version == before


def test_a_stopped_node_receives_neither_sdo_nor_sync():
    bench = Bench(tmcm())
    bench.nmt(NmtCommand.STOP)
    assert bench.read(0x1000) is None
    bench.put(0x080, b"12345678")
    assert SYNC_LENGTH_ERROR not in bench.node.emcy.active
    bench.start()
    bench.put(0x080, b"12345678")
    assert SYNC_LENGTH_ERROR in bench.node.emcy.active
    bench.put(0x080)
    assert SYNC_LENGTH_ERROR not in bench.node.emcy.active


def texts(frames):
    return [str(frame) for frame in frames]


def test_it_boots_with_the_boot_up_message_into_pre_operational():
    bench = Bench(tmcm())
    assert texts(frame for _, frame in bench.seen) == ["703#00"]
    assert bench.node.nmt.state is NmtState.PRE_OPERATIONAL


def test_it_identifies_itself_with_its_node_id_as_serial_number():
    bench = Bench(tmcm(7))
    assert [bench.number(0x1018, sub) for sub in (1, 2, 3, 4)] == [0x286, 0x4F6, 0x0003001A, 7]
    assert bench.read(0x1008) == b"TMCM-1270"
    assert bench.number(0x1014) == 0x87
    assert bench.number(0x1400, 1) == 0x40000207


def test_a_file_without_the_device_type_makes_a_device_that_has_it():
    od = servo_od()
    del od.entries[0x1000, 0], od.objects[0x1000]
    assert Bench(VirtualNode(od, 5)).number(0x1000) == 0x00020192
    assert (0x1000, 0) not in od


@pytest.mark.parametrize(
    ("command", "state"), [(NmtCommand.START, 5), (NmtCommand.STOP, 4), (NmtCommand.ENTER_PRE_OPERATIONAL, 0x7F)]
)
def test_it_obeys_nmt_and_shows_it_in_its_heartbeat(command, state):
    bench = Bench(tmcm())
    bench.write(0x1017, 100)
    bench.nmt(command)
    bench.seen.clear()
    bench.on(0.3)
    beats = [(when, frame.data) for when, frame in bench.seen if frame.can_id == 0x703]
    assert {data for _, data in beats} == {bytes((state,))}
    assert len(beats) in (3, 4)
    assert all(b - a == 100 * MS for (a, _), (b, _) in itertools.pairwise(beats))


def test_commands_to_others_and_garbage_on_its_identifiers_change_nothing():
    bench = Bench(tmcm())
    for data in (b"\x01\x04", b"\x01", b"\x99\x03", b"", b"\x01\x03\x00"):
        bench.put(0, data)
    for can_id in (0x603, 0x703, 0x080, 0x203):
        bench.put(can_id, b"\x01\x02")
    assert bench.node.nmt.state is NmtState.PRE_OPERATIONAL
    assert bench.number(0x1000) == 0xFFFF0192


def test_stopped_it_answers_nothing_but_nmt_and_guarding():
    bench = Bench(tmcm())
    bench.nmt(NmtCommand.STOP)
    assert bench.read(0x1000) is None
    assert texts(bench.put(0x703 | REMOTE_FLAG, b"\0")) == ["703#04"]
    bench.nmt(NmtCommand.START)
    assert bench.number(0x1000) == 0xFFFF0192


def test_reset_node_restores_all_values_and_reset_communication_those_of_the_communication():
    bench = Bench(tmcm())
    bench.write(0x1017, 500)
    bench.write(0x6083, 16000)
    bench.seen.clear()
    bench.nmt(NmtCommand.RESET_COMMUNICATION)
    bench.on(0.1)
    assert texts(frame for _, frame in bench.seen) == ["703#00"]
    assert (bench.number(0x1017), bench.number(0x6083)) == (0, 16000)
    bench.nmt(NmtCommand.RESET_NODE)
    bench.on(0.1)
    assert bench.number(0x6083) == 0


def test_the_boot_up_comes_some_time_after_a_reset():
    bench = Bench(tmcm())
    assert bench.nmt(NmtCommand.RESET_NODE) == []
    assert bench.read(0x1000) is None
    bench.on(0.02)
    assert bench.number(0x1000) == 0xFFFF0192


# -- a lost master


def watching(mode, **kwargs):
    bench = ready_tmcm()
    bench.write(0x60FF, 2546)
    bench.write(0x1029, mode, 1)
    bench.write(0x1016, 0x000101F4, 1)
    bench.put(0x701, b"\x05")
    bench.on(0.4)
    assert bench.velocity == 2546
    bench.put(0x701, b"\x05")
    bench.seen.clear()
    return bench


def test_a_silent_master_with_1029_2_stops_the_tmcm_1270_along_its_ramp():
    bench = watching(2)
    bench.on(0.499)
    assert bench.drive.mover.plant.velocity == 2546
    bench.on(0.002)
    assert bench.node.nmt.state is NmtState.STOPPED
    assert bench.state == "FAULT_REACTION_ACTIVE"
    bench.on(2546 / 16000)
    assert (bench.drive.mover.plant.velocity, bench.state) == (0, "FAULT")
    assert texts(frame for _, frame in bench.seen if frame.can_id == 0x83) == ["083#30811100FF000000"]


def test_a_silent_master_with_1029_0_leaves_it_pre_operational_and_turning():
    bench = watching(0)
    bench.on(5)
    assert bench.node.nmt.state is NmtState.PRE_OPERATIONAL
    assert bench.drive.mover.plant.velocity == 2546
    assert bench.state == "OPERATION_ENABLED"


def test_a_master_that_is_received_again_takes_the_error_back():
    bench = watching(1)
    bench.on(1)
    assert bench.number(0x1001) == 0x11
    bench.put(0x701, b"\x05")
    assert bench.number(0x1001) == 0
    assert [event.missed for event in bench.events if isinstance(event, HeartbeatMissed)] == [True, False]


def test_with_0x6007_the_axis_reacts_by_itself():
    bench = Bench(servo(x6007=3)).enable(3)
    bench.write(0x60FF, 1000)
    bench.write(0x1016, 0x00010064, 1)
    bench.put(0x701, b"\x05")
    bench.on(1)
    assert (bench.velocity, bench.state) == (0, "SWITCH_ON_DISABLED")
    assert bench.node.nmt.state is NmtState.OPERATIONAL  # 1029:1 is 1


def test_two_entries_for_one_node_are_refused_and_clearing_one_ends_the_watch():
    bench = Bench(servo())
    bench.write(0x1016, 0x00010064, 1)
    assert bench.abort_of(0x1016, 0x000100C8, 2) == 0x06040043
    bench.put(0x701, b"\x05")
    bench.on(1)
    assert bench.number(0x1001) == 0x11
    bench.write(0x1016, 0, 1)
    assert bench.number(0x1001) == 0


def test_guarding_answers_with_a_toggle_and_detects_a_silent_master():
    bench = Bench(servo())
    bench.write(0x100C, 100)
    bench.write(0x100D, 3)
    assert [texts(bench.put(0x705 | REMOTE_FLAG, b"\0")) for _ in range(3)] == [["705#7F"], ["705#FF"], ["705#7F"]]
    bench.on(0.299)
    assert bench.number(0x1001) == 0
    bench.on(0.002)
    assert bench.number(0x1001) == 0x11


# -- errors


def test_history_and_register_and_their_clearing():
    bench = Bench(servo())
    bench.node.outbox.emergency(0x4310, 8)
    bench.node.outbox.emergency(0x3210, 4)
    assert (bench.number(0x1003), bench.number(0x1003, 1), bench.number(0x1003, 2)) == (2, 0x3210, 0x4310)
    assert bench.number(0x1001) == 0x0D
    assert bench.abort_of(0x1003, 1) == 0x06090030
    bench.write(0x1003, 0)
    assert bench.number(0x1003) == 0
    bench.node.outbox.clear_error(0x4310)
    assert bench.number(0x1001) == 0x05


def test_the_emcy_identifier_may_move_only_while_invalid_and_inhibit_spaces_messages():
    bench = Bench(servo())
    assert bench.abort_of(0x1014, 0x0A5) == 0x06090030
    bench.write(0x1014, 0x80000085)
    bench.write(0x1014, 0x000000A5)
    bench.write(0x1015, 100)  # 10 ms
    bench.seen.clear()
    for code in (0x4310, 0x3210):
        bench.node.outbox.emergency(code, 1)
        bench.collect()
    bench.on(0.1)
    assert [(when - bench.seen[0][0], frame.can_id) for when, frame in bench.seen] == [(0, 0xA5), (10 * MS, 0xA5)]


def test_a_sync_of_the_wrong_length_is_reported_and_still_counts():
    bench = Bench(servo())
    bench.start()
    bench.seen.clear()
    bench.put(0x080, b"\x01")
    assert texts(frame for _, frame in bench.seen)[0].startswith("085#4082")
    assert any(frame.can_id == 0x185 for _, frame in bench.seen)


# -- storing


def test_storing_needs_its_signature_and_survives_a_reset():
    bench = Bench(servo())
    stored = []
    bench.node.keeper = SimpleNamespace(keep=lambda _node: stored.append(True) or True)
    bench.write(0x6083, 777)
    assert bench.abort_of(0x1010, 0x12345678, 1) == 0x08000020
    bench.write(0x1010, 0x65766173, 1)
    bench.write(0x6083, 888)
    bench.nmt(NmtCommand.RESET_NODE)
    bench.on(0.1)
    assert bench.number(0x6083) == 777
    bench.write(0x1011, 0x64616F6C, 1)
    assert bench.number(0x6083) == 777  # until the reset
    bench.nmt(NmtCommand.RESET_NODE)
    bench.on(0.1)
    assert (bench.number(0x6083), stored) == (10000, [True, True])


def test_a_group_stores_only_its_own():
    bench = Bench(servo())
    bench.write(0x1017, 100)
    bench.write(0x6083, 777)
    bench.write(0x1010, 0x65766173, 3)  # the profile's
    bench.nmt(NmtCommand.RESET_NODE)
    bench.on(0.2)
    assert (bench.number(0x1017), bench.number(0x6083)) == (0, 777)


def test_it_starts_by_itself_where_its_dictionary_reports_this():
    od = servo_od()
    od.add(entry(0x1F80, 0, T.UNSIGNED32, 0))
    assert Bench(make_device(od, 5)).node.operational
    od.add(entry(0x1F80, 0, T.UNSIGNED32, 4))
    assert not Bench(make_device(od, 5)).node.operational


def test_a_dictionary_without_a_drive_is_a_plain_node():
    od = ObjectDictionary(node_id=9)
    od.add(entry(0x1000, 0, T.UNSIGNED32, 0x191))
    od.add(entry(0x6200, 1, T.UNSIGNED8, 0, mapped=True))
    bench = Bench(make_device(od, 9))
    bench.write(0x6200, 0x55, 1)
    assert bench.number(0x6200, 1) == 0x55
    assert bench.node.drives == {}


# -- for arbitrary frames it keeps running, answers, and moves only when permitted

WORDS = st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x1F, 0x3F, 0x80, 0x8F, 0x010F, 0x0B])
SDO_WRITE = st.tuples(
    st.sampled_from(
        [0x6040, 0x6060, 0x60FF, 0x607A, 0x6083, 0x605A, 0x1016, 0x1029, 0x1017, 0x1400, 0x1A00, 0x6071, 0x6098]
    ),
    st.integers(0, 2),
    st.integers(0, 0xFFFFFFFF),
    st.sampled_from([1, 2, 4]),
)
STEPS = st.one_of(
    st.tuples(st.just("frame"), st.integers(0, 0x7FF), st.binary(max_size=8)),
    st.tuples(st.just("sdo"), SDO_WRITE),
    st.tuples(st.just("raw sdo"), st.binary(min_size=8, max_size=8)),
    st.tuples(st.just("nmt"), st.sampled_from(list(NmtCommand))),
    st.tuples(st.just("word"), WORDS),
    st.tuples(st.just("mode"), st.integers(-2, 11)),
    st.tuples(st.just("target"), st.integers(-(2**31), 2**31 - 1)),
    st.tuples(st.just("sync")),
    st.tuples(st.just("wait"), st.integers(1, 2 * S)),
)
ENABLE = [("nmt", NmtCommand.START), ("word", 0x06), ("word", 0x07), ("word", 0x0F)]


def act(bench, step):
    kind, *rest = step
    if kind == "frame":
        bench.put(rest[0], rest[1])
    elif kind == "sdo":
        index, sub, value, size = rest[0]
        bench.put(0x605, struct.pack("<BHB", {1: 0x2F, 2: 0x2B, 4: 0x23}[size], index, sub) + struct.pack("<I", value))
    elif kind == "raw sdo":
        bench.put(0x605, rest[0])
    elif kind == "nmt":
        bench.nmt(rest[0])
    elif kind == "word":
        bench.put(0x205, struct.pack("<Hb", rest[0], bench.drive.modes.number))
    elif kind == "mode":
        bench.put(0x205, struct.pack("<Hb", bench.drive.power.controlword, rest[0]))
    elif kind == "target":
        bench.put(0x305, struct.pack("<ii", rest[0], rest[0] // 1000))
    elif kind == "sync":
        bench.sync()
    else:
        bench.to(bench.now + rest[0])


def may_move(states):
    """Tell, from the states that were seen, whether the reference lets the motor move."""
    return bool(states & {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE})


@pytest.mark.rest
@settings(max_examples=examples(150))
@given(st.lists(STEPS, max_size=25), st.booleans(), st.integers(0, 3))
def test_random_frames_never_crash_it_and_move_it_only_in_operation(steps, enabled, option):
    bench = Bench(servo(x6007=option))
    bench.write(0x6060, 3)
    was_operational_when_enabled = False
    for step in [*ENABLE, *steps] if enabled else steps:
        before = bench.drive.mover.plant.position
        observed = {bench.drive.state}
        enabled_before = State.OPERATION_ENABLED in observed
        operational_before = bench.node.operational
        act(bench, step)
        observed |= {
            decode_statusword(bench.statusword),
            *(e.state for e in bench.events if hasattr(e, "axis") and hasattr(e, "state")),
        }
        bench.events.clear()
        if bench.drive.mover.plant.position != before:
            assert may_move(observed)
        # Operation begins only while OPERATIONAL; what turns outside of it was turning before.
        if bench.drive.state is State.OPERATION_ENABLED and not enabled_before:
            was_operational_when_enabled = operational_before or bench.node.operational
            assert was_operational_when_enabled
        if bench.drive.mover.plant.velocity and not bench.node.operational:
            assert was_operational_when_enabled
    # Whatever happened, one command makes it talk again.
    bench.to(bench.now + 5 * S)
    bench.put(0x605, b"\x80" + bytes(7))
    bench.nmt(NmtCommand.RESET_NODE)
    bench.to(bench.now + S)
    assert bench.number(0x1000) == 0x20192
    assert bench.drive.mover.plant.velocity == 0


@pytest.mark.rest
@settings(max_examples=examples(60))
@given(st.lists(st.binary(min_size=8, max_size=8), max_size=12))
def test_no_sdo_frame_leaves_it_unable_to_answer(requests):
    bench = Bench(tmcm())
    for data in requests:
        bench.put(0x603, data)
    bench.put(0x603, b"\x80" + bytes(7))
    bench.put(0x603, CanFrame(0x603, b"\x40\x00\x10\x00" + bytes(4)).data)
    assert bench.seen[-1][1].data == bytes.fromhex("430010009201FFFF")


def test_a_clock_may_start_at_zero():
    bench = Bench(servo(), start=0)
    bench.node.tick(0)
    bench.node.tick(0)
    assert texts(bench.node.frames()) == []
    assert bench.number(0x1000) == 0x20192


def test_unfetched_items_are_bounded():
    node = servo()
    node.tick(S)
    for _ in range(1500):
        node.outbox.publish(object())
        node.outbox.send(CanFrame(0x123))
    assert len(node.events()) == 1000
    assert len(node.frames()) == 1001


UNSIGNED = {
    (0x60FF, 0): (DataType.UNSIGNED32, DataType.INTEGER32),
    (0x6064, 0): (DataType.UNSIGNED32, DataType.INTEGER32),
    (0x6060, 0): (DataType.UNSIGNED8, DataType.INTEGER8),
    (0x6071, 0): (DataType.UNSIGNED16, DataType.INTEGER16),
    (0x6041, 0): (DataType.UNSIGNED16, DataType.UNSIGNED16),
    (0x6081, 0): (DataType.UNSIGNED32, DataType.UNSIGNED32),
}


def test_a_drive_whose_file_has_unsigned_set_points_uses_signed_ones():
    """0x60FF as UNSIGNED32, as in one CiA 402 file in twenty: the drive ran at full speed at a negative velocity."""
    od = read_eds(data_path("eds", "generic_cia402.eds"), 5).od
    entries = {
        address: replace(od[address], data_type=file, default=0xFF, low=0, high=file.maximum)
        for address, (file, _) in UNSIGNED.items()
    }
    node = make_device(replace(od, entries=od.entries | entries), 5)
    for address, (file, used) in UNSIGNED.items():
        entry = node.od[address]
        assert entry.data_type is used, address
        assert (entry.low, entry.high) == ((0, file.maximum) if used is file else (None, None))
    assert (node.od[0x6060, 0].default, node.od[0x60FF, 0].default) == (-1, 0xFF)
    digital = replace(od, entries={address: entry for address, entry in od.entries.items() if address != (0x6040, 0)})
    assert (
        make_device(replace(digital, entries=digital.entries | entries), 5).od[0x60FF, 0].data_type
        is DataType.UNSIGNED32
    )
