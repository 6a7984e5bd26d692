from __future__ import annotations

from support.virtualbench import Bench, ready_tmcm, servo_od, tmcm

from canopen_control.virtual.tmcm1270 import TMCM1270, is_tmcm1270

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
