"""A base with odometry errors, as processes: its true pose, and a calibration that is stopped or killed."""

import math
import signal

import pytest
from support.floor import BASE, plant_text
from support.host import eventually

from canopen_control import Robot

pytestmark = pytest.mark.process


@pytest.fixture
def erring(stage):
    """Robby on a floor, with a track 10 % wider than its YAML says; and a connection to it."""
    (stage.place / "floor.yml").write_text(plant_text(track=1.1))
    program = stage.start("run", "robby", "--plant", "floor.yml", "--controller", BASE)
    program.until("robby runs")
    with Robot.attach("robby") as robot:
        yield program, robot


def speeds(robot):
    return [abs(joint.velocity or 0.0) for joint in robot.joints().values()]


def test_the_true_pose_stands_alongside_odometry_and_what_ends_a_calibration_stops_the_base(stage, erring):
    _, robot = erring
    assert eventually(lambda: robot.status().true_pose is not None)
    truth = robot.status().true_pose
    assert (truth.x, truth.y, truth.error) == (0.0, 0.0, pytest.approx((0.0, 0.0, 0.0)))

    killed = stage.start("calibrate", "--side", "0.5", "--speed", "0.4", "--turn", "1")
    killed.until("run 1 of 1, counter-clockwise")
    assert eventually(lambda: robot.status().true_pose.heading > 0.3)
    truth = robot.status().true_pose
    assert truth.error[2] == pytest.approx(truth.heading - truth.heading * 1.1, abs=0.05)
    killed.end(signal.SIGKILL)
    assert eventually(lambda: max(speeds(robot)) < 0.01), "who is killed drives no more"

    stopped = stage.start("calibrate", "--side", "0.5", "--speed", "0.4", "--turn", "1")
    stopped.until("run 1 of 1, counter-clockwise")
    assert eventually(lambda: max(speeds(robot)) > 1.0)
    robot.stop()
    assert stopped.wait() == 1
    assert "the calibration has ended: left_drive, right_drive are not enabled" in stopped.err
    assert math.isfinite(robot.status().true_pose.x)


def test_an_error_in_a_plant_file_is_reported_before_anything_is_started(stage):
    (stage.place / "floor.yml").write_text(plant_text().replace("wheel_separation", "wheel_seperation"))
    program = stage.start("run", "robby", "--plant", "floor.yml")
    assert program.wait() == 2
    assert "floor.yml:" in program.err
    assert "wheel_seperation" in program.err
