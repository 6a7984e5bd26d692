from __future__ import annotations

from support.virtualbench import Bench, ready_tmcm, servo_od, tmcm

from canopen_control.virtual.device import TMCM1270, is_tmcm1270

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
