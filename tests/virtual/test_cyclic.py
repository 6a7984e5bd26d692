from __future__ import annotations

import pytest
from support.virtualbench import BIT_12, LIMIT, REACHED, Bench, enabled, servo

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
