from __future__ import annotations

import dataclasses
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples
from support.setpoints import MS, STEP, StreamBench
from support.virtualbench import BIT_12, LIMIT, REACHED, Bench, T, enabled, entry, servo, servo_od

from canopen_control.cia301.abort import AbortCode
from canopen_control.virtual.device import make_device
from canopen_control.virtual.device_model import ELMO, GENERIC, MAXON, PLAIN, DeviceModel, MissingSetPoint
from canopen_control.virtual.plant import LagPlant, LoadedPlant
from canopen_control.virtual.quirks import switches_of

ON = DeviceModel(missing=MissingSetPoint(cycles=3))
V = STEP / 0.01

# -- interpolation time and period at constant velocity: the ripple of the demanded velocity


@pytest.mark.parametrize(
    ("interpolation_ms", "ripple", "low", "high"),
    [(10, 0.0, 1.0, 1.0), (1, 3.0, 0.0, 10.0), (5, 1.0, 0.0, 2.0), (20, 0.0, 1.0, 1.0), (50, 0.0, 1.0, 1.0)],
)
def test_an_interpolation_time_below_the_period_grinds_and_one_above_it_lags(interpolation_ms, ripple, low, high):
    bench = StreamBench(interpolation_ms).ramp(settle=100)
    assert bench.ripple == pytest.approx((ripple, low, high), rel=0.02, abs=0.001)
    lag = STEP * 399 - bench.drive.mover.demand.at(bench.now)[0]
    assert lag == pytest.approx(max(0, interpolation_ms - 10) / 1000 * V, abs=STEP * 0.02)


@pytest.mark.rest
@pytest.mark.parametrize(
    ("controller_ms", "sync_ms", "ripple", "low", "high"),
    [(10, 8, 0.5, 0.0, 1.25), (10, 5, 1.0, 0.0, 2.0), (8, 10, 0.35, 0.8, 1.6), (5, 10, 0.0, 1.0, 1.0)],
)
def test_a_controller_in_another_rhythm_than_the_sync_makes_ripple_unless_it_is_a_whole_multiple(
    controller_ms, sync_ms, ripple, low, high
):
    bench = StreamBench(sync_ms).sampled_ramp(controller_ms, sync_ms)
    assert bench.ripple == pytest.approx((ripple, low, high), rel=0.03, abs=0.002)


def test_one_set_point_of_a_hundred_repeated_is_a_dip_and_a_jump():
    bench = StreamBench().ramp(1050, repeat=range(100, 1050, 100))
    assert bench.ripple == pytest.approx((0.14, 0.0, 2.0), abs=0.025)
    assert (bench.quality.doubled, bench.quality.missed, bench.quality.taken) == (10, 0, 1000)


@pytest.mark.rest
def test_one_rpdo_of_a_hundred_lost_is_a_dip_where_the_drive_stands_and_nothing_where_it_continues():
    lost = range(100, 1050, 100)
    held, extrapolated = (StreamBench(model=model).ramp(1050, skip=lost) for model in (GENERIC, ON))
    assert held.ripple == pytest.approx((0.14, 0.0, 2.0), abs=0.025)
    assert extrapolated.ripple == pytest.approx((0.0, 1.0, 1.0), abs=0.001)
    assert held.quality.missed == extrapolated.quality.missed == 10
    assert held.quality.doubled == extrapolated.quality.doubled == 0


def jittered(model, sigma_ms):
    """A stream whose SYNCs jitter by a normal distribution."""
    bench, chance = StreamBench(model=model), random.Random(7)
    begun = bench.now
    for cycle in range(1, 800):
        bench.to(begun + round(cycle * 10 * MS + chance.gauss(0, sigma_ms) * MS))
        if cycle == 20:
            bench.restart()
        bench.send(STEP * cycle)
        bench.sync()
    return bench


