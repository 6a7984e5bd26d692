from __future__ import annotations

import pytest
from support.virtualbench import BIT_12, LIMIT, REACHED, Bench, S, enabled, generic, ready_tmcm, servo, tmcm

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.virtual.plant import LagPlant
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


def test_halt_interrupts_and_continues():
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
    observed = set()
    for _ in range(600):
        bench.on(0.05)
        observed.add(bench.number(0x60FD) & 7)
    assert observed >= {0, 1}


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
    bench.control(0x16)  # the level is not an edge
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


def sampled(bench, seconds, step=0.005):
    """Yield (t, position, velocity) as a listener sees them, on the way."""
    start = bench.now
    while bench.now - start < seconds * S:
        bench.on(step)
        yield (bench.now - start) / S, bench.position, bench.velocity


# -- profile velocity


def test_pv_ramps_up_with_6083_and_down_with_6084_as_the_closed_form_reports():
    bench = enabled(3, x6083=4000, x6084=2000)
    bench.write(0x60FF, 1000)
    for t, position, velocity in sampled(bench, 0.5):
        assert velocity == pytest.approx(min(4000 * t, 1000), rel=0.01, abs=1)
        assert position == pytest.approx(2000 * t * t if t < 0.25 else 125 + 1000 * (t - 0.25), abs=1)
    start = bench.position
    bench.write(0x60FF, 0)
    for t, position, velocity in sampled(bench, 0.6):
        assert velocity == pytest.approx(max(1000 - 2000 * t, 0), rel=0.01, abs=1)
        assert position - start == pytest.approx(1000 * t - 1000 * t * t if t < 0.5 else 250, abs=1)


def test_pv_of_the_tmcm_1270_decelerates_with_6083_too():
    bench = ready_tmcm(ramp=16000)
    bench.write(0x6084, 100)
    bench.write(0x60FF, 1600)
    bench.on(1)
    bench.write(0x60FF, 0)
    bench.on(0.101)
    assert bench.velocity == 0


def test_pv_shows_target_reached_and_speed_zero():
    bench = enabled(3)
    assert bench.statusword & (REACHED | BIT_12) == REACHED | BIT_12
    bench.write(0x60FF, 1000)
    bench.on(0.05)
    assert bench.statusword & (REACHED | BIT_12) == 0
    bench.on(0.1)
    assert bench.statusword & (REACHED | BIT_12) == REACHED


def test_pv_takes_a_new_target_from_the_present_velocity():
    bench = enabled(3)
    bench.write(0x60FF, 1000)
    bench.on(0.05)
    assert bench.velocity == 500
    bench.write(0x60FF, -1000)
    bench.on(0.1)
    assert bench.velocity == 0
    bench.on(0.1)
    assert bench.velocity == -1000


def test_pv_adds_its_offset_and_keeps_within_the_maximum():
    bench = enabled(3, x60B1=100, x607F=500)
    bench.write(0x60FF, 200)
    bench.on(1)
    assert bench.velocity == 300
    bench.write(0x60FF, 5000)
    bench.on(1)
    assert bench.velocity == 500


def test_the_same_target_written_again_changes_nothing():
    bench, other = enabled(3), enabled(3)
    for item in (bench, other):
        item.write(0x60FF, 1000)
    for _ in range(20):
        bench.on(0.01)
        bench.write(0x60FF, 1000)
    other.on(0.2)
    assert bench.drive.mover.plant.position == other.drive.mover.plant.position


def test_pv_stops_at_a_software_limit_and_leaves_it_the_other_way():
    bench = enabled(3)
    bench.write(0x607D, -5000, 1)
    bench.write(0x607D, 300, 2)
    bench.write(0x60FF, 1000)
    bench.on(2)
    assert (bench.position, bench.velocity) == (300, 0)
    assert bench.statusword & LIMIT
    bench.write(0x60FF, -1000)
    bench.on(0.1)
    assert bench.velocity == -1000
    assert not bench.statusword & LIMIT


# -- velocity, the frequency converter's


