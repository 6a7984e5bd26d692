"""A virtual node's LSS, with raw frames; the service itself is tested with its core."""

from __future__ import annotations

from dataclasses import replace

from support.virtualbench import Bench, servo_od

from canopen_control.cia301.lss import MASTER_COB_ID, UNCONFIGURED
from canopen_control.frame import CanFrame
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_events import BitRateActivated, NodeIdChanged

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


def test_without_lss_supported_nobody_answers():
    od = servo_od(5)
    b = Bench(make_device(od, 5, serial=77))
    assert MASTER_COB_ID not in b.node.routes()
    assert select(b) == []


def test_it_is_selected_by_its_identity_and_tells_it():
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


def test_a_store_that_fails_is_said():
    b = bench()
    b.node.on_stored(lambda: False)
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


def test_bit_rates_are_those_of_the_file_and_a_change_is_told():
    b = bench()
    select(b)
    assert lss(b, 0x13, 0, 2)[0][1] == 0  # 500 kbit/s
    assert lss(b, 0x13, 0, 3)[0][1] == 1  # 250 is not in the file
    b.node.receive(CanFrame(MASTER_COB_ID, bytes.fromhex("156400").ljust(8, b"\0")), b.now)
    b.collect()
    assert BitRateActivated(500_000) in b.events