# A gap of 0.1 ms is shorter than the 0.5 ms of the meter, which sees a part of its 5 %.
@pytest.mark.rest
@pytest.mark.parametrize(("sigma_ms", "ripple"), [(0.1, 0.042), (0.5, 0.16), (1.0, 0.25)])
def test_a_sync_that_jitters_makes_the_ripple_that_real_drives_have(sigma_ms, ripple):
    held, extrapolated = (jittered(item, sigma_ms) for item in (PLAIN, dataclasses.replace(ON, recovers_sync=False)))
    assert held.ripple[0] == pytest.approx(ripple, rel=0.25)
    assert extrapolated.ripple[0] < 0.65 * held.ripple[0]
    if sigma_ms == 1.0:
        assert extrapolated.ripple[0] == pytest.approx(0.14, abs=0.02)


@pytest.mark.parametrize(("sigma_ms", "ripple"), [(0.1, 0.002), (0.5, 0.01), (1.0, 0.02)])
def test_a_drive_that_recovers_the_rhythm_of_sync_receives_little_of_its_jitter(sigma_ms, ripple):
    bench = jittered(GENERIC, sigma_ms)
    assert bench.ripple[0] < ripple
    assert (bench.quality.missed, bench.quality.doubled) == (0, 0)


def test_such_a_drive_stands_where_sync_ends_as_much_beyond_its_set_point_as_sync_was_late():
    bench = jittered(GENERIC, 1.0)
    last = bench.drive.mover.demand.final_position
    bench.on(1.0)
    assert 0 <= last - STEP * 799 <= STEP // 2
    assert bench.velocity == 0


# -- what a model does without a set-point


def starved(model, periods, **how):
    """A stream that ended some periods ago; SYNC goes on."""
    bench = StreamBench(model=model, **how).ramp(50)
    for _ in range(periods):
        bench.sync()
        bench.on(0.01)
    return bench


def place_of_set_point_stream(bench):
    return bench.drive.mover.plant.position


def test_a_drive_that_holds_stands_at_its_last_set_point():
    for model in (GENERIC, MAXON):
        bench = starved(model, 20)
        assert (place_of_set_point_stream(bench), bench.velocity, bench.state) == (49 * STEP, 0, "OPERATION_ENABLED")
        assert bench.quality.missed == 20


def test_a_drive_that_extrapolates_continues_for_its_cycles_and_stands_then():
    for periods, cycles in ((1, 1), (2, 2), (3, 3), (4, 3), (20, 3)):
        bench = starved(ON, periods)
        assert place_of_set_point_stream(bench) == pytest.approx((49 + cycles) * STEP)
        assert bench.state == "OPERATION_ENABLED"
    bench.cycle(49 * STEP)  # the next one counts as any other
    assert place_of_set_point_stream(bench) == 49 * STEP


def test_a_repeated_set_point_is_not_a_missing_one():
    bench = StreamBench(model=ON).ramp(50)
    for _ in range(5):
        bench.cycle(49 * STEP)
    assert (place_of_set_point_stream(bench), bench.quality.missed) == (49 * STEP, 0)


def test_an_extrapolation_ends_at_a_software_limit():
    bench = StreamBench(model=ON)
    bench.write(0x607D, -10_000_000, 1)
    bench.write(0x607D, 49 * STEP + 700, 2)
    bench.ramp(50)
    bench.on(0.1)
    assert place_of_set_point_stream(bench) == 49 * STEP + 700


def test_elmo_faults_when_the_cycles_it_continues_for_are_over():
    bench = starved(ELMO, 1)
    bench.cycle(STEP * 51)  # one set-point was missing: allowed
    assert (bench.state, place_of_set_point_stream(bench)) == ("OPERATION_ENABLED", STEP * 51)
    bench.on(0.01)
    assert bench.state == "OPERATION_ENABLED"
    bench.on(0.006)
    assert bench.state in ("FAULT_REACTION_ACTIVE", "FAULT")
    assert bench.number(0x603F) == 0xFF02


def test_a_drive_that_is_not_streamed_to_is_moved_by_sdo_without_a_fault():
    bench = StreamBench(model=ELMO)
    bench.write(0x607A, 3 * STEP)
    bench.on(1)
    assert (place_of_set_point_stream(bench), bench.state) == (3 * STEP, "OPERATION_ENABLED")


def test_one_rpdo_is_not_a_stream():
    bench = StreamBench(model=ELMO)
    bench.cycle(3 * STEP)
    bench.on(1)
    assert (place_of_set_point_stream(bench), bench.state) == (3 * STEP, "OPERATION_ENABLED")