def test_vl_ramps_in_rpm_while_its_bits_are_set():
    bench = enabled(2)
    bench.write(0x6042, 300)  # rpm; 6000 counts a turn: 30,000 counts/s
    bench.on(1)
    assert bench.velocity == 0  # the ramp is locked
    bench.control(0x7F)
    bench.on(0.5)  # 600 rpm in 2 s
    assert bench.number(0x6044, signed=True) == 150
    bench.on(1)
    assert (bench.number(0x6044), bench.number(0x6043), bench.velocity) == (300, 300, 30000)
    bench.control(0x5F)  # bit 5: the output stands
    bench.write(0x6042, 0)
    bench.on(1)
    assert bench.number(0x6044) == 300
    bench.control(0x7F)
    bench.on(0.25)  # 600 rpm in 1 s
    assert bench.number(0x6044) == 150
    bench.on(1)
    assert bench.velocity == 0


def test_vl_keeps_within_its_smallest_and_greatest_speed():
    bench = enabled(2)
    bench.write(0x6046, 50, 1)
    bench.write(0x6046, 200, 2)
    bench.control(0x7F)
    for target, speed in ((10, 50), (-10, -50), (400, 200), (-400, -200)):
        bench.write(0x6042, target)
        bench.on(3)
        assert bench.number(0x6044, signed=True) == speed


# -- profile position


def test_pp_follows_the_handshake_and_its_trapezoid():
    bench = enabled(1, x6081=1000, x6083=10000, x6084=5000)
    bench.write(0x607A, 1000)
    bench.on(0.1)
    assert bench.position == 0  # no edge, no motion
    bench.control(0x1F)
    assert bench.statusword & BIT_12
    assert not bench.statusword & REACHED
    bench.control(0x0F)
    assert not bench.statusword & BIT_12
    # up 0.1 s (50 counts), down 0.2 s (100 counts), 850 counts at 1000/s
    for t, position, velocity in sampled(bench, 1.3):
        if t < 0.1:
            assert (position, velocity) == (pytest.approx(5000 * t * t, abs=1), pytest.approx(10000 * t, abs=1))
        elif t < 0.95:
            assert (position, velocity) == (pytest.approx(50 + 1000 * (t - 0.1), abs=1), 1000)
        elif t < 1.15:
            left = 1.15 - t
            assert position == pytest.approx(1000 - 2500 * left * left, abs=1)
            assert velocity == pytest.approx(5000 * left, rel=0.01, abs=1)
        else:
            assert (position, velocity) == (1000, 0)
        assert bool(bench.statusword & REACHED) == (t >= 1.15 - 1e-9)


def test_pp_needs_a_rising_edge():
    bench = enabled(1)
    bench.write(0x607A, 100)
    bench.control(0x1F)
    bench.on(1)
    bench.write(0x607A, 500)
    bench.control(0x1F)
    bench.on(1)
    assert bench.position == 100
    bench.control(0x0F)
    bench.control(0x1F)
    bench.on(2)
    assert bench.position == 500


def test_an_edge_that_comes_with_the_enable_starts_nothing():
    bench = Bench(servo())
    bench.start()
    bench.write(0x6060, 1)
    bench.write(0x607A, 100)
    for word in (6, 7, 0x1F):
        bench.control(word)
    bench.on(1)
    assert (bench.state, bench.position) == ("OPERATION_ENABLED", 0)


def test_pp_buffers_one_set_point_and_acknowledges_it_when_there_is_room():
    bench = enabled(1)
    bench.write(0x607A, 1000)
    bench.control(0x1F)
    bench.control(0x0F)
    bench.write(0x607A, -500)
    bench.control(0x1F)
    bench.control(0x0F)
    assert bench.statusword & BIT_12  # the buffer is full
    bench.write(0x607A, 7777)
    bench.control(0x1F)  # ignored
    bench.control(0x0F)
    bench.on(1.2)
    assert bench.position <= 1000
    assert not bench.statusword & (BIT_12 | REACHED)
    bench.on(3)
    assert bench.position == -500
    assert bench.statusword & REACHED


