from __future__ import annotations

import struct

import pytest
from support.virtualbench import MS, Bench, servo, tmcm

from canopen_control.cia301.emcy import EmcyConsumer
from canopen_control.cia301.nmt import NmtCommand
from canopen_control.frame import REMOTE_FLAG, CanFrame
from canopen_control.virtual.fault_table import FaultSwitches

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
    assert (bench.state, bench.drive.modes.number) == ("READY_TO_SWITCH_ON", 3)


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
def test_a_wrong_length_is_an_error_until_the_right_one_comes(wrong, right, code):
    bench = Bench(servo())
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


def test_the_error_stays_while_another_rpdo_is_wrong_and_goes_with_a_new_mapping_and_a_reset():
    bench = Bench(servo())
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


def test_a_deadline_missed_is_an_error_until_data_come():
    bench = Bench(servo())
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


def test_an_rpdo_that_repeats_itself_takes_back_what_sdo_has_written_meanwhile():
    bench = Bench(servo())
    bench.start()
    remap(bench, 0, [0x60400010, 0x60FF0020], rpdo=True)
    same = struct.pack("<Hi", 6, 400)
    for _ in range(3):
        bench.put(0x205, same)
    bench.write(0x60FF, 100)
    assert bench.number(0x60FF) == 100
    bench.put(0x205, same)
    assert bench.number(0x60FF) == 400


def test_an_rpdo_that_repeats_itself_still_sees_a_ceiling_that_a_fault_sets():
    bench = Bench(servo())
    bench.start()
    remap(bench, 0, [0x60400010, 0x60FF0020], rpdo=True)
    same = struct.pack("<Hi", 6, 400)
    bench.put(0x205, same)
    bench.put(0x205, same)
    bench.node.store.ceilings.break_with({0x60FF: 50})
    bench.put(0x205, same)
    assert bench.number(0x60FF) == 50


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
    assert bench.node.hold(CanFrame(0x205, b"\x06\0\x03"), bench.now + MS)
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
        node.pdos.input.delay_ns.break_with(MS)
    elif why == "lost":
        node.pdos.input.lost.break_with(2)
    elif why == "a fault":
        FaultSwitches(node).set("silent", True, bench.now)
    else:
        bench.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert not node.hold(CanFrame(0x205, data), bench.now)
    assert not node.pdos.rpdos[0].consumer.holds
