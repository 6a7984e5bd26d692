import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.tuneplant import COULOMB, INERTIA, loaded, pushed

from canopen_control.commissioning.quantity import JogScale, parse_quantity
from canopen_control.commissioning.tune_report import _pairs, findings, identified, report, step_metrics, step_of
from canopen_control.commissioning.tune_run import Prbs, TuneRecord, TuneRequest, TuneSample, TuneTest
from canopen_control.errors import ConfigError, DriveError

TIMES = [k / 1000 for k in range(-50, 2000)]


def second_order(damping, omega, height=1.0):
    """The closed form of a second-order system's response."""
    damped = omega * math.sqrt(1 - damping**2)
    angle = math.acos(damping)
    return [
        0.0
        if t < 0
        else height * (1 - math.exp(-damping * omega * t) / math.sqrt(1 - damping**2) * math.sin(damped * t + angle))
        for t in TIMES
    ]


@given(st.floats(0.3, 0.8), st.floats(20.0, 60.0), st.floats(-5.0, 5.0).filter(lambda height: abs(height) > 0.1))
def test_a_second_order_system_is_measured_as_its_formulas_report(damping, omega, height):
    result = step_metrics(TIMES, second_order(damping, omega, height), height)
    assert result.overshoot == pytest.approx(math.exp(-math.pi * damping / math.sqrt(1 - damping**2)), abs=0.002)
    assert result.final == pytest.approx(height, rel=1e-3)
    assert result.settling is not None
    assert result.settling <= 1.4 * -math.log(0.02 * math.sqrt(1 - damping**2)) / (damping * omega)
    assert 0.0 < result.delay < result.rise_time < 2.5 / omega * 1.6


def test_what_continues_swinging_never_settles():
    values = [0.0 if t < 0 else 1.0 + 0.2 * math.sin(30 * t) for t in TIMES]
    assert step_metrics(TIMES, values, 1.0).settling is None


@pytest.mark.parametrize(
    ("values", "why"), [([0.01] * 2050, "did not follow"), ([-1.0 if t > 0 else 0.0 for t in TIMES], "did not follow")]
)
def test_a_drive_that_does_not_follow_is_reported(values, why):
    with pytest.raises(DriveError, match=why):
        step_metrics(TIMES, values, 1.0)


def test_too_few_samples_are_reported():
    with pytest.raises(DriveError, match="too few"):
        step_metrics([0.0, 0.1], [0.0, 1.0], 1.0)


SCALE = JogScale(4096.0, is_known=True)
IDENTIFY = TuneRequest(TuneTest.IDENTIFY, 4.0, 0.01, torque=150.0)
STEP = TuneRequest(TuneTest.STEP, 2.0, 0.01, speed=parse_quantity("1rad/s", "velocity"))


def record_of(values, period=0.01, begin=10, lost=()):
    record = TuneRecord(period)
    for cycle, value in enumerate(values):
        if cycle not in lost:
            record.put(TuneSample(cycle, 1.0 if cycle >= begin else 0.0, 0.0, value))
    return record


def test_a_step_begins_with_the_cycle_that_commanded_it():
    metrics = step_of(record_of([0.0] * 14 + [1.0] * 100), 1.0)
    assert metrics.delay == pytest.approx(0.04, abs=0.01)
    assert "overshoot           0.0%" in report(record_of([0.0] * 14 + [1.0] * 100), STEP, SCALE, None)


def test_cycles_that_were_lost_do_not_bend_what_is_identified():
    _, record = pushed(loaded(), Prbs(150.0, 0.05, 8.0), 0.01)
    thinned = TuneRecord(0.01)
    for sample in record.samples:
        if sample.cycle % 97:
            thinned.put(sample)
    plant = identified(thinned)
    assert thinned.lost == 8
    assert plant.inertia == pytest.approx(INERTIA, rel=0.01)
    assert plant.coulomb == pytest.approx(COULOMB, rel=0.02)
    assert plant.fit > 0.99


def test_a_lost_cycle_of_a_frequency_response_is_between_its_neighbours():
    record = TuneRecord(0.01, [TuneSample(5, 1.0, 0.0, 10.0), TuneSample(8, 4.0, 0.0, 40.0)])
    assert _pairs(record) == ([1.0, 2.0, 3.0, 4.0], [10.0, 20.0, 30.0, 40.0])


def test_a_proposal_that_cannot_be_is_reported_and_the_rest_stands():
    _, record = pushed(loaded(), Prbs(150.0, 0.05, 4.0), 0.01)
    lines = report(record, TuneRequest(TuneTest.IDENTIFY, 4.0, 0.01, torque=150.0, crossover=3000.0), SCALE, None)
    assert lines[0].startswith("inertia ")
    assert lines[-1].startswith("no proposal: no PI controller gives a crossover of 477 Hz")


def test_what_reports_nothing_is_reported(tmp_path):
    with pytest.raises(DriveError, match="was never commanded"):
        step_of(record_of([0.0] * 50, begin=99), 1.0)
    record = TuneRecord(0.01, [TuneSample(0, 1.0, 0.0, None)])
    with pytest.raises(DriveError, match="no TPDO of the drive contains its velocity"):
        identified(record)
    with pytest.raises(ConfigError, match="cannot be written"):
        report(record, IDENTIFY, SCALE, tmp_path / "no" / "folder.csv")


def test_programs_are_reported_the_same_in_numbers():
    record = record_of([0.0] * 14 + [1.0] * 100)
    reported = findings(record, STEP, SCALE)
    assert reported.step.overshoot == pytest.approx(0.0, abs=1e-9)
    assert (reported.test, reported.samples, reported.lost) == ("step", 114, 0)
    _, record = pushed(loaded(), Prbs(150.0, 0.05, 4.0), 0.01)
    reported = findings(record, IDENTIFY, SCALE)
    assert reported.plant.inertia == identified(record).inertia
    assert reported.velocity_i > 0.0
    reported = findings(record, TuneRequest(TuneTest.IDENTIFY, 4.0, 0.01, torque=150.0, crossover=3000.0), SCALE)
    assert reported.gains is None
    assert "no PI controller gives a crossover" in reported.no_gains


@pytest.mark.rest
def test_a_record_is_drawn_where_a_picture_is_asked_for(tmp_path):
    report(record_of([0.0] * 14 + [1.0] * 100), STEP, SCALE, tmp_path / "step.png")
    assert (tmp_path / "step.png").read_bytes().startswith(b"\x89PNG")