def test_pp_changes_at_once_with_bit_5():
    bench = enabled(1)
    bench.write(0x607A, 10000)
    bench.control(0x1F)
    bench.control(0x0F)
    bench.on(0.5)
    bench.write(0x607A, -100)
    bench.control(0x3F)
    bench.control(0x0F)
    bench.on(0.5)
    assert bench.velocity < 0
    bench.on(5)
    assert bench.position == -100


def test_pp_relative_counts_from_what_its_option_reports():
    bench = enabled(1)
    bench.write(0x607A, 1000)
    for word in (0x5F, 0x4F):
        bench.control(word)
    bench.on(0.5)
    assert 0 < bench.position < 1000
    for word in (0x7F, 0x4F):  # from the previous target
        bench.control(word)
    bench.on(5)
    assert bench.position == 2000
    bench.write(0x60F2, 2)
    bench.drive.mover.displace(25, bench.now)
    for word in (0x7F, 0x4F):  # from the actual position
        bench.control(word)
    bench.on(5)
    assert bench.position == 3025


def test_pp_halts_and_continues():
    bench = enabled(1)
    bench.write(0x607A, 2000)
    bench.control(0x1F)
    bench.on(0.5)
    bench.control(0x011F)
    bench.on(1)
    assert bench.velocity == 0
    assert bench.position < 2000
    assert bench.statusword & REACHED  # halted: bit 10 is standstill
    bench.control(0x1F)
    assert not bench.statusword & REACHED
    bench.on(3)
    assert bench.position == 2000


def test_pp_window_and_time_delay_the_arrival():
    bench = enabled(1, x6067=10, x6068=50)
    bench.write(0x607A, 1000)
    bench.control(0x1F)
    bench.on(1.151)
    assert bench.position == 1000
    assert not bench.statusword & REACHED
    bench.on(0.05)
    assert bench.statusword & REACHED


def test_pp_is_never_early_behind_a_plant_that_lags():
    bench = enabled(1, plant=lambda axis: LagPlant(time_constant=0.05), x6067=2)
    bench.write(0x607A, 1000)
    bench.control(0x1F)
    for _ in range(600):
        bench.on(0.005)
        if bench.statusword & REACHED:
            assert abs(bench.position - 1000) <= 2
            break
    else:
        pytest.fail("the target was never reached")


def test_pp_of_the_tmcm_1270_shows_the_motion_in_bit_12_and_replaces_it():
    bench = ready_tmcm(mode=1)
    bench.write(0x607A, 10000)
    bench.control(0x1F)
    bench.control(0x0F)
    bench.on(0.5)
    assert bench.statusword & BIT_12
    bench.write(0x607A, 0)
    bench.control(0x1F)
    bench.control(0x0F)
    bench.on(5)
    assert bench.position == 0
    assert bench.statusword & (BIT_12 | REACHED) == REACHED


def test_pp_stops_at_a_software_limit_and_reports_this():
    bench = enabled(1)
    bench.write(0x607D, -100, 1)
    bench.write(0x607D, 400, 2)
    bench.write(0x607A, 1000)
    bench.control(0x1F)
    bench.on(3)
    assert bench.position == 400
    assert bench.statusword & LIMIT


def pp(**objects):
    b = Bench(generic())
    values = {0x6081: 1000, 0x6083: 10_000, 0x6084: 5_000, 0x6085: 20_000} | {
        int(k[1:], 16): v for k, v in objects.items()
    }
    for index, value in values.items():
        b.write(index, value)
    return b.enable(1)


def set_point(b, target, word=0x1F):
    b.write(0x607A, target)
    b.control(word)
    b.control(word & ~0x10)


def test_pp_with_bit_9_passes_the_first_set_point_with_the_profile_velocity():
    b = pp()
    set_point(b, 1000)
    set_point(b, 3000, 0x021F)
    assert b.statusword & BIT_12
    b.on(1.05)  # 50 counts of ramp, then 1000 counts/s
    assert b.velocity == 1000
    assert b.position == pytest.approx(1000, abs=1)
    assert not b.statusword & REACHED
    for t, position, velocity in sampled(b, 1.9):
        assert velocity == 1000
        assert position == pytest.approx(1000 + 1000 * t, abs=1)
    b.on(0.3)
    assert (b.position, b.velocity) == (3000, 0)
    assert b.statusword & REACHED


