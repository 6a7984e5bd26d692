import pytest
from support.tuneplant import COULOMB, INERTIA, loaded, pushed

from canopen_control.errors import ConfigError, DriveError
from canopen_control.service.jog_motion import JogScale, parse_quantity
from canopen_control.service.tune_report import _pairs, findings, identified, report, step_of
from canopen_control.service.tune_run import Prbs, TuneRecord, TuneRequest, TuneSample, TuneTest

SCALE = JogScale(4096.0, told=True)
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


def test_a_proposal_that_cannot_be_is_told_and_the_rest_stands():
    _, record = pushed(loaded(), Prbs(150.0, 0.05, 4.0), 0.01)
    lines = report(record, TuneRequest(TuneTest.IDENTIFY, 4.0, 0.01, torque=150.0, crossover=3000.0), SCALE, None)
    assert lines[0].startswith("inertia ")
    assert lines[-1].startswith("no proposal: no PI gives a crossover of 477 Hz")


def test_what_tells_nothing_is_told(tmp_path):
    with pytest.raises(DriveError, match="was never commanded"):
        step_of(record_of([0.0] * 50, begin=99), 1.0)
    record = TuneRecord(0.01, [TuneSample(0, 1.0, 0.0, None)])
    with pytest.raises(DriveError, match="no TPDO of the drive carries its velocity"):
        identified(record)
    with pytest.raises(ConfigError, match="cannot be written"):
        report(record, IDENTIFY, SCALE, tmp_path / "no" / "folder.csv")


def test_programs_are_told_the_same_in_numbers():
    record = record_of([0.0] * 14 + [1.0] * 100)
    told = findings(record, STEP, SCALE)
    assert told.step.overshoot == pytest.approx(0.0, abs=1e-9)
    assert (told.test, told.samples, told.lost) == ("step", 114, 0)
    _, record = pushed(loaded(), Prbs(150.0, 0.05, 4.0), 0.01)
    told = findings(record, IDENTIFY, SCALE)
    assert told.plant.inertia == identified(record).inertia
    assert told.velocity_i > 0.0
    told = findings(record, TuneRequest(TuneTest.IDENTIFY, 4.0, 0.01, torque=150.0, crossover=3000.0), SCALE)
    assert told.gains is None
    assert "no PI gives a crossover" in told.no_gains


@pytest.mark.rest
def test_a_record_is_drawn_where_a_picture_is_asked_for(tmp_path):
    report(record_of([0.0] * 14 + [1.0] * 100), STEP, SCALE, tmp_path / "step.png")
    assert (tmp_path / "step.png").read_bytes().startswith(b"\x89PNG")
