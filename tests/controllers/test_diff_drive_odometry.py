from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.control import S, same, vectors
from support.properties import examples

from canopen_control.controllers.diff_drive import Odometry, wheel_velocities


@pytest.mark.parametrize("case", vectors("odometry_rolling_upstream"), ids=lambda case: case["name"])
def test_it_follows_the_wheels_as_upstream_does(case):
    odometry = Odometry(case["sep"], case["rl"], case["rr"], case["window"])
    odometry.begin(0.0, 0.0, 0)
    now, result = 0, None
    for verb, *values in case["steps"]:
        if verb == "set":
            odometry.set_pose(*values)
            continue
        left, right, dt = values
        now += round(dt * S)
        steps = {"vel": odometry.update_velocity, "pos": odometry.update_position, "open": odometry.update_open_loop}
        result = steps[verb](left, right, now)
    for name, wanted in case["expect"].items():
        found = result if name == "ret" else getattr(odometry, name)
        assert found == wanted or same(found, wanted, 1e-5), name


def drive(odometry: Odometry, path: list[tuple[float, float, int]], dt: float = 0.02) -> None:
    """Drive (m/s, rad/s, steps) with wheels that do exactly what they are told."""
    now, left, right = 0, 3.0, -5.0
    odometry.update_position(left, right, now)
    for linear, angular, steps in path:
        speed_left, speed_right = wheel_velocities(linear, angular, 0.24, 0.035, 0.035)
        for _ in range(steps):
            now += round(dt * S)
            left, right = left + speed_left * dt, right + speed_right * dt
            odometry.update_position(left, right, now)


def test_a_square_ends_where_it_began():
    odometry = Odometry(0.24, 0.035, 0.035)
    drive(odometry, [(0.5, 0.0, 100), (0.0, math.pi / 2, 50)] * 4)
    assert abs(odometry.x) < 1e-9
    assert abs(odometry.y) < 1e-9
    assert same(odometry.heading, 2 * math.pi)


@given(st.floats(0.05, 2.0), st.integers(3, 400), st.sampled_from([1, -1]), st.booleans())
@settings(max_examples=examples(40))
def test_a_circle_ends_where_it_began(radius, steps, sense, backward):
    odometry = Odometry(0.24, 0.035, 0.035)
    turn = sense * 2 * math.pi / (steps * 0.02)
    drive(odometry, [(-radius * abs(turn) if backward else radius * abs(turn), turn, steps)])
    assert math.hypot(odometry.x, odometry.y) < 1e-9
    assert same(odometry.heading, sense * 2 * math.pi)


@pytest.mark.rest
def test_the_heading_survives_a_million_steps():
    odometry = Odometry(0.24, 0.035, 0.035, 1)
    odometry.begin(0.0, 0.0, 0)
    for step in range(1, 1_000_001):
        odometry.update_open_loop(0.1, 0.01 if step % 2 else -0.01, step * 1_000_000)
    assert abs(odometry.heading) < 1e-9
    assert same(odometry.x, 100.0, 1e-6)


def test_the_wheels_angles_at_start_and_the_time_before_do_not_move_the_robot():
    odometry = Odometry(1.0, 0.1, 0.1)
    odometry.update_position(0.1, 0.2, 1_700_000_000 * S)
    odometry.update_open_loop(0.0, 0.0, 1_700_000_001 * S)
    assert (odometry.x, odometry.y, odometry.heading, odometry.linear) == (0.0, 0.0, 0.0, 0.0)
    fresh = Odometry(1.0, 0.1, 0.1)
    fresh.update_open_loop(0.5, 0.0, 1_700_000_000 * S)
    assert fresh.x == 0.0


def test_after_a_stop_the_next_sample_is_where_it_goes_on_from():
    odometry = Odometry(1.0, 1.0, 1.0)
    odometry.update_position(0.0, 0.0, 0)
    odometry.update_position(1.0, 1.0, S)
    odometry.stop()
    odometry.update_position(50.0, 50.0, 2 * S)
    odometry.update_position(51.0, 51.0, 3 * S)
    assert odometry.x == 2.0


def test_velocities_are_means_over_the_window_fewer_until_it_is_full():
    odometry = Odometry(1.0, 1.0, 1.0, 2)
    odometry.begin(0.0, 0.0, 0)
    found = []
    for step, speed in enumerate((1.0, 3.0, 5.0), 1):
        odometry.update_velocity(speed, speed, step * S)
        found.append(odometry.linear)
    assert found == [1.0, 2.0, 4.0]
    odometry.set_pose(1.0, 2.0, 3.0)
    odometry.update_velocity(7.0, 7.0, 4 * S)
    assert odometry.linear == 7.0


def test_a_step_too_short_to_measure_is_put_off_to_the_next():
    odometry = Odometry(1.0, 1.0, 1.0)
    odometry.update_position(0.0, 0.0, 0)
    assert not odometry.update_position(0.5, 0.5, 50_000)
    assert odometry.update_position(1.0, 1.0, S)
    assert odometry.x == 1.0
