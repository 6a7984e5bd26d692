import math

import pytest
from support.fake_client import FakeClient

from canopen_control.commissioning.driven_axis import JogDrive
from canopen_control.commissioning.jog_motion import JogEnd, JogKind, JogLimits
from canopen_control.commissioning.quantity import JogScale, parse_quantity
from canopen_control.commissioning.tune_run import (
    STEERED,
    Chirp,
    Prbs,
    StepExcitation,
    TuneMotion,
    TuneRecord,
    TuneRequest,
    TuneRun,
    TuneSample,
    TuneTest,
)
from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.robot import MappedValue, ProcessData
from canopen_control.rpc.messages.state import AxisReading, CycleTimes, JointReading, NodeReading, StateSample

SCALE = JogScale(4096.0, is_known=True)
LIMITS_OF_TUNE_REQUEST = JogLimits(math.tau, 60.0, 200.0)


def request(test, seconds=None, **kwargs):
    return TuneRequest(test, seconds or test.seconds, 0.01, **kwargs)


STEP = request(TuneTest.STEP, speed=parse_quantity("30rpm", "velocity"))


def test_what_is_commanded_is_what_is_confirmed():
    assert STEP.kind is JogKind.VELOCITY
    assert STEP.excitation(SCALE).peak == pytest.approx(math.pi)
    assert STEP.words(SCALE) == "a step to 3.14 rad/s (30.0 rpm) for 2 s"
    identify = request(TuneTest.IDENTIFY, torque=160.0)
    assert identify.kind is JogKind.TORQUE
    assert identify.excitation(SCALE).peak == pytest.approx(100.0)  # and 60 of them to one side
    assert identify.words(SCALE) == "a torque of up to 16 % of the rated torque, in both directions, for 8 s"
    assert "as a sine from 0.5 to 38.3 Hz, for 8 s" in request(TuneTest.BODE).words(SCALE)
    assert "as a pseudo-random sequence" in request(TuneTest.BODE, signal="prbs").words(SCALE)


@pytest.mark.parametrize(
    ("requested", "why"),
    [
        (request(TuneTest.STEP, speed=parse_quantity("70rpm", "velocity")), "exceeds the limit of 6.28 rad/s"),
        (request(TuneTest.IDENTIFY, torque=250.0), "exceeds --max-current 200"),
        (request(TuneTest.IDENTIFY, torque=301.0), "above 0 and at most 300"),
        (request(TuneTest.IDENTIFY, torque=0.0), "above 0 and at most 300"),
        (request(TuneTest.BODE, 0.3), "too short for a frequency response"),
    ],
)
def test_what_is_beyond_the_limits_is_refused_before_it_begins(requested, why):
    with pytest.raises(ConfigError, match=why):
        requested.check(LIMITS_OF_TUNE_REQUEST, SCALE)


def test_what_is_within_them_is_not_and_just_beyond_it_is():
    for item in (STEP, request(TuneTest.BODE), request(TuneTest.IDENTIFY, torque=200.0)):
        item.check(LIMITS_OF_TUNE_REQUEST, SCALE)
    with pytest.raises(ConfigError):
        request(TuneTest.IDENTIFY, torque=200.1).check(LIMITS_OF_TUNE_REQUEST, SCALE)


S = 1_000_000_000
LIMITS_OF_TUNE_MOTION = JogLimits(speed=6.0, travel=10.0, current=500.0)


def motion_of_tune_motion(kind=JogKind.VELOCITY, excitation=None, **kwargs):
    return TuneMotion(kind, excitation or StepExcitation(3.0, 2.0), LIMITS_OF_TUNE_MOTION, now=0, **kwargs)


def test_it_commands_its_excitation_and_is_over_with_it():
    run = motion_of_tune_motion()
    run.tick(S)
    assert (run.command, run.ended) == (3.0, JogEnd.NONE)
    run.tick(2 * S)
    assert (run.command, run.ended) == (0.0, JogEnd.OVER)


