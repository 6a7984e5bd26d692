"""Bags are read back: by rosbags here, by rclpy's own messages if ROS is available."""

import builtins
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.apiclient import Client
from support.robots import FORWARD, LEFT, Bench
from support.samples import controllers_of, event_of, sample_of
from support.trajectories import close

from canopen_control.errors import ConfigError
from canopen_control.ros.sample_topics import SAMPLE_TOPICS, fill
from canopen_control.rpc.messages.samples import (
    BatteriesSample,
    BatteryReading,
    GpioSample,
    GripperSample,
    ImuSample,
    MecanumSample,
    PoseSample,
    RangeSample,
    WrenchSample,
)
from canopen_control.rpc.messages.state import StateSample
from canopen_control.runtime.api import ApiServer
from canopen_control.trace.bag import BagMessages, BagWriter

rosbags = pytest.importorskip("rosbags.rosbag2", reason="rosbags is not installed: pip install canopen-control[bag]")
SAMPLES = {
    "imu": ImuSample(
        time=1.5, frame_id="imu_link", orientation=(0.0, 0.0, 0.6, 0.8), angular_velocity=(0.1, None, 0.3),
        linear_acceleration=(0.0, 0.0, 9.81), orientation_covariance=[0.5] * 9,
        angular_velocity_covariance=[-1.0, *[0.0] * 8], linear_acceleration_covariance=[0.0] * 9,
    ),
    "front": RangeSample(time=1.5, frame_id="nose", range=1.25, radiation_type=1, min_range=0.5, max_range=4.0),
    "wrist": WrenchSample(time=1.5, frame_id="tool0", force=(1.0, 2.0, None), torque=(0.5, 0.25, 0.125)),
    "gps": PoseSample(time=1.5, frame_id="map", position=(1.0, 2.0, 3.0), orientation=(0.0, 0.0, 0.6, 0.8),
                      child_frame_id="base"),
    "power": BatteriesSample(
        time=1.5, together=BatteryReading(name="", voltage=24.5, percentage=0.75, present=True),
        batteries=[BatteryReading(name="left", current=-3.5, power_supply_status=2), BatteryReading(name="right")],
    ),
    "io": GpioSample(time=1.5, parts={"io": {"lamp": 1.0, "pressed": None}, "valve": {"open": 0.5}}),
    "gripper": GripperSample(time=1.5, joint="finger", position=0.01, velocity=0.0, effort=2.0, target=0.04,
                             executing=True, stalled=False, reached_goal=False),
}  # fmt: skip
KINDS = {
    "/imu/imu": "sensor_msgs/msg/Imu",
    "/front/range": "sensor_msgs/msg/Range",
    "/wrist/wrench": "geometry_msgs/msg/WrenchStamped",
    "/gps/pose": "geometry_msgs/msg/PoseStamped",
    "/power/battery_state": "sensor_msgs/msg/BatteryState",
    "/power/raw_battery_states": "control_msgs/msg/BatteryStateArray",
    "/io/gpio_states": "control_msgs/msg/DynamicInterfaceGroupValues",
    "/gripper/commands_out": "std_msgs/msg/Float64MultiArray",
}


@pytest.fixture(scope="module")
def found_of_sensors(tmp_path_factory):
    """What a bag holds of controllers that were looked at twice: type, stamp and message by topic."""
    path, store = tmp_path_factory.mktemp("bag") / "run", BagMessages().store
    with BagWriter(path, "robot") as writer:
        for time in (2.0, 2.1):
            writer.state(StateSample(time=time, samples=SAMPLES))
    topics = {}
    with rosbags.Reader(path) as reader:
        for connection, stamp, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            topics.setdefault(connection.topic, []).append((connection.msgtype, stamp, message))
    return topics


def only(found_of_sensors, topic):
    ((_, _, message),) = found_of_sensors[topic]
    return message


