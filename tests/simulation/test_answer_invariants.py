"""Every accepted command moves its axis, or the robot reports why not; other robots violate the invariant."""

import functools

import pytest
from support import makers
from support.generic import write_generic
from support.robots import FORWARD

from canopen_control.hardware import motion_watch
from canopen_control.hardware.joint_targets import JointTargets
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.simulation.answer_invariants import AnswerInvariants
from canopen_control.testing.tested_robot import TestedRobot


@functools.cache
def setup_of(path, mode):
    return read_robot(find_robot(str(makers.folder(path, mode))))


@pytest.fixture
def robot(tmp_path_factory):
    """Make the robot of a test with quirks of its drives; it is closed at the end."""
    robots = []

    def make(mode, *quirks):
        path = tmp_path_factory.getbasetemp() / f"answers_{mode}"
        path.mkdir(exist_ok=True)
        robots.append(TestedRobot(setup_of(path, mode), quirks={"all": quirks}))
        return robots[-1]

    yield make
    for item in robots:
        item.close()


def lead(robot, seconds):
    """Lead the axes of a robot of positions away, in small steps, while it takes that."""
    for step in range(round(seconds * 20)):
        if robot.state == "running":
            robot.command("pos", 0.03 * (step + 1), 0.03 * (step + 1))
        robot.run(0.05)


def rules(robot):
    return {breach.split(": ")[1] for breach in robot.breaches}


def test_an_axis_that_takes_its_set_points_from_elsewhere_is_named_and_breaks_no_rule(robot):
    stands = robot("csv", "set_points_elsewhere")
    stands.command("vel", 0.5, 0.5, seconds=3.0)
    stands.run(2.5)
    assert "pan_drive" in "; ".join(makers.sentences(stands))
    assert stands.breaches == []


@pytest.mark.sources
def test_an_axis_that_stands_and_is_not_named_is_reported(robot, monkeypatch):
    monkeypatch.setattr(motion_watch, "STANDING_CHECKS", 1000)
    stands = robot("csv", "set_points_elsewhere")
    stands.command("vel", 0.5, 0.5, seconds=3.0)
    stands.run(2.8)
    assert rules(stands) == {"target_missed", "motion_missing"}


@pytest.mark.sources
def test_a_position_that_is_taken_and_not_sent_is_reported(robot, monkeypatch):
    stands = robot("csp")
    stands.command("pos", 0.0, 0.0)
    stands.run(0.2)
    monkeypatch.setattr(JointTargets, "follow", lambda self, _now, _period: self.hold())
    lead(stands, 2.5)
    assert rules(stands) == {"motion_missing"}


def test_a_position_that_is_reached_between_two_samples_has_been_answered(tmp_path):
    """Without a velocity limit a position in CSP is reached in one SYNC, and the axis stands when it is observed."""
    setup = read_robot(find_robot(str(write_generic(tmp_path, modes="position_mode: 8"))), controllers=["position"])
    servos = TestedRobot(setup)
    try:
        servos.run(0.51)  # the drives take their set-points between two samples
        for way in (0.0, 0.2):
            servos.command("position", way, way)
            servos.run(2.5)
        assert servos.position("one") == pytest.approx(0.2, abs=0.001)
        assert servos.breaches == []
    finally:
        servos.close()


def test_an_axis_whose_brake_lifts_late_stops_without_a_leap_and_names_the_key(robot):
    late = robot("csp", "brake_delay=0.5")
    lead(late, 0.6)
    text = "; ".join(makers.sentences(late))
    assert "`enable_settle_ms`" in text
    assert late.state == "disabled"
    assert abs(late.position("pan")) < 0.01
    assert late.breaches == []


@pytest.mark.rest
@pytest.mark.sources
def test_a_late_brake_that_is_not_named_is_reported(robot, monkeypatch):
    monkeypatch.setattr(motion_watch, "_LATE_CHECKS", 1000)
    late = robot("csp", "brake_delay=1")
    lead(late, 3.6)
    assert rules(late) == {"target_missed"}


@pytest.mark.rest
def test_a_ramp_that_the_drive_limits_is_named_by_the_boot_and_is_not_a_wrong_direction(robot):
    slow = robot("pv", "parameter_clamped=30000")
    assert "0x6083:00 holds" in "; ".join(makers.sentences(slow))
    slow.command("vel", 0.3, 0.3, seconds=6.0)
    slow.run(6.0)
    slow.command("vel", -0.3, -0.3, seconds=4.0)
    slow.run(4.0)
    assert slow.state == "running"
    assert slow.breaches == []


@pytest.mark.sources
def test_a_value_that_a_drive_keeps_and_no_report_names_is_reported(robot, monkeypatch):
    monkeypatch.setattr(AnswerInvariants, "event", lambda _self, _now, _event: None)
    slow = robot("pv", "parameter_clamped=30000")
    slow.run(0.1)
    assert rules(slow) == {"plan_unwritten"}


SLOWEST = 5 * 0.003926990816987242  # rad/s of a wheel of robby that turns by 5 counts/s


@pytest.fixture
def robby():
    robot = TestedRobot(read_robot(find_robot("robby")))
    yield robot
    robot.close()


def drive(robot, *values, seconds):
    robot.command(FORWARD, *values, seconds=seconds)
    robot.run(seconds)


def test_a_wheel_that_creeps_as_it_is_commanded_breaks_no_rule(robby):
    """Seed 299: 0.013 rad/s is 3 counts/s, which is no visible motion; so it is no motion that was asked for."""
    drive(robby, 5.093, 4.0, seconds=0.6)
    drive(robby, 5.093, 0.013, seconds=2.6)
    assert robby.breaches == []
    drive(robby, 5.093, 4.0, seconds=0.6)  # the time of an answer counts from here
    assert robby.breaches == []


@pytest.mark.sources
@pytest.mark.parametrize(("speed", "reported"), [(1.1 * SLOWEST, {"motion_missing"}), (0.9 * SLOWEST, set())])
def test_what_is_visible_must_move(robby, monkeypatch, speed, reported):
    follow = JointTargets.follow

    def withheld(self, now, period):
        self.hold() if self._axis.joint == "right_wheel_joint" else follow(self, now, period)

    monkeypatch.setattr(JointTargets, "follow", withheld)
    monkeypatch.setattr(motion_watch, "STANDING_CHECKS", 1000)
    drive(robby, 5.0, speed, seconds=3.0)
    assert rules(robby) & {"motion_missing"} == reported