@pytest.mark.parametrize(
    ("observed", "why"),
    [
        ((0.0, 6.1, 0.0), JogEnd.SPEED),
        ((0.0, -6.1, None), JogEnd.SPEED),
        ((10.5, 0.0, 0.0), JogEnd.TRAVEL),
        ((None, None, None), JogEnd.BLIND),
        ((math.nan, math.nan, 0.0), JogEnd.BLIND),
        ((0.0, None, 0.0), JogEnd.NONE),
        ((None, 5.0, 0.0), JogEnd.NONE),
    ],
)
def test_a_limit_ends_it_and_nothing_is_commanded_any_more(observed, why):
    run = motion_of_tune_motion()
    run.see(0.0, 0.0, 0.0, enabled=True)
    run.tick(S)
    run.see(*observed, enabled=True)
    assert run.ended is why
    assert run.command == (3.0 if why is JogEnd.NONE else 0.0)


def test_samples_without_feedback_end_it_soon_but_not_at_once():
    run = motion_of_tune_motion(JogKind.TORQUE)
    for ms, velocity, why in (
        (0, None, JogEnd.NONE),
        (50, 1.0, JogEnd.NONE),
        (150, None, JogEnd.NONE),
        (151, math.nan, JogEnd.BLIND),
    ):
        run.tick(ms * S // 1000)
        run.see(None, velocity, None, enabled=True)
        assert run.ended is why, ms
    assert (run.command, run.ended.failed) == (0.0, True)


def test_the_travel_of_a_drive_without_a_position_is_computed_from_its_velocity():
    run = motion_of_tune_motion(excitation=StepExcitation(3.0, 60.0))
    for ms in range(0, 5000, 100):
        run.tick(ms * S // 1000)
        run.see(None, 3.0, None, enabled=True)
        if run.ended is not JogEnd.NONE:
            break
    assert run.ended is JogEnd.TRAVEL
    assert run.travelled == pytest.approx(10.0, abs=0.3)


def test_a_current_that_stays_too_high_ends_it_and_a_peak_does_not():
    run = motion_of_tune_motion()
    for ms, current, why in (
        (0, 600.0, JogEnd.NONE),
        (90, -600.0, JogEnd.NONE),
        (110, 400.0, JogEnd.NONE),
        (120, 501.0, JogEnd.NONE),
        (220, 501.0, JogEnd.NONE),
        (221, 501.0, JogEnd.CURRENT),
    ):
        run.tick(ms * S // 1000)
        run.see(0.0, 0.0, current, enabled=True)
        assert run.ended is why, ms


def test_a_drive_that_is_not_enabled_any_more_ends_it():
    run = motion_of_tune_motion()
    run.see(0.0, 0.0, 0.0, enabled=False)
    assert run.ended is JogEnd.STATE
    assert run.ended.failed


def test_it_ends_while_what_is_left_of_the_travel_is_enough_to_stop():
    run = motion_of_tune_motion(deceleration=2.0)
    run.see(0.0, 0.0, 0.0, enabled=True)
    run.see(6.0, 3.9, 0.0, enabled=True)  # 3.8 rad to stop, 4 are left
    assert run.ended is JogEnd.NONE
    run.see(6.0, -5.0, 0.0, enabled=True)  # it comes back
    assert run.ended is JogEnd.NONE
    run.see(6.3, 3.9, 0.0, enabled=True)
    assert run.ended is JogEnd.TRAVEL


def test_a_torque_pushes_both_ways_and_back_from_half_of_its_limits_on():
    run = motion_of_tune_motion(JogKind.TORQUE, Prbs(100.0, 0.05, 8.0))
    bias = 100.0 * STEERED

    def pushed(seconds, way, speed):
        run.tick(round(seconds * S))
        run.see(way, speed, 0.0, enabled=True)
        return run.command - Prbs(100.0, 0.05, 8.0).at(seconds)

    assert pushed(1.0, 0.0, 0.0) == bias
    assert pushed(3.0, 0.0, 0.0) == -bias
    assert pushed(7.0, 0.0, 0.0) == bias
    assert pushed(1.0, 0.0, 3.1) == -bias
    assert pushed(1.0, 5.1, -1.0) == -bias
    assert pushed(3.0, -5.1, 0.0) == bias


def test_a_record_counts_the_cycles_that_are_missing():
    record = TuneRecord(0.01)
    for cycle in (7, 8, 8, 10, 13):
        record.put(TuneSample(cycle, 1.0))
    assert [sample.cycle for sample in record.samples] == [7, 8, 10, 13]
    assert record.lost == 3
    assert record.seconds(record.samples[-1]) == pytest.approx(0.06)


@pytest.mark.parametrize("signal", [Chirp(0.5, 1.0, 0.5, 30.0, 4.0), Prbs(0.5, 0.05, 4.0, bias=1.0)])
def test_a_signal_fades_in_and_out_and_stays_within_its_peak(signal):
    values = [signal.at(t / 1000) for t in range(4001)]
    assert values[0] == 0.0
    assert signal.at(4.0) == pytest.approx(0.0, abs=1e-9)
    assert signal.at(9.0) == 0.0
    assert max(map(abs, values)) <= signal.peak == 1.5


def test_a_prbs_is_as_long_as_a_register_allows_and_even_but_for_one():
    prbs = Prbs(1.0, 1.0, 1e6, bits=9)
    period = [prbs.at(100.5 + k) for k in range(511)]
    assert abs(sum(period)) == 1.0
    assert period == [prbs.at(100.5 + 511 + k) for k in range(511)]
    shifted = sum(a * b for a, b in zip(period, period[7:] + period[:7], strict=True))
    assert shifted == -1.0  # white: as much alike as one of them is odd
    assert math.isclose(prbs.peak, 1.0)


DRIVE = JogDrive("jog_5", "drive", "joint", "controller", "CSV")
LIMITS = JogLimits(6.0, 10.0, 500.0)


def tune(effort_unit=1000.0):
    return TuneRun(
        DRIVE, JogKind.VELOCITY, StepExcitation(3.0, 2.0), LIMITS, deceleration=20.0, effort_unit=effort_unit
    )


def sample(cycle, effort=None, state="OPERATION_ENABLED"):
    return StateSample(
        nodes={"drive": NodeReading(node_id=5, axes=(AxisReading("joint", state=state),))},
        joints={"joint": JointReading("joint", 0.1, 0.2, effort, 3.0)},
        cycle=CycleTimes(0.01, cycle - 1, 1),
    )


def motion():
    return TuneMotion(JogKind.VELOCITY, StepExcitation(3.0, 2.0), LIMITS, now=0)


def test_a_sample_is_kept_with_its_cycle_and_its_torque_in_per_mille():
    record, run = TuneRecord(0.01), tune()
    run._take(sample(7, 0.25), motion(), record)
    run._take(sample(9, 0.25), motion(), record)
    assert [(item.cycle, item.effort, item.command) for item in record.samples] == [(7, 250.0, 3.0), (9, 250.0, 3.0)]
    assert record.lost == 1


@pytest.mark.parametrize(
    ("effort", "state", "why"), [(0.6, "OPERATION_ENABLED", JogEnd.CURRENT), (0.1, "FAULT", JogEnd.STATE)]
)
def test_current_and_state_of_a_sample_end_it(effort, state, why):
    moved = motion()
    for cycle in (7, 8):
        tune()._take(sample(cycle, effort, state), moved, TuneRecord(0.01))
        moved.tick(cycle * 10**8)
    tune()._take(sample(9, effort, state), moved, TuneRecord(0.01))
    assert moved.ended is why


def test_a_refused_command_ends_it():
    run, moved, taking = tune(), motion(), FakeClient()
    run._has_torque = True
    moved.tick(10**9)
    run._command(taking, moved)
    assert (taking.asked[0].values, taking.asked[0].dead_man, taking.asked[0].source) == ([3.0], True, "tune")
    moved.tick(int(1.5e9))
    run._sender._sent = 0.0
    run._command(FakeClient(("NotEnabled", "off")), moved)
    assert moved.ended is JogEnd.STATE


def test_a_torque_that_a_tpdo_carries_is_that_of_the_sample_before_it():
    def data(value):
        return ProcessData(0.0, {"drive": [MappedValue(0x6077, 0, value.to_bytes(2, "little", signed=True))]})

    record, run, moved = TuneRecord(0.01), tune(None), motion()
    run._take(sample(7), moved, record)
    run._take_torque(data(-120))
    run._take(sample(8), moved, record)
    run._take_torque(ProcessData(0.0, {"other": []}))
    run._take(sample(9), moved, record)
    run._take_torque(data(300))
    run._keep_torque(record)
    assert [item.effort for item in record.samples] == [-120.0, -120.0, 300.0]
