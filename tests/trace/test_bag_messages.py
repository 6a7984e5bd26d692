"""The messages that rosbags does not know; see test_bag for a bag of a run."""

import json
import math
from pathlib import Path

import pytest
from support.samples import sample_of
from support.trajectories import close

from canopen_control.rpc.messages.samples import MecanumSample, PidSample, SteeringSample, TrajectorySample
from canopen_control.trace.bag import BagMessages, BagWriter

rosbags = pytest.importorskip("rosbags.rosbag2", reason="rosbags is not installed: pip install canopen-control[bag]")

POINT = {"positions": [1.0, 2.0], "velocities": [0.5, 0.25], "time_from_start": 1.25}
TRAJECTORY = {
    "kind": "trajectory", "time": 12.5, "joints": ["a", "b"], "executing": True, "holding": False, "reference": POINT,
    "feedback": {"positions": [0.9, 2.1]}, "error": {"positions": [0.1, -0.1]}, "output": POINT,
    "speed_scaling_factor": 0.5,
}  # fmt: skip
LOOPS = {
    "kind": "pid", "time": 13.0,
    "dofs": [{"name": "a", "reference": 1.0, "feedback": None, "feedback_dot": None, "error": None, "error_dot": None,
              "time_step": 0.01, "output": 4.0}],
}  # fmt: skip
ODOMETRY = {"time": 13.5, "x": 1.0, "y": 0.0, "heading": 0.0}
STEERED = {
    "kind": "steering", **ODOMETRY, "traction_velocities": [3.0], "steering": [0.1, None],
    "steering_commands": [0.2, 0.3],
}  # fmt: skip
MECANUM = {"kind": "mecanum", **ODOMETRY, "wheels": [1.0, 2.0, 3.0, None], "reference": [0.5, -0.25, 0.125]}
STATE = {"time": 14.0, "joints": {}, "nodes": {}, "controllers": {}, "state": "running"}


@pytest.fixture
def found(tmp_path):
    """What a bag holds of two controllers that were looked at twice, by topic."""
    ros = BagMessages()
    with BagWriter(tmp_path / "bag", "arm") as writer:
        state = sample_of({**STATE, "samples": {"arm": TRAJECTORY, "loops": LOOPS, "truck": STEERED, "mec": MECANUM}})
        writer.state(state)
        writer.state(state)
    topics = {}
    with rosbags.Reader(tmp_path / "bag") as reader:
        for connection, stamp, data in reader.messages():
            message = None
            if connection.topic.endswith("controller_state"):
                message = ros.store.deserialize_cdr(data, connection.msgtype)
            topics.setdefault(connection.topic, []).append((connection, stamp, message))
    return topics


def test_a_trajectory_controllers_state_is_upstreams_message(found):
    ((connection, stamp, message),) = found["/arm/controller_state"]
    assert connection.msgtype == "control_msgs/msg/JointTrajectoryControllerState"
    assert stamp == 12_500_000_000
    assert (message.joint_names, message.speed_scaling_factor) == (["a", "b"], 0.5)
    assert close(list(message.reference.velocities), [0.5, 0.25])
    assert close(list(message.error.positions), [0.1, -0.1])
    assert (message.output.time_from_start.sec, message.output.time_from_start.nanosec) == (1, 250_000_000)
    assert len(message.feedback.velocities) == 0


def test_a_pid_controllers_state_has_nan_for_what_is_not_known(found):
    ((connection, stamp, message),) = found["/loops/controller_state"]
    assert (connection.msgtype, stamp) == ("control_msgs/msg/MultiDOFStateStamped", 13_000_000_000)
    (dof,) = message.dof_states
    assert (dof.name, dof.reference, dof.time_step, dof.output) == ("a", 1.0, 0.01, 4.0)
    assert math.isnan(dof.feedback)


def test_bases_tell_their_wheels_beside_their_odometry(found):
    assert len(found["/truck/odom"]) == len(found["/mec/odom"]) == 1
    ((_, stamp, truck),) = found["/truck/controller_state"]
    assert (stamp, truck.header.frame_id) == (13_500_000_000, "odom")
    assert list(truck.traction_wheels_velocity) == [3.0]
    assert (truck.steer_positions[0], list(truck.steering_angle_command)) == (0.1, [0.2, 0.3])
    assert math.isnan(truck.steer_positions[1])
    ((_, _, base),) = found["/mec/controller_state"]
    assert (base.front_left_wheel_velocity, base.back_left_wheel_velocity) == (1.0, 2.0)
    assert base.back_right_wheel_velocity == 3.0
    assert math.isnan(base.front_right_wheel_velocity)
    wanted = base.reference_velocity
    assert (wanted.linear.x, wanted.linear.y, wanted.angular.z) == (0.5, -0.25, 0.125)


def test_a_mecanum_base_that_has_told_no_wheels_yet_is_nan_throughout():
    message = BagMessages().states[MecanumSample](MecanumSample(time=1.0, x=0.0, y=0.0, heading=0.0))
    assert math.isnan(message.front_left_wheel_velocity)
    assert math.isnan(message.reference_velocity.angular.z)


def test_the_types_are_upstreams_by_their_hashes():
    hashes = json.loads((Path(__file__).parents[1] / "data" / "control_msgs_hashes.json").read_text())
    store = BagMessages().store
    for name in (
        "JointTrajectoryControllerState",
        "MultiDOFStateStamped",
        "SteeringControllerStatus",
        "MecanumDriveControllerState",
    ):
        assert store.hash_rihs01(f"control_msgs/msg/{name}") == hashes[f"control_msgs/msg/{name}"]


def test_every_kind_has_its_message():
    assert set(BagMessages().states) == {TrajectorySample, PidSample, SteeringSample, MecanumSample}