def test_a_halt_ends_the_stream_and_its_supervision():
    bench = StreamBench(model=ELMO, x605D=2, x6085=0).ramp(50)
    bench.control(0x10F)
    bench.control(0x0F)
    bench.on(1)
    assert bench.state == "OPERATION_ENABLED"


def test_the_velocity_demand_is_that_of_the_interpolation():
    bench = StreamBench(20).ramp(100)
    assert bench.number(0x606B, signed=True) == V
    bench.on(0.02)
    assert bench.number(0x606B, signed=True) == 0


def test_the_supervision_ends_with_the_mode_and_with_the_power():
    for leave in (lambda bench: bench.control(0x06), lambda bench: bench.write(0x6060, 1)):
        bench = StreamBench(model=ELMO).ramp(50)
        leave(bench)
        bench.on(1)
        assert bench.number(0x603F) == 0


@pytest.mark.parametrize(("mode", "object_"), [(9, 0x60FF), (10, 0x6071)])
def test_velocity_and_torque_continue_without_a_set_point_or_fault(mode, object_):
    mapped = (object_ << 16 | 0x20 if object_ == 0x60FF else object_ << 16 | 0x10, 0x607A0020)
    for model, state in ((GENERIC, "OPERATION_ENABLED"), (ELMO, "FAULT")):
        bench = StreamBench(mode=mode, model=model, mapped=mapped, x6085=0, x605E=0)
        for _ in range(10):
            bench.put(0x305, (100).to_bytes(4 if mode == 9 else 2, "little") + bytes(4))
            bench.sync()
            bench.on(0.01)
        bench.on(1)
        assert bench.state == state
        assert bench.quality.taken == 10
        assert bench.quality.doubled == 0


# -- what is fed forward


@pytest.mark.rest
def test_the_velocity_offset_lessens_the_following_error_and_moves_no_demand():
    for share in (0.0, 1.0):
        bench = StreamBench(mapped=(0x607A0020, 0x60B10020), plant=lambda axis: LagPlant(time_constant=0.1))
        for cycle in range(1, 400):
            bench.send(STEP * cycle, round(V * (1.0 - share)))
            bench.sync()
            bench.on(0.01)
        demand = bench.drive.mover.demand.at(bench.now)[0]
        assert demand == 399 * STEP
        assert demand - place_of_set_point_stream(bench) == pytest.approx(share * 0.1 * V, abs=0.02 * 0.1 * V)


def test_what_was_fed_forward_pushes_against_the_position_loop_until_it_is_zero_or_the_power_is_off():
    bench = StreamBench(mapped=(0x607A0020, 0x60B10020), plant=lambda axis: LoadedPlant(friction=0.0, viscosity=0.0))
    for _ in range(100):
        bench.send(0, 1000)
        bench.sync()
        bench.on(0.01)
    assert place_of_set_point_stream(bench) == pytest.approx(10.0, rel=0.05)  # 1000 counts/s against 100/s of gain
    bench.write(0x6060, 1)
    bench.on(1)
    assert place_of_set_point_stream(bench) == pytest.approx(0.0, abs=0.5)
    bench.write(0x6060, 8)
    bench.control(0x06)
    bench.on(0.5)
    assert bench.drive.mover.plant.fed_velocity == 0.0


def test_the_torque_offset_reaches_the_torque_loop():
    bench = StreamBench(mapped=(0x607A0020, 0x60B20010), plant=lambda axis: LoadedPlant(friction=0.0))
    bench.put(0x305, bytes(4) + (200).to_bytes(2, "little"))
    bench.sync()
    bench.on(0.0006)
    assert bench.drive.mover.plant.torque == pytest.approx(200, abs=1)


# -- the drive's clock


def drifting(model, ppm, seconds=120, sync=True):
    bench = StreamBench(model=model, synchronous=sync)
    bench.node.set_clock_drift(ppm)
    for cycle in range(1, round(seconds * 100)):
        if cycle == 100:
            bench.restart()
        bench.send(STEP * cycle)
        if sync:
            bench.sync()
        bench.on(0.01)
    return bench.quality


