import math

import pytest
from support.floor import BASE, QUICK

from canopen_control.calibration.base_link import FACTORS, Driven, FiledEnds, WheelValues
from canopen_control.calibration.umbmark import Direction, ImplausibleEnds, Pace
from canopen_control.calibration.umbmark_session import CalibrationPlan, TrueEnds, calibrate, fitting_pace, space
from canopen_control.errors import ControlError


@pytest.mark.rest
def test_a_robot_with_unequal_wheels_and_a_wrong_track_is_calibrated_in_two_passes(floor):
    bench, _, link = floor("umb", track=1.02, unequal=1.005)
    reported, new = [], []
    plan = CalibrationPlan(side=0.7, passes=2, pace=QUICK)
    outcome = calibrate(link, TrueEnds(reported.append), plan, reported.append, new.append)
    assert outcome.first.largest > 0.04
    assert outcome.gain > 100
    factors = outcome.factors
    assert factors == dict(zip(FACTORS, link.wheel_values().factors, strict=True)) == new[-1]
    separation, left, right = factors.values()
    assert right / left == pytest.approx(1.005, abs=1e-4)
    assert separation / ((left + right) / 2) == pytest.approx(1.02 / 1.0025, abs=1e-3)
    assert len(new) == 2
    assert "uncorrected, 1 of 3: run 1 of 1, counter-clockwise" in reported
    assert any("largest systematic error" in item for item in reported)
    assert bench.robot.manager.get(BASE).limited == [0.0, 0.0]


def test_a_robot_as_it_should_be_has_nothing_to_correct():
    base, new = Floor((0.0002, 0.0), (0.0, 0.0)), []
    outcome = calibrate(base, TrueEnds(new.append), CalibrationPlan(), lambda _: None, new.append)
    assert outcome.first is outcome.last
    assert outcome.factors == dict.fromkeys(FACTORS, 1.0)
    assert base.set == []


class Floor:
    """A base by its formulas alone: drives exactly, so that its error is what it is given to be."""

    def __init__(self, *errors):
        self.errors, self.factors, self.set = list(errors), (1.0, 1.0, 1.0), []

    def wheel_values(self):
        return WheelValues(0.24, self.factors)

    def set_factors(self, factors):
        self.set.append(factors)
        self.factors = factors

    def drive(self, path):
        sign = path.direction.value
        x, y = self.errors.pop(0)
        return Driven((0.0, 0.0, sign * math.tau), (x, y, sign * math.tau))


def test_what_is_not_a_gain_is_reported_and_the_old_values_are_given_back():
    base = Floor((0.05, 0.01), (0.05, -0.01), (0.06, 0.02), (0.06, -0.02))
    with pytest.raises(
        ControlError, match=r"63\.2 mm with the corrected values and was 51\.0 mm before: .*not an improvement"
    ):
        calibrate(base, TrueEnds(lambda _: None), CalibrationPlan(), lambda _: None)
    assert base.set[-1] == (1.0, 1.0, 1.0)
    assert len(base.set) == 2


@pytest.mark.parametrize("ended", [KeyboardInterrupt, ControlError])
def test_whatever_ends_it_in_the_second_round_gives_the_old_values_back(ended):
    class Stopped(Floor):
        def drive(self, path):
            if not self.errors:
                raise ended("STOP")
            return super().drive(path)

    base = Stopped((0.05, 0.01), (0.05, -0.01))
    with pytest.raises(ended):
        calibrate(base, TrueEnds(lambda _: None), CalibrationPlan(), lambda _: None)
    assert base.factors == (1.0, 1.0, 1.0)
    assert len(base.set) == 2


def test_ends_that_cannot_be_end_it_before_anything_is_changed():
    base = Floor((9.0, 0.0), (0.0, 0.0))
    with pytest.raises(ImplausibleEnds, match=r"9\.00 m"):
        calibrate(base, TrueEnds(lambda _: None), CalibrationPlan(), lambda _: None)
    assert base.set == []


def test_measured_ends_count_less_what_odometry_reported():
    base = Floor((0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    ends = FiledEnds([(0.05, 0.02), (0.05, -0.02), (0.001, 0.0), (0.001, 0.0)], lambda _: None)
    outcome = calibrate(base, ends, CalibrationPlan(), lambda _: None)
    assert outcome.first.largest == pytest.approx(math.hypot(0.05, 0.02))
    assert outcome.gain == pytest.approx(math.hypot(50, 20))


def test_a_simulation_that_reports_no_pose_is_reported():
    with pytest.raises(ControlError, match="run 1: the simulation has reported no true pose"):
        TrueEnds(lambda _: None).end("run 1", Driven((0.0, 0.0, 0.0)))


def test_the_pace_is_limited_by_the_controllers_limits():
    limits = WheelValues(0.24, (1.0, 1.0, 1.0), 0.1, 0.5, 0.25, 0.5)
    assert fitting_pace(Pace(), limits) == Pace(0.1, 0.5, 0.2, 0.4)
    assert fitting_pace(Pace(), WheelValues(0.24, (1.0, 1.0, 1.0))) == Pace()


def test_a_plan_reports_how_much_it_drives_and_needs():
    plan = CalibrationPlan(side=1.0, runs=5, passes=2)
    assert plan.squares == 30
    assert plan.seconds == pytest.approx(30 * 40, rel=0.15)
    assert space(1.0).startswith("1.30 m ahead")
    assert [item.word for item in Direction] == ["counter-clockwise", "clockwise"]