@pytest.mark.parametrize("topic", KINDS)
def test_each_is_there_once_with_its_type_and_stamp(found_of_sensors, topic):
    ((kind, stamp, _),) = found_of_sensors[topic]
    assert (kind, stamp) == (KINDS[topic], 1_500_000_000)


def test_every_row_is_tried_here():
    tried = {topic.rpartition("/")[2] for topic in KINDS}
    others = {"controller_state", "odom", "cmd_vel_out", "cmd_ackermann", "joint_states"}
    assert {row.topic for row in SAMPLE_TOPICS if row.bag} == tried | others


def test_a_range_a_wrench_and_a_pose_with_its_transform(found_of_sensors):
    front = only(found_of_sensors, "/front/range")
    assert (front.range, front.radiation_type, front.min_range, front.max_range) == (1.25, 1, 0.5, 4.0)
    wrench = only(found_of_sensors, "/wrist/wrench").wrench
    assert (wrench.force.y, wrench.torque.z) == (2.0, 0.125)
    assert math.isnan(wrench.force.z)
    pose = only(found_of_sensors, "/gps/pose").pose
    assert (pose.position.z, pose.orientation.w) == (3.0, 0.8)
    (transform,) = only(found_of_sensors, "/tf").transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base")
    assert (transform.transform.translation.y, transform.transform.rotation.z) == (2.0, 0.6)


def test_batteries(found_of_sensors):
    together = only(found_of_sensors, "/power/battery_state")
    assert (together.voltage, together.percentage, together.present) == (24.5, 0.75, True)
    assert math.isnan(together.current)
    left, right = only(found_of_sensors, "/power/raw_battery_states").battery_states
    assert (left.header.frame_id, left.current, left.power_supply_status) == ("left", -3.5, 2)
    assert (right.header.frame_id, len(right.cell_voltage)) == ("right", 0)


def test_inputs_and_outputs_and_where_a_gripper_is_sent(found_of_sensors):
    io = only(found_of_sensors, "/io/gpio_states")
    assert io.interface_groups == ["io", "valve"]
    assert [value.interface_names for value in io.interface_values] == [["lamp", "pressed"], ["open"]]
    assert io.interface_values[0].values[0] == 1.0
    assert math.isnan(io.interface_values[0].values[1])
    assert list(only(found_of_sensors, "/gripper/commands_out").data) == [0.04]


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
WHEEL = {"kind": "odometry", **ODOMETRY, "ackermann": [4.0, -0.5], "only_twist": True}
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
        state = sample_of(
            {**STATE, "samples": {"arm": TRAJECTORY, "loops": LOOPS, "truck": STEERED, "mec": MECANUM, "wheel": WHEEL}}
        )
        writer.state(state)
        writer.state(state)
    topics = {}
    with rosbags.Reader(tmp_path / "bag") as reader:
        for connection, stamp, data in reader.messages():
            message = None
            if connection.topic.endswith(("controller_state", "cmd_ackermann", "wheel/odom")):
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


def test_bases_report_their_wheels_alongside_their_odometry(found):
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
    expected = base.reference_velocity
    assert (expected.linear.x, expected.linear.y, expected.angular.z) == (0.5, -0.25, 0.125)


def test_a_mecanum_base_that_has_reported_no_wheels_yet_is_nan_throughout():
    (row,) = [topic for topic in SAMPLE_TOPICS if topic.kind is MecanumSample]
    messages = BagMessages()
    message = messages.empty(row.message)
    fill(messages, message, row, MecanumSample(time=1.0, x=0.0, y=0.0, heading=0.0))
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


