"""A base on mecanum wheels moves according to its wheels, also sideways, as a whole robot in simulated time."""

import contextlib

import pytest
from support.physicsrobot import PhysicsRobot

from canopen_control.errors import NotEnabled

BASE = "mecanum_base_controller"
WHEELS = (2, 3, 4, 5)  # front left, front right, rear right, rear left
RADIUS, REACH = 0.08, 0.42


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        physics_robot = PhysicsRobot("mecanum-contact", config="mecanum", controllers=[BASE])
        physics_robot.start()
        yield physics_robot
        physics_robot.close()


def went(robot, twist, seconds=0.4):
    """Return how far a twist has brought the robot, by its wheels and in truth: ahead, to the left, turned."""
    wheels, pose = positions(robot), robot.world.describe().base
    for _ in range(round(seconds * 10)):
        with contextlib.suppress(NotEnabled):
            robot.robot.command(BASE, twist, "test")
        robot.run(100)
    robot.run(1100)
    base = robot.world.describe().base
    fl, fr, rr, rl = (RADIUS * (end - begin) for begin, end in zip(wheels, positions(robot), strict=True))
    text = [(fl + fr + rr + rl) / 4, (-fl + fr - rr + rl) / 4, (-fl + fr + rr - rl) / (4 * REACH)]
    return text, [base.x - pose.x, base.y - pose.y, base.heading - pose.heading]


def positions(robot):
    return [robot.joint(node).states["position"].value for node in WHEELS]


def test_the_true_motion_is_that_of_the_wheels_along_and_across(robot):
    wheels, truth = went(robot, [0.15, 0.3, 0.0])
    assert (wheels[0] > 0.08, wheels[1] > 0.15) == (True, True)
    assert truth == pytest.approx(wheels, abs=0.003)


def test_a_turn_is_one_too_and_then_it_comes_to_rest(robot):
    wheels, truth = went(robot, [0.0, 0.0, 0.5])
    assert truth[2] == pytest.approx(wheels[2], abs=0.003)
    robot.run(900)
    assert robot.world.asleep
