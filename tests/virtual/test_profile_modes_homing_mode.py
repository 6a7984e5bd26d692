from __future__ import annotations

import pytest
from support.virtualbench import REACHED, Bench, ready_tmcm, servo, tmcm

from canopen_control.virtual.profile_modes import METHODS

ATTAINED, ERROR = 1 << 12, 1 << 13
BITS = REACHED | ATTAINED | ERROR
# Where home is with the standard rig: limits at -50000 and 50000, the home switch 10000 to 12000, an index pulse
# every 4096; written down from the pictures of the standard, not from the code.
HOMES = {
    1: -49152, 2: 49152, 3: 8192, 4: 12288, 5: 12288, 6: 8192, 7: 8192, 8: 12288, 9: 8192, 10: 12288,
    11: 12288, 12: 8192, 13: 12288, 14: 8192,
    17: -50000, 18: 50000, 19: 10000, 20: 10000, 21: 12000, 22: 12000, 23: 10000, 24: 10000, 25: 12000, 26: 12000,
    27: 12000, 28: 12000, 29: 10000, 30: 10000, 33: -4096, 34: 4096, 35: 0, 37: 0,
}  # fmt: skip


def homing(method, offset=0, start=0.0, **kwargs):
    bench = Bench(servo(x6098=method, x607C=offset, **kwargs)).enable(6)
    bench.drive.mover.displace(start, bench.now)
    return bench


def run(bench, seconds=60):
    assert bench.statusword & BITS == REACHED  # 001: not started
    bench.control(0x1F)
    for _ in range(round(seconds / 0.05)):
        if bench.statusword & (ATTAINED | ERROR) and bench.statusword & REACHED:
            break
        assert bench.statusword & BITS in (0, ATTAINED)
        bench.on(0.05)
    return bench.statusword & BITS


@pytest.mark.parametrize("method", sorted(METHODS))
def test_every_method_finds_its_place(method):
    bench = homing(method)
    assert run(bench) == REACHED | ATTAINED
    assert bench.drive.objects.units.zero == HOMES[method]
    assert bench.velocity == 0


@pytest.mark.parametrize("start", [-49000.0, 9000.0, 11000.0, 13000.0, 49000.0])
@pytest.mark.parametrize("method", [m for m in sorted(METHODS) if 17 <= m <= 30])
def test_an_edge_is_found_from_anywhere(method, start):
    bench = homing(method, start=start)
    assert run(bench) == REACHED | ATTAINED
    assert bench.drive.objects.units.zero == HOMES[method]


def test_the_position_at_home_is_the_home_offset():
    bench = homing(37, offset=1234)
    run(bench)
    assert bench.position == 1234
    bench = homing(17, offset=-50)
    run(bench)
    home = bench.drive.mover.plant.position - bench.position
    assert home == pytest.approx(-50000 + 50, abs=1)


def test_method_35_moves_nothing():
    bench = ready_tmcm(mode=6)
    bench.drive.mover.displace(777.0, bench.now)
    assert bench.position == 777
    bench.write(0x6098, 35)
    bench.control(0x1F)
    assert bench.position == 0
    assert bench.statusword & BITS == REACHED | ATTAINED


def test_falling_bit_4_interrupts():
    bench = homing(17)
    bench.control(0x1F)
    bench.on(0.5)
    assert bench.velocity < 0
    bench.control(0x0F)
    bench.on(2)
    assert bench.statusword & BITS == REACHED
    assert bench.velocity == 0


def test_halt_interrupts_and_goes_on():
    bench = homing(17)
    bench.control(0x1F)
    bench.on(0.5)
    bench.control(0x011F)
    bench.on(2)
    assert bench.velocity == 0
    bench.control(0x1F)
    bench.on(30)
    assert bench.statusword & BITS == REACHED | ATTAINED
    assert bench.drive.objects.units.zero == -50000


def test_an_unknown_method_and_one_that_the_device_lacks_are_homing_errors():
    assert run(homing(99)) == REACHED | ERROR
    bench = ready_tmcm(mode=6)
    bench.write(0x6098, 34)
    assert run(bench) == REACHED | ERROR


def test_without_speeds_homing_is_an_error():
    bench = ready_tmcm(mode=6)
    bench.write(0x6098, 17)
    assert run(bench) == REACHED | ERROR


def test_the_switches_show_while_homing():
    bench = homing(17)
    bench.control(0x1F)
    seen = set()
    for _ in range(600):
        bench.on(0.05)
        seen.add(bench.number(0x60FD) & 7)
    assert seen >= {0, 1}


def test_the_tmcm_1270_takes_its_position_for_home_without_power_by_method_35():
    bench = Bench(tmcm())
    bench.drive.mover.displace(500.0, bench.now)
    assert bench.position == 500
    bench.write(0x6060, 6)
    bench.write(0x6098, 35)
    bench.control(0x16)
    assert [bench.number(index, signed=True) for index in (0x6062, 0x6063, 0x6064)] == [0, 0, 0]
    assert bench.statusword & 0x1000
    assert bench.state == "READY_TO_SWITCH_ON"
    bench.drive.mover.displace(100.0, bench.now)
    bench.control(0x16)  # the level is no edge
    assert bench.position == 100


def test_other_methods_and_other_drives_need_operation_for_it():
    for node, method in ((tmcm(), 17), (servo(), 35)):
        bench = Bench(node)
        bench.start()
        bench.drive.mover.displace(500.0, bench.now)
        bench.write(0x6060, 6)
        bench.write(0x6098, method)
        bench.control(0x16)
        bench.on(1)
        assert bench.position == 500
        assert not bench.statusword & 0x1000
