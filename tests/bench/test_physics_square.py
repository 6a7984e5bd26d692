"""The square and the long drive of the physics bench, in simulated time."""

import functools

import pytest
from canopen_control_bench.physics_square import MisjudgedBase, digest_after, rest_cpu, square

from canopen_control.calibration.square_path import Pace, SquarePath
from canopen_control.calibration.umbmark import Direction


@functools.cache
def on_a_floor(direction, friction=0.8):
    return square(direction, friction, side=0.15)


def test_an_ideal_robots_squares_mirror_and_end_where_odometry_says():
    left, right = on_a_floor(1), on_a_floor(-1)
    assert (left.x, left.y, left.heading) == pytest.approx((right.x, -right.y, -right.heading), abs=1e-9)
    assert left.error < 1e-3


def test_on_a_slippery_floor_it_ends_further_off():
    assert on_a_floor(1, 0.05).error > 2.0 * on_a_floor(1).error


def test_a_base_that_misjudges_its_wheels_ends_far_off_until_it_is_told_how_they_are():
    base, path = MisjudgedBase(0.005, 1.02), SquarePath(0.3, Direction.CW, Pace())
    off = base.drive(path).truth
    base.set_factors((1.02, 1 / 1.0025, 1 / 0.9975))
    assert base.wheel_values().separation == pytest.approx(0.24)
    true = base.drive(path).truth
    assert off[0] ** 2 + off[1] ** 2 > 0.02**2
    assert true[0] ** 2 + true[1] ** 2 < 0.002**2


def test_a_random_drive_comes_to_the_same_bits_and_another_seed_to_others():
    assert digest_after(1.0) == digest_after(1.0) != digest_after(1.0, seed=2)


def test_at_rest_a_minute_costs_next_to_nothing():
    assert rest_cpu(60.0) < 1.0  # ten times what a machine of its own needs
