from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.cia402.units import (
    INT32_MAX,
    INT32_MIN,
    PositionUnwrapper,
    Scale,
    counts_of_objects,
    counts_per_revolution,
    rpm_of_unit,
    to_object,
    wrap_int32,
)
from canopen_control.errors import ConfigError

ROBBY_LEFT = Scale(-254.647897079, -0.003926991, -254.647897079, -0.003926991)
INT32 = st.integers(INT32_MIN, INT32_MAX)


def test_ten_radians_per_second_are_2546_pulses_on_the_tutorials_reversed_wheel():
    assert to_object(10.0 * ROBBY_LEFT.vel_to_dev, INT32_MIN, INT32_MAX) == -2546
    assert ROBBY_LEFT.velocity_from_device(-2546) == pytest.approx(9.998, abs=1e-3)


def test_a_small_target_is_rounded_not_truncated():
    scale = Scale(pos_to_dev=1000.0)
    assert (to_object(0.9, -10, 10), to_object(-0.9, -10, 10)) == (1, -1)
    assert scale.position_count(1.9996) == 2000


@pytest.mark.parametrize("raw", [32768.0, -32769.0, 1e30, 1e308, math.inf, -math.inf, math.nan])
def test_what_does_not_fit_is_not_a_target(raw):
    assert to_object(raw, -(1 << 15), (1 << 15) - 1) is None


@pytest.mark.parametrize(
    "arguments", [{"pos_to_dev": 0.0}, {"vel_from_dev": math.nan}, {"eff_from_dev": 0}, {"offset_pos_to_dev": math.inf}]
)
def test_a_scale_that_cannot_be_is_refused(arguments):
    with pytest.raises(ConfigError, match=next(iter(arguments))):
        Scale(**arguments)


def test_units_by_name_that_cannot_be_are_refused():
    for counts, gear in ((0, 1.0), (1600, 0.0), (math.nan, 1.0)):
        with pytest.raises(ConfigError, match="counts_per_revolution"):
            Scale.from_units(counts, gear)


@given(st.floats(-1e6, 1e6), st.floats(1.0, 2000.0))
def test_there_and_back_is_within_half_a_count(position, counts):
    scale = Scale.from_units(counts)
    assert abs(scale.position_count(position) * scale.pos_from_dev - position) <= 0.51 * math.tau / counts


def test_effort_has_its_own_scale():
    scale = Scale(eff_from_dev=0.002, eff_to_dev=500.0)
    assert scale.effort_from_device(1000) == pytest.approx(2.0)
    assert scale.eff_to_dev * 2.0 == 1000


def test_counts_per_revolution_come_from_the_factor_group():
    assert counts_per_revolution((2000, 1)) == 2000
    assert counts_per_revolution((2000, 1), (10, 3)) == pytest.approx(2000 * 10 / 3)
    assert counts_per_revolution((2000, 1), (10, 1), (360_000, 1)) == 360_000
    with pytest.raises(ConfigError, match="all values must be above 0"):
        counts_per_revolution((2000, 0))


@given(st.integers(-(2**40), 2**40))
def test_wrapping_keeps_the_low_32_bits(value):
    wrapped = wrap_int32(value)
    assert INT32_MIN <= wrapped <= INT32_MAX
    assert (wrapped - value) % 2**32 == 0


@given(INT32, st.lists(st.integers(-(2**31) + 1, 2**31 - 1), max_size=50))
def test_a_position_continues_across_every_wrap(start, steps):
    unwrapper = PositionUnwrapper()
    assert not unwrapper.started
    count = unwrapper.update(start)
    assert count == start
    for step in steps:
        count += step
        assert unwrapper.update(wrap_int32(count)) == count
        assert unwrapper.raw_of(count) == wrap_int32(count)
    assert unwrapper.jumps == 0


@given(st.integers(0, 999), st.lists(st.integers(-499, 499), max_size=50), st.sampled_from([None, 10, 5000]))
def test_a_position_continues_across_the_ends_of_its_range(start, steps, most):
    """0x607B with 1000 counts; a largest step of more than half the range accepts every step."""
    unwrapper = PositionUnwrapper(most, span=1000)
    count = unwrapper.update(start)
    for step in steps:
        if most is None or abs(step) <= most:
            count += step
            assert unwrapper.update(count % 1000) == count
            assert unwrapper.raw_of(count) == count % 1000
    assert unwrapper.jumps == 0


@pytest.mark.parametrize(("start", "step"), [(INT32_MAX - 5, 10), (INT32_MIN + 5, -10)])
def test_a_position_continues_beyond_either_end_of_the_counter(start, step):
    unwrapper = PositionUnwrapper()
    unwrapper.update(start)
    assert unwrapper.update(wrap_int32(start + step)) == start + step
    assert unwrapper.update(wrap_int32(start)) == start
    assert unwrapper.jumps == 0


def test_a_step_that_no_motor_makes_is_counted_and_is_not_a_motion():
    unwrapper = PositionUnwrapper(max_step=1000)
    unwrapper.update(1_000_000)
    assert unwrapper.update(1_001_000) == 1_001_000
    assert unwrapper.update(0) == 1_001_000
    assert (unwrapper.jumps, unwrapper.last_jump) == (1, -1_001_000)
    assert unwrapper.update(5) == 1_001_005
    assert unwrapper.raw_of(1_001_005) == 5
    assert unwrapper.update(5) == 1_001_005
    unwrapper.max_step = None
    assert unwrapper.update(100_005) == 1_101_005


def test_a_restarted_drive_is_where_it_was_and_its_targets_shift_with_it():
    unwrapper = PositionUnwrapper()
    unwrapper.rebase()  # before anything was seen: nothing to keep
    assert unwrapper.update(70_000) == 70_000
    unwrapper.rebase()
    assert unwrapper.update(0) == 70_000
    assert unwrapper.update(10) == 70_010
    assert unwrapper.raw_of(70_020) == 20
    unwrapper.rebase()
    assert unwrapper.update(10) == 70_010
    assert unwrapper.jumps == 0


@given(INT32, st.lists(INT32, max_size=30), st.integers(0, 2**31 - 1))
def test_no_stream_moves_the_count_by_more_than_the_largest_step(start, raws, max_step):
    unwrapper = PositionUnwrapper(max_step)
    count = unwrapper.update(start)
    for raw in raws:
        before, count = count, unwrapper.update(raw)
        assert abs(count - before) <= max_step
        assert unwrapper.raw_of(count) == raw


@pytest.mark.parametrize(
    ("unit", "rpm"),
    [(0x00B44700, 1.0), (0xFDB44700, 1e-3), (0x01B44700, 10.0), (0, 0.0), (0x00410300, 0.0), (-0x4BB900, 0.1)],
)
def test_the_unit_of_velocities_is_read_with_its_power_of_ten(unit, rpm):
    assert rpm_of_unit(unit) == pytest.approx(rpm)


@pytest.mark.parametrize(
    ("encoder", "gear", "feed", "counts"),
    [
        ((2000, 1), None, None, 2000),
        ((2000, 1), (50, 1), None, 100_000),
        ((2000, 1), None, (1, 1), 2000),
        ((2000, 1), None, (360, 1), 360),
        ((1, 1), None, (360, 1), 360),
        ((1, 1), (1, 1), (1, 1), None),
        ((1, 1), (50, 1), None, None),
        (None, None, (1, 1), None),
        ((7, 7), None, None, None),
        ((2000, 0), None, None, None),
    ],
)
def test_counts_per_turn_are_reported_with_the_place_where_they_are_set(encoder, gear, feed, counts):
    assert counts_of_objects(encoder, gear, feed) == counts