@pytest.mark.parametrize(("ppm", "count"), [(5000.0, "missed"), (-5000.0, "overwritten")])
def test_a_clock_that_runs_free_slips_a_set_point_each_time_the_drift_is_a_period(ppm, count):
    quality = drifting(GENERIC, ppm, 13)
    assert getattr(quality, count) == pytest.approx(6, abs=1)
    assert quality.velocity_ripple > 0.02
    assert quality.doubled == 0


def test_a_drive_that_follows_the_sync_slips_none():
    follower = dataclasses.replace(GENERIC, follows_sync=True)
    for ppm in (200.0, -200.0):
        quality = drifting(follower, ppm, 4)
        assert (quality.missed, quality.overwritten, quality.velocity_ripple) == (0, 0, 0.0)
    assert drifting(follower, 5000.0, 5, sync=False).missed > 0  # there is none to follow


BUFFER = ((1, T.UNSIGNED32, 8, "ro"), (2, T.UNSIGNED32, 8, "rw"), (3, T.UNSIGNED8, 0, "rw"),
          (4, T.UNSIGNED16, 0, "rw"), (5, T.UNSIGNED8, 4, "wo"), (6, T.UNSIGNED8, 0, "wo"))  # fmt: skip


def buffered_od(records=1, **changed):
    od = servo_od(5, **changed)
    for subindex, data_type, default, access in BUFFER:
        od.add(entry(0x60C4, subindex, data_type, default, access))
    od.add(entry(0x60C0, 0, T.INTEGER16, 0))
    for subindex in range(2, records + 1):
        od.add(entry(0x60C1, subindex, T.INTEGER32, 0, "rw", True))
    return od


def buffered(records=1, model=GENERIC, **changed):
    """A drive in mode 7 whose buffer of 8 records is open and interpolation enabled."""
    bench = StreamBench(mode=7, mapped=(0x60C10120, 0x60FF0020), od=buffered_od(records, **changed), model=model)
    bench.write(0x60C4, 1, 6)
    bench.control(0x1F)
    return bench


def place(bench):
    bench.drive.advance(bench.now)
    return bench.drive.mover.plant.position


def test_without_opening_it_a_record_counts_at_once():
    bench = StreamBench(mode=7, mapped=(0x60C10120, 0x60FF0020), od=buffered_od())
    bench.control(0x1F)
    for cycle in range(1, 20):
        bench.cycle(STEP * cycle)
    assert place(bench) == 19 * STEP
    assert bench.number(0x60C4, 4) == 0


def test_records_that_come_in_bunches_move_the_axis_evenly():
    bench = buffered()
    for first in range(1, 400, 4):
        if first == 41:
            bench.restart()
        for cycle in range(first, first + 4):
            bench.send(STEP * cycle)
            bench.sync()
        bench.on(0.04)
    assert bench.ripple == pytest.approx((0.0, 1.0, 1.0), abs=1e-6)
    assert (bench.quality.missed, bench.quality.doubled, bench.quality.taken) == (0, 0, 360)
    assert place(bench) == 400 * STEP


def test_it_starts_when_interpolation_is_enabled_and_keeps_what_waits_until_the_power_goes():
    bench = buffered()
    bench.control(0x0F)
    for cycle in range(1, 5):
        bench.write(0x60C1, STEP * cycle, 1)
    bench.on(0.1)
    assert (place(bench), bench.number(0x60C4, 4)) == (0, 4)
    assert not bench.statusword & BIT_12
    bench.control(0x1F)
    bench.on(0.015)
    assert (place(bench), bench.number(0x60C4, 4)) == (1.5 * STEP, 2)
    assert bench.statusword & (BIT_12 | REACHED) == BIT_12
    bench.control(0x0F)
    bench.on(0.1)
    assert bench.number(0x60C4, 4) == 2
    bench.control(0x06)
    assert bench.number(0x60C4, 4) == 0


def test_enabled_again_it_continues_at_once():
    bench = buffered(x6084=0)
    for cycle in range(1, 5):
        bench.send(STEP * cycle)
        bench.sync()
    bench.on(0.013)
    bench.control(0x0F)
    bench.control(0x1F)
    assert bench.number(0x60C4, 4) == 1
    bench.on(0.01)
    assert place(bench) == 3 * STEP