def test_pp_without_bit_9_stops_at_the_first_set_point():
    b = pp()
    set_point(b, 1000)
    set_point(b, 3000)
    slowest = min(abs(velocity) for t, _, velocity in sampled(b, 2.0) if t > 0.5)
    assert slowest < 50
    b.on(3)
    assert b.position == 3000


def test_pp_with_bit_9_stops_where_the_next_set_point_lies_the_other_way():
    b = pp()
    set_point(b, 1000)
    set_point(b, 0, 0x021F)
    assert max(position for _, position, _ in sampled(b, 2.0)) <= 1000
    b.on(2)
    assert (b.position, b.velocity) == (0, 0)


def test_pp_with_bit_9_takes_the_new_profile_after_the_first_set_point():
    b = pp()
    set_point(b, 1000)
    b.write(0x6081, 2000)
    set_point(b, 5000, 0x021F)
    b.on(1.0)
    assert b.velocity == 1000
    b.on(0.5)
    assert b.velocity == 2000
    b.on(5)
    assert (b.position, b.velocity) == (5000, 0)


def test_pp_of_the_tmcm_1270_has_no_bit_9():
    b = ready_tmcm(mode=1)
    set_point(b, 1000)
    set_point(b, 3000, 0x021F)
    b.on(4)
    assert b.position == 3000


def test_pp_passes_its_target_with_the_end_velocity_and_continues_until_a_limit():
    b = pp(x6082=200)
    b.write(0x607D, -5000, 1)
    b.write(0x607D, 1500, 2)
    set_point(b, 1000)
    before = [(position, velocity) for _, position, velocity in sampled(b, 1.5) if not b.statusword & REACHED]
    assert all(position <= 1000 for position, _ in before)
    assert b.velocity == 200
    assert b.statusword & REACHED
    b.on(5)
    assert (b.position, b.velocity) == (1500, 0)
    assert b.statusword & LIMIT


def test_vl_stops_quickly_along_0x604a():
    b = Bench(generic())
    for index, sub, value in ((0x608F, 1, 6000), (0x6048, 1, 600), (0x6048, 2, 1), (0x604A, 1, 1200), (0x604A, 2, 1)):
        b.write(index, value, sub)
    b.enable(2)
    b.write(0x6042, 600)
    b.control(0x7F)
    b.on(2)
    assert b.number(0x6044, signed=True) == 600
    b.control(0x02)
    b.on(0.25)
    assert b.number(0x6044, signed=True) == 300
    b.on(0.3)
    assert (b.number(0x6044), b.state) == (0, "SWITCH_ON_DISABLED")
    assert b.drive.modes.active.quick_stop_deceleration() == pytest.approx(1200 * 100)
    b.write(0x604A, 0, 1)
    assert b.drive.modes.active.quick_stop_deceleration() == b.drive.objects.ramp(0x6085)


def test_no_mode_stops_the_motor():
    bench = ready_tmcm()
    bench.write(0x60FF, 1600)
    bench.on(1)
    bench.write(0x6060, 0)
    bench.on(1)
    assert (bench.velocity, bench.state) == (0, "OPERATION_ENABLED")


# -- which modes a drive has


@pytest.mark.parametrize("default", [None, 0])
def test_a_drive_whose_file_lists_no_modes_has_those_whose_targets_it_has(default):
    bench = Bench(servo(without=(0x6071, 0x6042), x6502=default))
    assert bench.number(0x6502) == 0x1E5  # PP, PV, HM, IP, CSP, CSV
    assert bench.abort_of(0x6060, 9) is None
    assert bench.abort_of(0x6060, 10) == 0x06090030
    bench.nmt(NmtCommand.RESET_NODE)
    bench.on(1)
    assert bench.number(0x6502) == 0x1E5


def test_what_the_file_lists_counts_though_more_targets_are_there():
    assert Bench(servo(x6502=0x5)).number(0x6502) == 0x5
