from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.virtual import trajectory

S = 1_000_000_000
positions = st.floats(-1e6, 1e6)
speeds = st.floats(-1e5, 1e5)
ramps = st.floats(100.0, 1e6)


def test_a_ramp_follows_the_closed_form_and_its_integral():
    ramp = trajectory.ramp_to(0, 100.0, 0.0, 1000.0, 2000.0, 500.0)
    assert ramp.end_ns == S // 2
    assert ramp.at(S // 4) == pytest.approx((100 + 0.5 * 2000 * 0.0625, 500))
    assert ramp.at(S // 2) == pytest.approx((350, 1000))
    assert ramp.at(2 * S) == pytest.approx((350 + 1500, 1000))


def test_a_reversal_decelerates_to_standstill_and_accelerates_from_there():
    ramp = trajectory.ramp_to(0, 0.0, 1000.0, -1000.0, 2000.0, 500.0)
    assert ramp.end_ns == 2 * S + S // 2
    assert ramp.at(2 * S) == pytest.approx((1000, 0))
    assert ramp.at(ramp.end_ns) == pytest.approx((1000 - 250, -1000))


def test_without_an_acceleration_nothing_starts():
    assert trajectory.ramp_to(0, 5.0, 0.0, 1000.0, 0.0, 0.0).at(S) == (5.0, 0.0)
    assert trajectory.move_to(0, 5.0, 0.0, 1000.0, 100.0, 0.0, 0.0).at(S) == (5.0, 0.0)
    assert trajectory.move_to(0, 5.0, 0.0, 1000.0, 0.0, 100.0, 100.0).at(S) == (5.0, 0.0)


def test_without_a_deceleration_a_stop_is_immediate():
    assert trajectory.ramp_to(0, 5.0, 300.0, 0.0, 0.0, 0.0).at(S) == (5.0, 0.0)


def test_an_infinite_acceleration_is_a_step():
    step = trajectory.ramp_to(0, 0.0, -10.0, 50.0, trajectory.INFINITE, trajectory.INFINITE)
    assert step.at(S) == pytest.approx((50, 50))
    jump = trajectory.move_to(0, 0.0, 0.0, 100.0, 50.0, trajectory.INFINITE, trajectory.INFINITE)
    assert jump.at(S) == pytest.approx((50, 50))
    assert jump.at(2 * S) == (100.0, 0.0)


def test_a_trapezoid_has_the_textbook_times():
    move = trajectory.move_to(0, 0.0, 0.0, 1000.0, 100.0, 100.0, 50.0)  # 1 s up, 2 s down, 850 counts between
    assert move.end_ns == pytest.approx(11.5 * S, abs=2)
    assert move.at(S) == pytest.approx((50, 100))
    assert move.at(move.end_ns) == (1000.0, 0.0)


def test_a_move_that_cannot_stop_in_time_returns():
    move = trajectory.move_to(0, 0.0, 100.0, 10.0, 100.0, 100.0, 100.0)
    assert move.at(S) == pytest.approx((50, 0))
    assert move.at(move.end_ns) == (10.0, 0.0)


def test_a_linear_move_takes_its_time_and_stands():
    line = trajectory.linear_to(S, 10.0, 30.0, 0.02)
    assert line.at(S + S // 100) == pytest.approx((20, 1000))
    assert line.at(3 * S) == (30.0, 0.0)
    assert trajectory.linear_to(0, 10.0, 30.0, 0.0).at(0) == (30.0, 0.0)


def test_the_time_of_a_position_is_found_on_every_piece():
    move = trajectory.move_to(0, 0.0, 0.0, 1000.0, 100.0, 100.0, 50.0)
    for position in (1.0, 50.0, 400.0, 950.0, 1000.0):
        result = move.time_of(position, 0)
        assert result is not None
        assert move.at(result)[0] == pytest.approx(position, abs=1e-5)
    assert move.time_of(1001.0, 0) is None
    assert trajectory.cruise(0, 0.0, -10.0).time_of(-20.0, S) == 2 * S
    assert trajectory.cruise(0, 0.0, -10.0).time_of(20.0, S) is None


@given(positions, speeds, positions, st.floats(1e3, 1e6), ramps, ramps)
def test_every_move_is_continuous_ends_at_its_target_and_keeps_its_limits(p, v, target, speed, up, down):
    move = trajectory.move_to(0, p, v, target, speed, up, down)
    assert move.at(move.end_ns) == (target, 0.0)
    position, velocity = p, v
    for piece in move.slices(0, move.end_ns):
        assert piece.velocity == pytest.approx(velocity, rel=1e-6, abs=1e-3)
        assert abs(piece.acceleration) <= max(up, down) * (1 + 1e-9)
        position += piece.distance(piece.seconds)
        velocity = piece.velocity + piece.acceleration * piece.seconds
        assert abs(velocity) <= max(speed, abs(v)) * (1 + 1e-6)
    assert position == pytest.approx(target, rel=1e-6, abs=1e-2)
    assert velocity == pytest.approx(0, abs=1e-2)


@given(positions, speeds, speeds, ramps, ramps, st.lists(st.integers(1, S), min_size=1, max_size=8))
def test_a_ramp_looked_at_often_is_the_ramp_looked_at_once(p, v, target, up, down, steps):
    ramp = trajectory.ramp_to(0, p, v, target, up, down)
    clock, way = 0, 0.0
    for step in steps:
        way += sum(piece.distance(piece.seconds) for piece in ramp.slices(clock, clock + step))
        clock += step
    position, velocity = ramp.at(clock)
    assert p + way == pytest.approx(position, abs=1e-2, rel=1e-9)
    assert abs(velocity) <= max(abs(v), abs(target)) + 1e-9
    assert math.isfinite(position)


@given(
    st.floats(-1000, 1000),
    st.floats(-500, 500),
    st.floats(-1000, 1000),
    st.floats(1, 500),
    st.floats(10, 5000),
    st.floats(10, 5000),
    st.floats(0, 500),
)
def test_a_move_with_an_end_velocity_passes_its_target_with_it_or_as_fast_as_it_gets(
    position, velocity, target, speed, up, down, end
):
    demand = trajectory.move_to(0, position, velocity, target, speed, up, down, end=end)
    there, then = demand.at(demand.end_ns)
    assert there == pytest.approx(target, abs=1e-6)
    assert abs(then) <= min(end, speed) + 1e-9
    just_before = demand.at(max(0, demand.end_ns - 1000))
    assert just_before[0] == pytest.approx(target, abs=1e-2)
    if demand.end_ns > 2000 and abs(target - position) > 1e-3:
        assert abs(just_before[1] - then) <= max(up, down) * 2e-6 + 1e-6


def test_an_end_velocity_is_reached_where_the_way_is_long_enough():
    demand = trajectory.move_to(0, 0.0, 0.0, 1000.0, 500.0, 1000.0, 1000.0, end=200.0)
    assert demand.at(demand.end_ns) == (1000.0, 200.0)
    short = trajectory.move_to(0, 0.0, 0.0, 10.0, 500.0, 1000.0, 1000.0, end=200.0)
    assert short.final_velocity == pytest.approx((2 * 1000 * 10) ** 0.5)
    back = trajectory.move_to(0, 0.0, 100.0, -50.0, 500.0, 1000.0, 1000.0, end=200.0)
    assert back.final_velocity == -200.0


def test_a_linear_move_continues_with_its_velocity_for_as_long_as_commanded():
    demand = trajectory.linear_to(0, 100.0, 200.0, 0.01, 0.03)
    assert [demand.at(round(ms * 1e6)) for ms in (5, 10, 40, 41, 400)] == [
        pytest.approx(item) for item in ((150, 10_000), (200, 10_000), (500, 0), (500, 0), (500, 0))
    ]
    assert trajectory.linear_to(0, 100.0, 200.0, 0.0, 0.03).at(0) == (200.0, 0.0)


def test_how_long_a_velocity_lasts_is_known():
    demand = trajectory.move_to(0, 0.0, 0.0, 100.0, 10.0, 10.0, 10.0)  # 1 s up, 9 s even, 1 s down
    assert [demand.steady_until(round(s * 1e9)) for s in (0, 0.5)] == [0, 500_000_000]
    assert demand.steady_until(2_000_000_000) == pytest.approx(10_000_000_000, abs=10)
    assert demand.steady_until(10_500_000_000) == 10_500_000_000
    assert demand.steady_until(demand.end_ns) is None
    assert trajectory.hold(0, 5.0).steady_until(0) is None