READ_WITH_RCLPY = """
import importlib, json, sys
from pathlib import Path
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader

def plain(value):
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0]
    return value if isinstance(value, (str, int, float)) else [plain(each) for each in value]

found = {}
with Reader(Path(sys.argv[1])) as reader:
    for connection, stamp, data in reader.messages():
        package, _, name = connection.msgtype.split("/")
        if package == "tf2_msgs":
            continue
        kind = getattr(importlib.import_module(package + ".msg"), name)
        found.setdefault(connection.topic, []).append([stamp, plain(deserialize_message(bytes(data), kind))])
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def story(tmp_path_factory):
    """Two seconds of robby: what the API says, samples while the wheels turn, an error."""
    folder = tmp_path_factory.mktemp("run")
    folder.chmod(0o700)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        return tell(Bench("bag"))


def tell(bench):
    bench.api = ApiServer(bench.robot)
    bench.start()
    client = Client(bench)
    reported = {"controllers": client.ask("controllers")["result"], "urdf": client.ask("description")["result"]["urdf"]}
    client.ask("subscribe", state_rate=50.0, events=True)
    reported["messages"] = messages = client.messages()
    for tenth in range(30):
        if tenth < 20:
            bench.command(3.0, 4.0)
        if tenth == 20:
            bench.power_off(LEFT)
        bench.run(100)
        messages += client.messages()
    client.close()
    bench.api.close()
    bench.close()
    return reported


@pytest.fixture
def private_folders():
    """Not needed: the story has its own folder, and nothing else here runs a robot."""


@pytest.fixture(scope="module")
def bag(story, tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "run"
    with BagWriter(path, "robby", controllers=controllers_of(story["controllers"]), urdf=story["urdf"]) as writer:
        for message in story["messages"]:
            if "state" in message:
                writer.state(sample_of(message["state"]))
            elif "event" in message:
                writer.event(event_of(message["event"]))
    assert writer.messages > 0
    writer.close()
    return path


def states(story):
    return [message["state"] for message in story["messages"] if "state" in message]


def read(path):
    store, result = BagMessages().store, {}
    with rosbags.Reader(path) as reader:
        for connection, stamp, data in reader.messages():
            result.setdefault(connection.topic, []).append((stamp, store.deserialize_cdr(data, connection.msgtype)))
    return result


def collected(story):
    return [state["samples"]["joint_state_broadcaster"] for state in states(story)]


@pytest.mark.rest
def test_every_update_of_the_broadcaster_is_a_joint_state_with_its_stamp(story, bag):
    messages = read(bag)["/joint_states"]
    assert len(messages) == len(collected(story)) > 100
    for (stamp, message), sample in zip(messages, collected(story), strict=True):
        assert stamp / 1e9 == pytest.approx(sample["time"], abs=1e-6)
        assert message.header.stamp.sec == int(sample["time"])
        assert message.name == sample["names"]
        for index, name in enumerate(message.name):
            joint = sample["joints"][name]
            for kind in ("position", "velocity", "effort"):
                value, expected = getattr(message, kind)[index], joint.get(kind)
                assert math.isnan(value) if expected is None else value == expected


def test_commands_are_recorded_on_change_under_an_unused_topic_name(bag):
    result = read(bag)
    commands = [list(message.data) for _, message in result[f"/{FORWARD}/commands_out"]]
    assert [3.0, 4.0] in commands
    assert len(commands) < 10
    assert f"/{FORWARD}/commands" not in result


def test_wheels_turn_in_tf_and_what_is_fixed_is_there_once(story, bag):
    result = read(bag)
    turning = {
        transform.child_frame_id: transform.transform.rotation.w for transform in result["/tf"][50][1].transforms
    }
    assert len(turning) == 2
    first = {item.child_frame_id: item.transform.rotation.w for item in result["/tf"][0][1].transforms}
    assert all(turning[name] != first[name] for name in first)
    assert len(result.get("/tf_static", ())) <= 1
    assert result["/robot_description"][0][1].data == story["urdf"]


def test_events_are_log_messages_with_their_level_and_node(bag):
    logs = [message for _, message in read(bag)["/rosout"]]
    lost = [message for message in logs if "heartbeat" in message.msg]
    assert lost[0].level == 40
    assert lost[0].name == "robby.left_drive"


def test_the_true_pose_of_a_simulated_base_is_in_the_frame_of_its_odometry(story, tmp_path):
    sample = {"kind": "odometry", "time": 1000.25, "x": 0.0, "y": 0.0, "heading": 0.0, "frame_id": "odom"}
    truth = {"time": 1000.5, "x": 5.0, "y": 1.5, "z": 0.1, "heading": math.pi, "odom": [5.0, 0.0, math.pi / 2]}
    state = {**states(story)[0], "samples": {"base": sample}, "true_pose": truth}
    with BagWriter(tmp_path / "truth", "robby", urdf=story["urdf"]) as writer:
        for _ in range(2):  # known once, sampled twice
            writer.state(sample_of(state))
        writer.state(sample_of({**state, "samples": {}, "true_pose": truth | {"time": 1001.0}}))
    ((stamp, message),) = read(tmp_path / "truth")["/ground_truth"]
    assert (stamp, message.header.frame_id) == (1_000_500_000_000, "odom")
    place = message.pose.position
    assert (place.x, place.y, place.z) == pytest.approx((1.5, 0.0, 0.1))
    assert message.pose.orientation.z == pytest.approx(math.sqrt(0.5))


@pytest.mark.rest
def test_odometry_becomes_odom_tf_and_the_limited_twist(story, tmp_path):
    sample = {
        "kind": "odometry", "time": 1000.25, "x": 1.0, "y": 2.0, "heading": math.pi, "linear": 0.5, "angular": -0.25,
        "frame_id": "odom", "child_frame_id": "base_link", "pose_covariance": [1, 2, 3, 4, 5, 6], "limited": [0.4, 0.1],
    }  # fmt: skip
    with BagWriter(tmp_path / "odom", "robby", urdf=story["urdf"]) as writer:
        for _ in range(2):  # published once, sampled twice
            writer.state(sample_of({**states(story)[0], "samples": {"base": sample}}))
    result = read(tmp_path / "odom")
    assert len(result["/base/odom"]) == len(result["/base/cmd_vel_out"]) == 1
    odometry = result["/base/odom"][0][1]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    assert odometry.pose.pose.orientation.z == pytest.approx(1.0)
    assert list(odometry.pose.covariance)[::7] == [1, 2, 3, 4, 5, 6]
    assert odometry.twist.twist.linear.x == 0.5
    assert result["/base/cmd_vel_out"][0][1].twist.angular.z == 0.1
    assert {transform.header.frame_id for transform in result["/tf"][0][1].transforms} >= {"odom"}


def test_a_bag_never_overwrites(bag):
    with pytest.raises(ConfigError, match="it already exists"):
        BagWriter(bag, "robby")


def test_without_rosbags_it_suggests_what_to_type(monkeypatch, tmp_path):
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name.startswith("rosbags"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ConfigError, match=r"pip install 'canopen-control\[bag\]'"):
        BagWriter(tmp_path / "x", "robby")


@pytest.mark.ros
def test_rclpys_own_messages_agree(story, bag):
    environment = {key: value for key, value in os.environ.items() if key != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    done = subprocess.run(
        [sys.executable, "-c", READ_WITH_RCLPY, str(bag)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    sample, (stamp, message) = collected(story)[60], result["/joint_states"][60]
    assert message["header"]["stamp"]["sec"] * 10**9 + message["header"]["stamp"]["nanosec"] == stamp
    left = message["name"].index("left_wheel_joint")
    assert message["velocity"][left] == sample["joints"]["left_wheel_joint"]["velocity"]
    assert message["position"][left] == sample["joints"]["left_wheel_joint"]["position"]
    assert [3.0, 4.0] in [each["data"] for _, each in result[f"/{FORWARD}/commands_out"]]
    assert any(each["level"] == 40 and each["name"] == "robby.left_drive" for _, each in result["/rosout"])
    statuses = {item["name"]: item for _, array in result["/diagnostics"] for item in array["status"]}
    assert statuses["robby: left_drive"]["hardware_id"] == "node 3"
    assert result["/robot_description"][0][1]["data"] == story["urdf"]
