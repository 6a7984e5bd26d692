"""The manager refuses requests that a controller does not support, each with a sentence."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import FORWARD, three_on_two_wheels

from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.request_protocols import (
    ClosesLoops,
    FollowsTrajectories,
    GripperGoal,
    Grips,
    GripStatus,
    HasOdometry,
    StallDetector,
    TakesCommands,
    TakesNamedValues,
)
from canopen_control.controllers.trajectory.goal import TrajectoryGoal
from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.controllers.types import TYPES, make_controller
from canopen_control.errors import ControlError

KINDS = (ClosesLoops, FollowsTrajectories, Grips, HasOdometry, TakesCommands, TakesNamedValues)
TWISTS = {"HasOdometry", "TakesCommands"}
TAKEN = {
    "pid_controller/PidController": {"ClosesLoops", "TakesCommands"},
    "joint_trajectory_controller/JointTrajectoryController": {"FollowsTrajectories", "TakesCommands"},
    "gpio_controllers/GpioCommandController": {"TakesCommands", "TakesNamedValues"},
    "parallel_gripper_action_controller/GripperActionController": {"Grips", "TakesCommands"},
    "diff_drive_controller/DiffDriveController": TWISTS,
    "mecanum_drive_controller/MecanumDriveController": TWISTS,
    "tricycle_steering_controller/TricycleSteeringController": TWISTS,
    FORWARD: {"TakesCommands"},
    "joint_state_broadcaster/JointStateBroadcaster": set(),
    "imu_sensor_broadcaster/IMUSensorBroadcaster": set(),
}


@pytest.mark.parametrize("kind", TAKEN)
def test_a_kind_takes_what_it_has_the_methods_for(kind):
    assert kind in TYPES
    controller = make_controller("one", kind)
    assert {item.__name__ for item in KINDS if isinstance(controller, item)} == TAKEN[kind]


GOAL = TrajectoryGoal(JointTrajectory(("l",), [Point([1.0], time=1)]))


@pytest.mark.parametrize(
    ("request_it", "sentence", "counted"),
    [
        (lambda control: control.command("states", [1.0], 0), "accepts no commands; it only reads states", 1),
        (lambda control: control.command("left", {"l/velocity": 1.0}, 0), "accepts no values by interface name", 1),
        (lambda control: control.send_goal("left", GOAL, 0), "is not a joint trajectory", 1),
        (lambda control: control.send_goal("left", GripperGoal(0.0), 0), "is not a gripper action controller", 1),
        (lambda control: control.follower("left"), "left is not a joint trajectory", 0),
        (lambda control: control.base("left"), "left has no odometry; it is not a base controller", 0),
        (lambda control: control.loops("left", "takes no x"), "left takes no x; it is not a PID controller", 0),
    ],
)
def test_what_is_not_taken_is_refused_and_counted_where_it_would_move_something(request_it, sentence, counted):
    _, control = three_on_two_wheels()
    control.switch(["left", "states"], now=0)
    with pytest.raises(ControlError, match=sentence):
        request_it(control)
    assert control.get("left").rejected + control.get("states").rejected == counted


# -- gripper goal


MS = 1_000_000


def test_only_the_first_end_counts_and_is_reported_once():
    reports = []
    goal = GripperGoal(0.04, 20.0, ended_now=lambda: reports.append(1))
    goal.end(GoalState.SUCCEEDED, "reached", 0.039, 5.0, GripStatus.REACHED)
    goal.end(GoalState.ABORTED, "too late", 0.0, 0.0, GripStatus.STALLED)
    assert (goal.state, goal.text, goal.at, goal.effort) == (GoalState.SUCCEEDED, "reached", 0.039, 5.0)
    assert (goal.reached, goal.stalled, reports) == (True, False, [1])


def test_an_unknown_position_is_not_reported_as_reached():
    progress = StallDetector(0.01, 0.001, 1.0)
    progress.begin(0)
    assert progress.update(0, math.nan, math.nan) is GripStatus.MOVING
    assert progress.update(1001 * MS, math.nan, math.nan) is GripStatus.STALLED


@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(-0.01, 0.01)), max_size=40))
def test_it_agrees_with_the_definition(steps):
    progress, moved = StallDetector(0.1, 0.002, 0.05), 0
    progress.begin(0)
    for number, (error, velocity) in enumerate(steps, 1):
        now = number * 10 * MS
        result = progress.update(now, error, velocity)
        if abs(error) < 0.1:
            assert result is GripStatus.REACHED
            continue
        moved = now if abs(velocity) > 0.002 else moved
        assert result is (GripStatus.STALLED if now - moved > 50 * MS else GripStatus.MOVING)
