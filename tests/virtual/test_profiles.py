from __future__ import annotations

import pytest
from support.virtualbench import Bench, S, ready_tmcm, servo

from canopen_control.virtual.plant import LagPlant

REACHED, BIT_12, BIT_13, LIMIT = 1 << 10, 1 << 12, 1 << 13, 1 << 11


def enabled(mode, **kwargs):
    return Bench(servo(**kwargs)).enable(mode)


def sampled(bench, seconds, step=0.005):
    """Yield (t, position, velocity) as a listener sees them, on the way."""
    start = bench.now
    while bench.now - start < seconds * S:
        bench.on(step)
        yield (bench.now - start) / S, bench.position, bench.velocity


# -- profile velocity


def test_pv_ramps_up_with_6083_and_down_with_6084_as_the_closed_form_says():
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
    for each in (bench, other):
        each.write(0x60FF, 1000)
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


def test_pp_relative_counts_from_what_its_option_says():
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


def test_pp_halts_and_goes_on():
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


def test_pp_stops_at_a_software_limit_and_says_so():
    bench = enabled(1)
    bench.write(0x607D, -100, 1)
    bench.write(0x607D, 400, 2)
    bench.write(0x607A, 1000)
    bench.control(0x1F)
    bench.on(3)
    assert bench.position == 400
    assert bench.statusword & LIMIT


# -- the cyclic modes


def test_csp_reaches_each_set_point_within_its_interpolation_time():
    bench = enabled(8)  # 60C2: 10 ms
    for step in range(1, 50):
        bench.write(0x607A, 7 * step)
        bench.on(0.005)
        assert bench.position == pytest.approx(7 * step - 3.5, abs=1)
        bench.on(0.005)
        assert bench.position == 7 * step
        assert bench.velocity in (0, 700)
    assert bench.statusword & BIT_12
    bench.on(1)
    assert (bench.position, bench.velocity) == (7 * 49, 0)


def test_csp_faults_when_a_set_point_is_out_of_reach():
    bench = enabled(8, x6065=100)
    object.__setattr__(bench.drive.personality, "max_velocity", 1000.0)
    try:
        bench.write(0x607A, 5000)
        bench.on(0.001)
        assert bench.state in ("FAULT_REACTION_ACTIVE", "FAULT")
        assert bench.number(0x603F) == 0x8611
    finally:
        object.__setattr__(bench.drive.personality, "max_velocity", float("inf"))


def test_a_lagging_plant_faults_outside_the_following_error_window_for_its_time():
    bench = Bench(servo(plant=lambda axis: LagPlant(time_constant=0.1), x6065=50, x6066=100)).enable(3)
    bench.write(0x60FF, 400)  # an error of 40
    bench.on(2)
    assert bench.state == "OPERATION_ENABLED"
    assert bench.number(0x60F4, signed=True) == pytest.approx(40, abs=1)
    bench.write(0x60FF, 1000)  # an error of 100
    bench.on(0.1)
    assert bench.state == "OPERATION_ENABLED"
    bench.on(0.3)
    assert bench.state == "FAULT"
    assert bench.number(0x603F) == 0x8611


def test_csv_takes_the_velocity_at_once():
    bench = enabled(9)
    bench.write(0x60FF, 1000)
    bench.on(0.5)
    assert (bench.velocity, bench.position) == (1000, 500)
    bench.write(0x60FF, 0)
    bench.on(0.5)
    assert (bench.velocity, bench.position) == (0, 500)


def test_ip_moves_only_while_interpolation_is_enabled():
    bench = enabled(7)
    bench.write(0x60C1, 100, 1)
    bench.on(0.1)
    assert bench.position == 0
    assert not bench.statusword & BIT_12
    bench.control(0x1F)
    bench.on(0.1)
    assert bench.position == 100
    assert bench.statusword & BIT_12
    bench.control(0x0F)
    bench.write(0x60C1, 200, 1)
    bench.on(0.1)
    assert bench.position == 100


def test_tq_follows_its_slope_within_the_limit():
    bench = enabled(4, x6087=1000, x6072=500)
    bench.write(0x6071, 400)
    bench.on(0.2)
    assert bench.number(0x6077) == 200
    assert not bench.statusword & REACHED
    bench.on(0.3)
    assert bench.number(0x6077) == 400
    assert bench.statusword & REACHED
    assert bench.velocity > 0
    bench.write(0x6071, 900)
    bench.on(1)
    assert bench.number(0x6077) == 500
    assert bench.statusword & LIMIT
    bench.control(0x02)
    bench.on(3)
    assert (bench.velocity, bench.state) == (0, "SWITCH_ON_DISABLED")


def test_cst_takes_the_torque_at_once():
    bench = enabled(10)
    bench.write(0x6071, 100)
    bench.on(0.001)
    assert bench.number(0x6077) == 100
    bench.on(2)
    assert bench.velocity == pytest.approx(5000, abs=1)  # a tenth of the rated velocity
    assert bench.statusword & BIT_12


def test_no_mode_stops_the_motor():
    bench = ready_tmcm()
    bench.write(0x60FF, 1600)
    bench.on(1)
    bench.write(0x6060, 0)
    bench.on(1)
    assert (bench.velocity, bench.state) == (0, "OPERATION_ENABLED")
