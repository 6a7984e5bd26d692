from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples
from support.virtualbench import BIT_12, LIMIT, REACHED, Bench, enabled, servo, servo_od

from canopen_control.virtual.device import make_device
from canopen_control.virtual.device_model import DeviceModel
from canopen_control.virtual.plant import LagPlant

# -- the cyclic modes


def test_csp_reaches_each_set_point_within_its_interpolation_time():
    bench = enabled(8)  # 60C2: 10 ms
    for step in range(1, 50):
        bench.write(0x607A, 7 * step)
        bench.on(0.005)
        assert bench.position == pytest.approx(7 * step - 3.5, abs=1)
        bench.on(0.005)
        assert bench.position == 7 * step
        assert bench.velocity == 700
    assert bench.statusword & BIT_12
    bench.on(1)
    assert (bench.position, bench.velocity) == (7 * 49, 0)


@pytest.mark.parametrize("mode", [7, 8], ids=["IP", "CSP"])
@settings(max_examples=examples(25))
@given(
    slope=st.integers(20, 5000).flatmap(lambda size: st.sampled_from((size, -size))),
    late_us=st.lists(st.integers(-3000, 3000), min_size=20, max_size=20),
)
def test_the_velocity_on_a_ramp_of_set_points_is_its_slope_whenever_they_come(mode, slope, late_us):
    bench = enabled(mode)  # 60C2: 10 ms
    bench.control(0x1F)
    begun = bench.now
    for cycle, late in enumerate(late_us, start=1):
        bench.to(begun + 10_000_000 * cycle + 1000 * late)
        before = bench.velocity  # as a TPDO shows that is sampled before the RPDO is acted upon
        bench.write(*((0x607A, slope * cycle) if mode == 8 else (0x60C1, slope * cycle, 1)))
        for velocity in (before, bench.velocity) if cycle > 2 else ():
            assert 0.35 <= velocity / (100 * slope) <= 1.65
    bench.on(0.02)
    assert bench.velocity == 0


def test_a_set_point_that_is_microseconds_late_does_not_let_the_velocity_drop():
    bench = enabled(8)
    for cycle in range(1, 20):
        bench.write(0x607A, 1000 * cycle)
        bench.on(0.01005)
        assert bench.velocity == pytest.approx(100_000, rel=0.01)
    bench.on(0.005)  # no further one comes: half of the window it stands
    assert bench.velocity == pytest.approx(50_000, rel=0.02)


def test_a_stop_on_the_way_shows_its_own_ramp_at_once():
    bench = enabled(8, x605A=0)
    bench.write(0x607A, 1000)
    bench.on(0.008)
    assert bench.velocity == 100_000
    bench.control(0x02)
    assert (bench.velocity, bench.state) == (0, "SWITCH_ON_DISABLED")


def test_csp_faults_when_a_set_point_is_out_of_reach():
    slow = DeviceModel(max_velocity=1000.0)
    bench = Bench(make_device(servo_od(5, x6065=100), 5, model=slow)).enable(8)
    bench.write(0x607A, 5000)
    bench.on(0.001)
    assert bench.state in ("FAULT_REACTION_ACTIVE", "FAULT")
    assert bench.number(0x603F) == 0x8611


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
