from __future__ import annotations

import itertools
import math
import statistics
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples
from support.setpoints import STEP, StreamBench
from support.virtualbench import Bench, servo

from canopen_control.virtual.mode_base import GRID_NS, REACHED, REST_NS, Mode, SetpointStatistics
from canopen_control.virtual.trajectory import cruise, hold, linear_to


def test_a_drive_without_a_mode_stands_and_reports_this():
    bench = Bench(servo()).enable()
    assert type(bench.drive.modes.active) is Mode
    assert bench.statusword & REACHED
    bench.write(0x60FF, 1000)
    bench.write(0x607A, 1000)
    bench.control(0x1F)
    bench.on(1)
    assert (bench.position, bench.velocity) == (0, 0)


def test_its_slow_down_ramp_is_0x6084():
    bench = Bench(servo(x6084=1234))
    assert bench.drive.modes.active.deceleration() == 1234.0


# -- set point meter


MS = 1_000_000


def measured(targets, period_ns=10 * MS, seconds=0.01):
    """A meter that saw linear ways to positions, one each period, and the demanded positions of its grid."""
    meter, demand, now = SetpointStatistics(), hold(0, 0.0), 0
    meter.used = True
    meter.follow(demand, now)
    places = []
    for target in targets:
        places += [demand.at(t)[0] for t in range((now // GRID_NS + 1) * GRID_NS, now + period_ns + 1, GRID_NS)]
        now += period_ns
        meter.follow(demand, now)
        demand = linear_to(now, demand.at(now)[0], target, seconds)
    return meter, places


@settings(max_examples=examples(40))
@given(
    steps=st.lists(st.integers(1, 5000), min_size=5, max_size=30), seconds=st.sampled_from((0.0013, 0.005, 0.01, 0.03))
)
def test_it_finds_what_differences_of_the_demand_give(steps, seconds):
    targets = [sum(steps[: n + 1]) for n in range(len(steps))]
    meter, places = measured(targets, seconds=seconds)
    ways = [b - a for a, b in itertools.pairwise(places)]
    first = next(n for n, way in enumerate(ways) if way)
    last = max(n for n, way in enumerate(ways) if way)
    moving = ways[first : last + 1]
    quality = meter.quality(1.0)
    speeds = [way * 1e9 / GRID_NS for way in moving]
    assert quality.velocity.mean == pytest.approx(statistics.fmean(speeds), rel=1e-6)
    assert (quality.velocity.min, quality.velocity.max) == pytest.approx((min(speeds), max(speeds)), rel=1e-6, abs=1e-3)
    ripple = statistics.pstdev(moving) / statistics.fmean(moving)
    assert quality.velocity_ripple == pytest.approx(ripple, rel=1e-3, abs=1e-5)
    changes = [b - a for a, b in itertools.pairwise(ways)]
    power = sum(change * change for change in changes)
    counted = meter._accelerations.count
    assert meter._accelerations.squares == pytest.approx(power, rel=1e-6, abs=1e-9)
    assert quality.acceleration == pytest.approx(math.sqrt(power / counted) * 1e18 / GRID_NS**2, rel=0.05)


def test_a_motion_of_constant_velocity_has_no_ripple_and_one_in_user_units_has_its_sign():
    meter = SetpointStatistics()
    meter.used = True
    demand = cruise(0, 0.0, 800.0)
    for now in range(0, 1000 * MS, 7 * MS):
        meter.follow(demand, now)
    quality = meter.quality(-8.0)
    assert (quality.velocity.min, quality.velocity.max) == pytest.approx((-100.0, -100.0))
    assert (quality.velocity_ripple, quality.acceleration_ripple) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_an_axis_that_rests_reports_nothing_and_a_short_stop_is_part_of_the_motion():
    targets = [1000, 2000, 3000]
    rested, _ = measured([*targets, *[3000] * 40, 4000, 5000, 6000, 6000])
    assert rested.quality(1.0).velocity.min == pytest.approx(100_000)
    stopped, _ = measured([*targets, 3000, 4000, 5000, 6000])
    assert stopped.quality(1.0).velocity.min == 0.0


def test_after_a_second_without_an_update_a_new_motion_begins():
    meter = SetpointStatistics()
    meter.used = True
    meter.follow(cruise(0, 0.0, 100.0), 50 * MS)
    meter.follow(cruise(0, 0.0, 100.0), 100 * MS)
    count = meter._velocities.count
    meter.follow(cruise(0, 0.0, 100.0), 10_000 * MS)
    assert meter._velocities.count == count
    assert count == 50 * MS // GRID_NS - 1  # the first point has no way


@pytest.mark.parametrize(
    ("targets", "doubled"),
    [
        ((0, 10, 20, 20, 30), 1),
        ((0, 10, 20, 20, 20, 30), 2),
        ((0, 10, 20, 20, 10), 0),  # it turned round
        ((0, 1, 2, 2, 3), 0),  # so slow that whole counts repeat
        ((0, 10, 20, 20, 20), 0),  # the end of the motion
        ((5, 5, 5, 15), 0),  # its beginning
    ],
)
def test_a_set_point_is_doubled_when_the_motion_continues_after_it(targets, doubled):
    meter = SetpointStatistics()
    for cycle, target in enumerate(targets):
        meter.take(target, cycle * 10 * MS)
    assert (meter.doubled, meter.taken) == (doubled, len(targets))


def test_a_pause_is_not_a_doubled_set_point():
    meter = SetpointStatistics()
    for cycle, target in enumerate((0, 10, 20, *[20] * 20, 30)):
        meter.take(target, cycle * REST_NS // 10)
    assert meter.doubled == 0


def test_velocities_and_torques_may_repeat():
    meter = SetpointStatistics()
    for cycle in range(5):
        meter.take(None, cycle)
    assert (meter.taken, meter.doubled) == (5, 0)


def test_it_reports_nothing_before_a_cyclic_mode_and_restarts_on_request():
    bench = StreamBench(mode=3)
    assert bench.quality is None
    bench.write(0x6060, 8)
    bench.on(0)
    assert (bench.quality.taken, bench.quality.velocity, bench.quality.phase_us) == (0, None, None)
    bench.ramp(60)
    assert bench.quality.taken == 10
    assert bench.quality.phase_us.mean == pytest.approx(10_000)
    bench.restart()
    assert (bench.quality.taken, bench.quality.velocity) == (0, None)


def test_the_phase_is_from_the_sync_to_the_rpdo():
    bench = StreamBench()
    bench.sync()
    for cycle, after_us in enumerate((500, 1500, 4000, 2000), start=1):
        bench.on(after_us * 1e-6)
        bench.send(STEP * cycle)
        bench.on(0.01 - after_us * 1e-6)
        bench.sync()
    phase = bench.quality.phase_us
    assert (phase.min, phase.mean, phase.max) == pytest.approx((500, 2000, 4000))


def test_an_rpdo_that_replaces_one_that_waits_is_reported():
    bench = StreamBench()
    for cycle in range(1, 11):
        bench.send(STEP * cycle)
        bench.send(STEP * cycle)
        bench.sync()
        bench.on(0.01)
    assert (bench.quality.taken, bench.quality.overwritten, bench.quality.doubled) == (10, 10, 0)


def test_a_new_enable_counts_again_and_a_halt_does_not():
    bench = StreamBench().ramp(20, settle=1)
    bench.control(0x10F)
    bench.on(0.1)
    bench.control(0x0F)
    bench.cycle(STEP * 20)
    assert bench.quality.taken == 20
    bench.control(0x06)
    assert bench.quality.taken == 20  # still there to be read
    bench.enable()
    assert bench.quality.taken == 0


def test_measuring_leaves_no_object_behind():
    meter = SetpointStatistics()
    demand = cruise(0, 0.0, 800.0)

    def cycles(first, last):
        for cycle in range(first, last):
            meter.follow(demand, cycle * 10 * MS)
            meter.take(cycle * 8.0, cycle * 10 * MS)
            meter.received(cycle)

    cycles(1, 500)
    before = sys.getallocatedblocks()
    cycles(500, 2500)
    assert sys.getallocatedblocks() - before < 100