def test_records_by_sdo_fill_the_buffer_of_a_drive_with_a_quirk_of_set_points_as_well():
    bench = buffered()
    switches_of(bench.node).set("set_point_needs_bit_5", True, bench.now)
    bench.control(0x0F)
    for cycle in range(1, 5):
        bench.write(0x60C1, STEP * cycle, 1)
    assert bench.number(0x60C4, 4) == 4
    bench.control(0x1F)
    bench.on(0.1)
    assert place(bench) == 4 * STEP


def test_a_record_too_many_is_refused_and_those_that_wait_stay():
    bench = buffered()
    bench.control(0x0F)
    bench.write(0x60C4, 3, 2)
    codes = [bench.abort_of(0x60C1, STEP * cycle, 1) for cycle in range(1, 6)]
    assert codes == [None, None, None, AbortCode.OUT_OF_MEMORY, AbortCode.OUT_OF_MEMORY]
    refused = bench.node.pdos.refused
    bench.send(STEP * 9)
    bench.sync()
    assert bench.node.pdos.refused == refused + 1
    bench.control(0x1F)
    bench.on(0.1)
    assert place(bench) == 3 * STEP


def test_closing_clears_it():
    bench = buffered()
    bench.control(0x0F)
    bench.write(0x60C1, STEP, 1)
    bench.write(0x60C4, 0, 6)
    assert bench.number(0x60C4, 4) == 0


def test_what_it_does_not_have_is_refused():
    bench = buffered()
    assert bench.abort_of(0x60C4, 9, 2) == AbortCode.VALUE_TOO_HIGH
    assert bench.abort_of(0x60C4, 1, 3) == AbortCode.INVALID_VALUE
    assert bench.abort_of(0x60C4, 2, 6) == AbortCode.INVALID_VALUE
    assert bench.abort_of(0x60C0, -1) == AbortCode.INVALID_VALUE
    assert bench.abort_of(0x60C0, 0) is None


def test_a_record_of_two_counts_when_its_last_subindex_is_written():
    bench = buffered(records=2)
    bench.control(0x0F)
    bench.write(0x60C1, STEP, 1)
    assert bench.number(0x60C4, 4) == 0
    bench.write(0x60C1, 77, 2)
    assert bench.number(0x60C4, 4) == 1


@pytest.mark.parametrize("cycles", [0, 2])
def test_a_buffer_that_runs_dry_does_what_the_model_specifies_and_continues_with_the_next_record(cycles):
    bench = buffered(model=DeviceModel(missing=MissingSetPoint(cycles=cycles)))
    for cycle in range(1, 5):
        bench.send(STEP * cycle)
        bench.sync()
    bench.on(0.2)
    assert place(bench) == (4 + cycles) * STEP
    bench.send(STEP * 10)
    bench.sync()
    bench.on(0.01)
    assert (place(bench), bench.quality.missed) == (10 * STEP, 16)


def test_elmo_faults_on_a_buffer_that_stays_dry():
    bench = buffered(model=ELMO)
    for cycle in range(1, 5):
        bench.send(STEP * cycle)
        bench.sync()
    bench.on(0.2)
    assert (bench.state, bench.number(0x603F)) == ("FAULT", 0xFF02)


@settings(max_examples=examples(30))
@given(steps=st.lists(st.sampled_from(("put", "wait", "off", "on", "clear")), max_size=60))
def test_whatever_is_done_it_moves_to_records_in_their_order_and_holds_no_more_than_it_may(steps):
    bench, sent = buffered(x6084=0), 0  # a stop without a ramp
    before = 0.0
    for step in steps:
        if step == "put":
            sent += 1
            bench.send(STEP * sent)
            bench.sync()
        elif step == "wait":
            bench.on(0.013)
        elif step == "clear":
            bench.write(0x60C4, 0, 6)
            bench.write(0x60C4, 1, 6)
        else:
            bench.control(0x1F if step == "on" else 0x0F)
        assert 0 <= bench.number(0x60C4, 4) <= 8
        assert before <= place(bench) <= STEP * sent
        before = place(bench)
    assert bench.state == "OPERATION_ENABLED"


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


def test_a_set_point_that_is_microseconds_late_does_not_reduce_the_velocity():
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
